"""One drone's columns checked for units that cannot be.

Two kinds of check. A limit that no quadrotor exceeds is broken by a row, which is named. A
ratio of two columns that measure the same thing, or of a column and what hovering takes, is broken
by a column as a whole: its median over the windows in which there is enough motion to tell is off
by more than an order of magnitude, because the units that are mistaken for one another differ by
57 (degrees), 9.81 (g), 1000 (milli) or more. All limits are guesses, chosen far outside of what
such a vehicle does and of what the effects that a diagnosis looks for make of it.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int

from diagnosis.logs.airframes import CRAZYFLIES, RPM
from diagnosis.logs.columns import GROUPS, LogError
from diagnosis.logs.table_files import Columns
from simulators.vehicle import GRAVITY, VehicleSpec

FOOT, MILE, KNOT = 0.3048, 1609.344, 1852.0 / 3600.0
"""International foot and mile [m], and knot [m/s]."""

RATE_WINDOW_S = 0.2
"""Time over which rates are summed up and compared with what they are rates of [s]."""

MAX_SPEED = 50.0
"""Largest velocity along an axis [m/s]."""

MAX_ANG_VEL = 60.0
"""Largest angular velocity about an axis [rad/s]; a Crazyflie's gyroscope ends at 35 rad/s."""

ROTOR_VEL = (0.5, 2.0)
"""Smallest 90 % quantile of a rotor's speeds over the speed that hovers, and largest speed over
that of full thrust, by the airframe's curve. Revolutions per second are 0.16 of rad/s; rev/min are
9.5 times rad/s, and full thrust takes at most 4.5 times the speed that hovers."""

CELL = (2.0, 5.0)
"""Voltages of the one cell that a Crazyflie flies on [V]; voltage then makes its thrust of PWM."""

BATTERY = (2.0, 60.0)
"""Voltages of batteries elsewhere [V]: from one empty cell to 14 full ones."""

PACKS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 14)
"""Usual numbers of cells in series; a full one has 4.2 V, at most `FULL_CELL`."""
FULL_CELL = 4.35
"""Voltage of a full cell of the kind that is charged highest, lithium polymer HV [V]."""

MAX_THRUST = 4.0
"""Largest commanded thrust over what the rotors can do; a reserve above full thrust is usual."""

HOVER = (0.3, 5.0)
"""Median commanded thrust over weight; one rotor's share of it would be 0.25."""

ACC = (5.0, 30.0)
"""Median specific force of a flight [m/s^2]; hovering takes 9.81 m/s^2, one g."""

Series = Float64[np.ndarray, " rows"]
Rows = Int[np.ndarray, " rows"]


def check_units(drone: Columns, rows: Rows, mass: float, spec: VehicleSpec) -> None:
    """Nothing, if the numbers of one drone can be in the units that the format asks for.

    Args:
        drone: The columns of one drone: finite, time increasing, quaternions normed.
        rows: Where each row stands in the file, from 0.
        mass: What the operator believes that the drone weighs [kg].
        spec: The airframe.

    Raises:
        LogError: They cannot. The message does not name the file.
    """
    _check_motion(drone, rows)
    if "ang_vel_x" in drone:
        _check_ang_vel(drone, rows)
    if "acc_x" in drone:
        _check_acc(drone)
    if "cmd_roll" in drone:
        _check_angles(drone, rows)
    if "cmd_thrust" in drone:
        _check_thrust(drone, rows, mass, spec)
    if "rotor_vel_1" in drone:
        _check_rotors(drone, rows, mass, spec)
    if "pwm_1" in drone:
        _check_pwm(drone, rows)
    if "battery" in drone:
        one_cell = "pwm_1" in drone and spec.name in CRAZYFLIES
        _check_voltage(drone["battery"], rows, one_cell)


def _check_motion(drone: Columns, rows: Rows) -> None:
    """Positions and velocities, each for itself and against one another."""
    knots, whole = _windows(drone["t"])
    moved = np.linalg.norm(np.diff(_stack(drone, "pos")[knots], axis=0), axis=1)
    ratio, size = _ratio(moved[whole], _run(drone, "vel", knots)[whole])
    if ratio > 30.0 and size[0] > 0.1:
        raise LogError(
            f"columns pos_x to pos_z: positions move {_times(ratio)} as far as the velocities "
            f"say; m and m/s are expected.{_milli(ratio, 'positions', 'millimetres')}"
        )
    inverse = 1.0 / max(ratio, 1e-9)
    if inverse > 30.0 and size[1] > 0.1:
        raise LogError(
            f"columns vel_x to vel_z: velocities say {_times(inverse)} what the positions move; "
            f"m/s and m are expected.{_milli(inverse, 'velocities', 'mm/s')}"
        )
    for name in GROUPS["vel"]:
        _range(name, drone[name], rows, (-MAX_SPEED, MAX_SPEED), "m/s", "Is it in mm/s?")


def _check_ang_vel(drone: Columns, rows: Rows) -> None:
    """Angular velocities, for themselves and against the turning of the attitude."""
    hint = "Are they in degrees per second?"
    for name in GROUPS["ang_vel"]:
        _range(name, drone[name], rows, (-MAX_ANG_VEL, MAX_ANG_VEL), "rad/s", hint)
    knots, whole = _windows(drone["t"])
    quat = _stack(drone, "quat")[knots]
    dot = np.abs(np.einsum("ij,ij->i", quat[1:], quat[:-1]))
    turned = 2.0 * np.arccos(np.minimum(dot, 1.0))
    ratio, size = _ratio(_run(drone, "ang_vel", knots)[whole], turned[whole])
    if ratio > 15.0 and size[0] > 0.2:
        raise LogError(
            f"columns ang_vel_x to ang_vel_z: they say {_times(ratio)} what the attitude turns; "
            f"rad/s is expected. {hint}"
        )


def _check_acc(drone: Columns) -> None:
    """Specific forces: about one g, upwards in the body."""
    size = np.median(np.linalg.norm(_stack(drone, "acc"), axis=1))
    if not ACC[0] <= size <= ACC[1]:
        guess = {"g": 1.0, "milli-g": 1000.0, "mm/s^2": 1000.0 * GRAVITY}
        unit = _closest(size, guess, 0.5)
        hint = f" Is it in {unit}?" if unit else ""
        if size < 0.5:
            hint = " Was gravity taken out?"
        raise LogError(
            f"columns acc_x to acc_z: the median specific force is {size:.4g}; about "
            f"{GRAVITY} m/s^2 is expected, gravity's share included.{hint}"
        )
    if np.median(drone["acc_z"]) < 0.0:
        raise LogError(
            f"column 'acc_z': its median is {np.median(drone['acc_z']):.4g} m/s^2; about "
            f"+{GRAVITY} is expected, because the specific force of a hovering drone points up."
        )


def _check_angles(drone: Columns, rows: Rows) -> None:
    """Commanded angles, for themselves and against the attitude that was flown."""
    hint = "Are they in degrees?"
    for name in ("cmd_roll", "cmd_pitch"):
        _range(name, drone[name], rows, (-np.pi, np.pi), "rad", hint)
    x, y, z, w = _stack(drone, "quat").T
    flown = {
        "cmd_roll": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "cmd_pitch": np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)),
    }
    asked = np.quantile(np.hypot(drone["cmd_roll"], drone["cmd_pitch"]), 0.9)
    tilt = np.quantile(np.hypot(flown["cmd_roll"], flown["cmd_pitch"]), 0.9)
    if asked > 0.3 and asked > 15.0 * tilt:
        raise LogError(
            f"columns cmd_roll and cmd_pitch: they ask for {_times(asked / max(tilt, 1e-9))} the "
            f"tilt that was flown; rad is expected. {hint}"
        )
    yaw, cmd = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), drone["cmd_yaw"]
    far = np.flatnonzero(np.abs(cmd) > np.pi)
    if far.size and _off(cmd, yaw) > 0.5 and _off(np.radians(cmd), yaw) < 0.2:
        raise LogError(
            f"column 'cmd_yaw', row {rows[far[0]] + 1}: {cmd[far[0]]:.4g}; rad is expected, and "
            f"only taken as degrees the column follows the yaw that was flown."
        )


def _check_thrust(drone: Columns, rows: Rows, mass: float, spec: VehicleSpec) -> None:
    """The commanded thrust against what hovering takes and what the rotors can do."""
    thrust, hover = drone["cmd_thrust"], mass * GRAVITY
    median = np.median(thrust[thrust > 0.0]) if (thrust > 0.0).any() else 0.0
    if HOVER[0] * hover <= median <= min(HOVER[1] * hover, 1.25 * spec.thrust_max):
        _range("cmd_thrust", thrust, rows, (-0.01, MAX_THRUST * spec.thrust_max), "N", "")
        return
    guess = {"newtons per rotor": hover / 4, "kilograms": mass, "grams": 1000.0 * mass}
    unit = _closest(median, guess, 0.4)
    if unit is None and 0.0 < median <= 1.0:
        unit = "a share of full thrust (0 to 1)"
    if unit is None and median > 1.0:
        unit = "percent" if median <= 100.0 else "PWM (0 to 65535)" if median <= 65535.0 else None
    raise LogError(
        f"column 'cmd_thrust': the median of what is commanded is {median:.4g}; newtons are "
        f"expected, about {hover:.3g} N to hover with {mass:g} kg."
        + (f" Is it in {unit}?" if unit else "")
    )


def _check_rotors(drone: Columns, rows: Rows, mass: float, spec: VehicleSpec) -> None:
    """Rotor speeds, where the airframe's curve says which speeds carry it."""
    if not any(spec.rpm2thrust):
        return
    hover = _rotor_speed(mass * GRAVITY, spec)
    least, most = ROTOR_VEL[0] * hover, ROTOR_VEL[1] * _rotor_speed(spec.thrust_max, spec)
    for name in GROUPS["rotor_vel"]:
        values = drone[name]
        _range(name, values, rows, (0.0, most), "rad/s", "Is it in rpm?")
        if np.quantile(values, 0.9) < least:
            raise LogError(
                f"column '{name}': 90 % of the rotor speeds are below "
                f"{np.quantile(values, 0.9):.4g}; this airframe hovers with {hover:.4g} rad/s by "
                f"its thrust curve. Is it in revolutions per second?"
            )


def _rotor_speed(thrust: float, spec: VehicleSpec) -> float:
    """The speed [rad/s] at which four rotors make a collective thrust [N] by the curve.

    Raises:
        LogError: They make it at none.
    """
    c0, c1, c2 = spec.rpm2thrust
    roots = np.roots([c2, c1, c0 - thrust / 4.0])
    speeds = [float(root.real) for root in roots if root.real > 0.0 and abs(root.imag) < 1e-9]
    if not speeds:
        raise LogError(
            f"[airframe]: by the thrust_curve {list(spec.rpm2thrust)} four rotors make {thrust:.3g}"
            f" N at no speed. It is in N of one rotor over rev/min, the constant term first."
        )
    return min(speeds) / RPM


def _check_pwm(drone: Columns, rows: Rows) -> None:
    """Motor duty commands."""
    for name in GROUPS["pwm"]:
        top = drone[name].max()
        full = next((f for f in (100, 255, 65535) if top <= f), None)
        hint = f"Is it 0 to {full}?" if full and top > 1.0 else ""
        _range(name, drone[name], rows, (-1e-3, 1.001), "(share of full duty)", hint)
        if top <= 0.0:
            raise LogError(f"column '{name}': it is never above 0; 0 to 1 is expected.")


def _check_voltage(volts: Series, rows: Rows, one_cell: bool) -> None:
    """The battery's voltage."""
    hint = "Is it in millivolts?" if np.median(volts) > 1000.0 else ""
    if one_cell:
        hint = hint or "How duty becomes thrust is known of one cell alone."
    _range("battery", volts, rows, CELL if one_cell else BATTERY, "V", hint)


def cells(highest: float) -> int:
    """Cells in series of a battery, by the highest voltage of all flights [V].

    The smallest usual number that can be charged so far. It is too small only where every flight
    begins nearly empty: below 3.6 V a cell for 6 cells, 3.3 V for 4.
    """
    if highest <= CELL[1]:
        return 1
    return next((n for n in PACKS if highest <= n * FULL_CELL), PACKS[-1])


def _range(
    name: str, values: Series, rows: Rows, allowed: tuple[float, float], unit: str, hint: str
) -> None:
    """Nothing, if the values are in the allowed range; the first that is not is named."""
    bad = np.flatnonzero((values < allowed[0]) | (values > allowed[1]))
    if bad.size:
        low, high = (round(limit, 2) + 0.0 for limit in allowed)
        raise LogError(
            f"column '{name}', row {rows[bad[0]] + 1}: {values[bad[0]]:.5g}; {low:g} to {high:g} "
            f"{unit} is expected. {hint}".rstrip()
        )


def _stack(drone: Columns, group: str) -> Float64[np.ndarray, "rows axes"]:
    """The columns of a group side by side."""
    return np.stack([drone[name] for name in GROUPS[group]], axis=1)


def _windows(t: Series) -> tuple[Int[np.ndarray, " knots"], Bool[np.ndarray, " windows"]]:
    """Rows about `RATE_WINDOW_S` apart, and between which of them there is no gap."""
    stride = max(1, round(RATE_WINDOW_S / float(np.median(np.diff(t)))))
    knots = np.arange(0, len(t), stride)
    return knots, np.diff(t[knots]) < 2.0 * stride * np.median(np.diff(t))


def _run(
    drone: Columns, group: str, knots: Int[np.ndarray, " knots"]
) -> Float64[np.ndarray, " windows"]:
    """How far the integral of three rates goes from knot to knot."""
    rate = _stack(drone, group)
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(drone["t"])[:, None]
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return np.linalg.norm(np.diff(total[knots], axis=0), axis=1)


def _ratio(
    a: Float64[np.ndarray, " windows"], b: Float64[np.ndarray, " windows"]
) -> tuple[float, tuple[float, float]]:
    """The median of a/b, and the medians of a and of b, over windows in which most happens.

    Most happens where the one of both that is larger as a whole exceeds half its 90 % quantile.
    """
    if not len(a):
        return 1.0, (0.0, 0.0)
    leading = a if np.median(a) > np.median(b) else b
    most = leading >= 0.5 * np.quantile(leading, 0.9)
    ratio = np.median(a[most] / np.maximum(b[most], 1e-12))
    return float(ratio), (float(np.median(a[most])), float(np.median(b[most])))


def _milli(ratio: float, what: str, unit: str) -> str:
    """The question whether `what` is in thousandths, where the ratio is about a thousand."""
    return f" Are {what} in {unit}?" if 300.0 < ratio < 3000.0 else ""


def _times(ratio: float) -> str:
    """A ratio in words."""
    return f"{ratio:.4g} times" if ratio < 1e4 else "more than 10000 times"


def _off(angle: Series, reference: Series) -> float:
    """The median distance between two angles on the circle [rad]."""
    return float(np.median(np.abs(np.angle(np.exp(1j * (angle - reference))))))


def _closest(value: float, guesses: dict[str, float], tolerance: float) -> str | None:
    """The name of the guess nearest to `value`, None where all are further than `tolerance`."""
    name = min(guesses, key=lambda key: abs(value / guesses[key] - 1.0))
    return name if abs(value / guesses[name] - 1.0) <= tolerance else None
