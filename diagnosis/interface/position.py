"""Position columns against everything else: a path that points down, other axes, other units.

The vertical acceleration of the path rises and falls with the thrust:

    a_z = g k (L / <L> - 1) + b

L is the vertical part of what the motors are given, in any unit, <L> its mean in a piece of flight,
and b a constant of that piece. k is about 1, less where motors lag and inputs are noisy, and
negative only if the path's z axis points down.

Velocity and attitude are compared with the path. If both are at odds with it in the same way, the
position alone is wrong. So it is with units: a path that moves several times as far as the velocity
says, and is accelerated as many times as much as its tilt makes it, has the wrong unit itself.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from diagnosis.interface.fault import Evidence, InterfaceFault
from diagnosis.interface.orders import PATHS
from diagnosis.interface.readings import AXES, Chosen, signed_orders
from diagnosis.interface.scales import (
    UNITS,
    Size,
    jackknife,
    path_over_tilt,
    path_over_velocity,
    pieces,
    sized,
)
from diagnosis.interface.windows import LIFT_LAGS, Windows
from diagnosis.logs.units import FOOT, KNOT, MILE
from simulators.vehicle import GRAVITY

ORDERS = {words: matrix for words, _, matrix in signed_orders(3)}
"""What columns x, y and z hold, in words and as a matrix."""

Z_FLIPPED = "z with the opposite sign"
"""The order whose z axis alone is wrong."""

FALLING = 0.5
"""Lift over the median below which a window is left out: in the air it would be a fall at half of
gravity, so that the drone stands on the ground, which a path that points down does not show."""
SPEEDS = {
    "knots": 1 / KNOT,
    "miles per hour": 3600 / MILE,
    "feet per second": 1 / FOOT,
    "km/h": 3.6,
}
"""How many of each unit of speed make one m/s."""
FEET = {"feet": 1 / FOOT}
"""How many of each unit of length make one metre."""
NEAR = 1.15
"""Largest factor between a size and a unit that it is said to be; a choice. Speeds that a Crazyflie
estimates on board are 9 % off the path of motion capture."""
NOW = int(np.argmin(np.abs(LIFT_LAGS)))
"""Place of the inputs that are not shifted."""


def rise(windows: Windows) -> Size | None:
    """The path's vertical acceleration over the thrust's [-]; None without inputs that vary."""
    if windows.lift is None:
        return None
    up = windows.lift[:, NOW] * windows.rotation[:, 2, 2]
    flown = up >= FALLING * np.median(up)
    windows = windows.some(flown)
    assert windows.lift is not None  # as above
    piece = pieces(windows)
    count = np.bincount(piece)

    def apart(values: np.ndarray) -> np.ndarray:
        return values - (np.bincount(piece, values) / count)[piece]

    lifts = windows.lift * windows.rotation[:, 2, 2, None]
    mean = np.stack([np.bincount(piece, lift) / count for lift in lifts.T], axis=1)[piece]
    if np.any(mean <= 0.0):
        return None
    given = np.stack([GRAVITY * apart(lift) for lift in (lifts / mean).T], axis=1)
    cross, square = (
        np.stack([np.bincount(piece, one) for one in products.T], axis=1)
        for products in (given * apart(windows.force[:, 2])[:, None], given**2)
    )
    if np.any(square.sum(axis=0) <= 0.0):
        return None
    lag = int(np.argmax(cross.sum(axis=0) ** 2 / square.sum(axis=0)))
    up, size = cross[:, lag], square[:, lag]
    some = np.flatnonzero(size > 0.0)
    return jackknife(len(some), lambda of: float(up[some[of]].sum() / size[some[of]].sum()))


def points_down(size: Size | None) -> bool:
    """Whether the path's z axis is shown to point down."""
    return size is not None and size.high < 0.0


def misplaced(velocity: Chosen | None, attitude: Chosen | None, down: bool) -> str | None:
    """The order and sign of the position's columns, if the position alone is wrong."""
    if velocity is None:
        return None
    tilted = attitude.names if attitude is not None else ()
    across = [PATHS[name] for name in tilted if name in PATHS] if tilted else [np.eye(2)]
    for name in velocity.names:
        matrix = ORDERS.get(name)
        if matrix is None or matrix[2, 2] != (-1.0 if down else 1.0):
            continue
        if any(np.array_equal(matrix[:2, :2], one) for one in across) and (tilted or down):
            return name
    return None


def of_position(words: str, evidence: tuple[Evidence, ...]) -> InterfaceFault:
    """The fault of position columns that hold other axes, or axes with the other sign."""
    matrix = ORDERS[words]
    wrong = [i for i in range(3) if matrix[i, i] != 1.0]
    columns = " and ".join(f"pos_{AXES[i]}" for i in wrong)
    moved = [i for i in wrong if matrix[i, i] == 0.0]
    flipped = " and ".join(AXES[i] for i in wrong if matrix[i].sum() < 0.0)
    if moved:
        said = " and ".join(AXES[i] for i in moved) + " of the position are exchanged"
        said += f", {flipped} with the opposite sign" if flipped else ""
    else:
        said = f"{flipped} of the position {'has' if len(wrong) == 1 else 'have'} the opposite sign"
    return InterfaceFault(
        part="position", readings=(words,), advice=f"{said}: check {columns}.", evidence=evidence
    )


def upside_down(evidence: tuple[Evidence, ...]) -> InterfaceFault:
    """The fault of a path that points down as a whole."""
    reading = "a path whose z axis points down"
    return InterfaceFault(
        part="position",
        readings=(reading,),
        advice=f"The position looks like {reading}: check pos_z and vel_z.",
        evidence=evidence,
    )


def risen(size: Size) -> Evidence:
    """The number that shows which way the path's z axis points."""
    return Evidence(
        quantity="vertical acceleration of the path over that of the thrust",
        value=size.value,
        low=size.low,
        high=size.high,
        unit="-",
        allowed="above 0",
    )


def in_units(windows: Windows) -> tuple[InterfaceFault | None, Windows]:
    """The fault of positions or velocities in another unit, and the windows in m and m/s.

    The path is compared with the tilt first, so that the velocity can be compared with the path.
    """
    speed, tilt = path_over_velocity(windows), path_over_tilt(windows)
    evidence, path, velocity = [], 1.0, 1.0
    if speed is not None:
        longer, shorter = speed[0].low > UNITS[1], speed[1].high < UNITS[0]
        size = speed[1] if shorter else speed[0]
        velocity = 1.0 / size.value if longer or shorter else 1.0
        evidence.append(sized("speed of the path over the logged one", size, "-", *UNITS, 1.0))
    if tilt is not None:
        path = tilt.value if tilt.low > UNITS[1] else 1.0
        what = "acceleration across the path over what tilt and weight make"
        evidence.append(sized(what, tilt, "-", *UNITS, 1.0))
    velocity *= path
    if path == velocity == 1.0:
        return None, windows
    if path == 1.0:
        return _of_velocity(velocity, tuple(evidence)), _in_metres(windows, path, velocity)
    in_m_per_s = UNITS[0] < velocity < UNITS[1]
    fault = InterfaceFault(
        part="position",
        readings=("a position in another unit than metres",),
        advice=f"The position moves {path:.2g} times as far as the drone's tilt makes it: check "
        f"pos_x to pos_z{'' if in_m_per_s else ' and vel_x to vel_z'}.{_guess(path, FEET)}",
        evidence=tuple(evidence),
    )
    return fault, _in_metres(windows, path, velocity)


def _of_velocity(factor: float, evidence: tuple[Evidence, ...]) -> InterfaceFault:
    guess = _guess(factor, SPEEDS) or _guess(1.0 / factor, FEET)
    return InterfaceFault(
        part="velocity",
        readings=("a velocity in another unit than the path's",),
        advice=f"The logged velocity is {factor:.2g} times the speed of the path: check the units "
        f"of vel_x to vel_z and pos_x to pos_z.{guess}",
        evidence=evidence,
    )


def _guess(factor: float, units: Mapping[str, float]) -> str:
    """Units that make numbers about `factor` times too large, as a question."""
    near = [name for name, size in units.items() if 1.0 / NEAR < factor / size < NEAR]
    return f" Is it in {' or '.join(near)}?" if near else ""


def _in_metres(windows: Windows, path: float, velocity: float) -> Windows:
    """The windows of a path in `path` units a metre, and a velocity in `velocity` units a m/s."""
    weight = np.asarray([0.0, 0.0, GRAVITY])
    return dataclasses.replace(
        windows,
        force=(windows.force - weight) / path + weight,
        path=windows.path / path,
        vel=windows.vel / velocity,
        turned_vel=windows.turned_vel / velocity,
    )
