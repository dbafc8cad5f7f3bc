r"""Short windows of flights, in which columns that say the same thing are compared.

Positions p in a window of `LENGTH` are fitted by a cubic of time. Its second derivative is the mean
of the acceleration under the weight (1 - tau^2)^2, tau in [-1, 1] over the window, so that every
other column is averaged with that weight:

| symbol | field | |
|---|---|---|
| a + g e3 | `force` | specific force, world [m/s^2] |
| R e3 | `axis` | thrust axis, world [-] |
| (p(t1) - p(t0)) / (t1 - t0) | `path` | mean velocity, world [m/s] |
| log(R0^T R1) / (t1 - t0) | `turn` | mean angular velocity, body [rad/s] |

Windows do not overlap, so that their errors are nearly independent. Those with a hole, on the
ground, or with a path that no cubic follows are left out.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from diagnosis.logs.flights import DroneLog, FlightLog
from simulators.vehicle import GRAVITY

LENGTH = 0.3
"""Length of a window [s]: a millimetre of noise in a row is 0.05 m/s^2 of acceleration in it."""
FEWEST_ROWS = 8
"""Fewest rows in a window: four more than a cubic takes."""
HOLE = 0.25
"""Largest hole in a window, as a share of it."""
ROUGH = 6.0
"""A path whose cubic leaves more than this over the median of all windows is a throw or a crash."""
LIFT_LAGS = np.round(np.arange(-0.3, 0.301, 0.1), 6)
"""Times by which inputs are shifted against the path [s], for clocks that are off and slow motors;
a steady climb and descent in less than twice the largest is rare."""
LOW = (0.15, 0.3)
"""Height [m] above the lowest row and speed [m/s] below which a drone may stand on the ground."""


@dataclasses.dataclass(frozen=True)
class Windows:
    """Columns averaged over windows."""

    flight: Int[np.ndarray, " windows"]
    """Which drone of which flight, counted."""
    force: Float[np.ndarray, "windows 3"]
    """Specific force of the path, world [m/s^2]."""
    path: Float[np.ndarray, "windows 3"]
    """Mean velocity of the path, world [m/s]."""
    turn: Float[np.ndarray, "windows 3"]
    """Mean angular velocity of the attitude, body [rad/s]."""
    rotation: Float[np.ndarray, "windows 3 3"]
    """Mean rotation matrix, body to world."""
    vel: Float[np.ndarray, "windows 3"]
    """Logged velocity."""
    turned_vel: Float[np.ndarray, "windows 3 3 3"]
    """Mean of R_ij v_k."""
    ang_vel: Float[np.ndarray, "windows 3"] | None
    """Logged angular velocity."""
    turned_ang_vel: Float[np.ndarray, "windows 3 3 3"] | None
    """Mean of R_ji w_k."""
    acc: Float[np.ndarray, "windows 3"] | None
    """Logged specific force."""
    turned_acc: Float[np.ndarray, "windows 3 3 3"] | None
    """Mean of R_ij f_k."""
    thrust: Float[np.ndarray, " windows"] | None
    """Thrust that the inputs stand for [N]."""
    lift: Float[np.ndarray, "windows lags"] | None
    """What rises and falls with the thrust, in any unit, `LIFT_LAGS` earlier."""

    def __len__(self) -> int:
        return len(self.flight)

    def some(self, chosen: Bool[np.ndarray, " windows"]) -> "Windows":
        """The chosen windows."""
        values: dict[str, Any] = {
            name: None if value is None else value[chosen] for name, value in vars(self).items()
        }
        return Windows(**values)


def make_windows(
    flights: Sequence[FlightLog],
    thrusts: Sequence[Float[np.ndarray, " _rows"] | None],
    lifts: Sequence[Float[np.ndarray, " _rows"] | None],
) -> Windows | None:
    """All windows of all drones, None where there is none.

    `thrusts` has the thrust of each drone's inputs [N], `lifts` the same in any unit.

    A column counts only if every drone has it.
    """
    drones = [drone for flight in flights for drone in flight.drones]
    rows: list[dict[str, np.ndarray | float | int | None]] = []
    rough: list[float] = []
    for number, (drone, thrust, lift) in enumerate(zip(drones, thrusts, lifts, strict=True)):
        earlier = None if lift is None else _earlier(drone, lift)
        for at in _stretches(drone):
            row, left = _window(drone, thrust, earlier, at)
            rows.append({"flight": number, **row})
            rough.append(left)
    if not rows:
        return None
    whole = [name for name in rows[0] if all(row[name] is not None for row in rows)]
    columns: dict[str, Any] = {
        n: np.asarray([row[n] for row in rows]) if n in whole else None for n in rows[0]
    }
    smooth = np.asarray(rough) <= ROUGH * np.median(rough)
    return Windows(**columns).some(smooth)


def _stretches(drone: DroneLog) -> list[slice]:
    """Rows of each window of a drone's flight."""
    t = drone.t
    edges = np.arange(t[0], t[-1] + 1e-9, LENGTH)
    found = []
    for start, stop in itertools.pairwise(edges):
        a, b = np.searchsorted(t, [start, stop])
        b = min(int(b) + 1, len(t))
        if b - a < FEWEST_ROWS or np.diff(t[a:b]).max() > HOLE * LENGTH:
            continue
        height, speed = drone.pos[a:b, 2] - drone.pos[:, 2].min(), np.ptp(drone.pos[a:b], axis=0)
        if height.max() < LOW[0] and np.linalg.norm(speed) < LOW[1] * LENGTH:
            continue
        found.append(slice(int(a), b))
    return found


def _window(
    drone: DroneLog, thrust: np.ndarray | None, earlier: np.ndarray | None, at: slice
) -> tuple[dict[str, np.ndarray | float | None], float]:
    """Columns of one window, and the RMS that a cubic leaves of its path [m]."""
    t = drone.t[at]
    middle, half = 0.5 * (t[0] + t[-1]), 0.5 * (t[-1] - t[0])
    tau = (t - middle) / half
    basis = tau[:, None] ** np.arange(4)
    cubic, *_ = np.linalg.lstsq(basis, drone.pos[at], rcond=None)
    # Rows come at uneven times; each stands for the time around it.
    weight = (1.0 - tau**2) ** 2 * np.gradient(t)
    weight /= weight.sum()
    turns = Rotation.from_quat(drone.quat[at])
    R = turns.as_matrix()
    step = np.gradient(t) / np.gradient(t).sum()
    rate = (turns[0].inv() * turns[-1]).as_rotvec() / (2.0 * half)
    row: dict[str, np.ndarray | float | None] = {
        "force": 2.0 * cubic[2] / half**2 + np.asarray([0.0, 0.0, GRAVITY]),
        "path": (drone.pos[at][-1] - drone.pos[at][0]) / (2.0 * half),
        "turn": rate,
        "rotation": np.einsum("t,tij->ij", weight, R),
        "vel": step @ drone.vel[at],
        "turned_vel": np.einsum("t,tij,tk->ijk", step, R, drone.vel[at]),
    }
    for name, kernel, turned in (("ang_vel", step, R.transpose(0, 2, 1)), ("acc", weight, R)):
        value = getattr(drone, name)
        known = value is not None
        row[name] = kernel @ value[at] if known else None
        row[f"turned_{name}"] = (
            np.einsum("t,tij,tk->ijk", kernel, turned, value[at]) if known else None
        )
    row["thrust"] = None if thrust is None else float(weight @ thrust[at])
    row["lift"] = None if earlier is None else weight @ earlier[at]
    return row, float(np.sqrt(np.mean((basis @ cubic - drone.pos[at]) ** 2)))


def _earlier(drone: DroneLog, lift: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "rows lags"]:
    """The lift as it was `LIFT_LAGS` earlier."""
    return np.stack([np.interp(drone.t - lag, drone.t, lift) for lag in LIFT_LAGS], axis=1)
