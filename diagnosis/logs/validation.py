"""One drone's columns checked for what no flight log can hold: holes, time, attitude.

Units are `diagnosis.logs.units`'s business. Every check raises at the first thing that is wrong;
rows are counted from 1 over the whole file, whichever drone they belong to.
"""

import numpy as np
from jaxtyping import Float64, Int

from diagnosis.logs.columns import GROUPS, LogError
from diagnosis.logs.table_files import Columns
from diagnosis.logs.units import check_units
from simulators.vehicle import VehicleSpec

MIN_ROWS = 50
"""Fewest rows of a drone; a guess, a second at 50 Hz, below which no window repeats."""

MIN_SECONDS = 1.0
"""Shortest flight of a drone [s]; two horizons of the drift that a diagnosis reports."""

LEAST_STEP = 1e-4
"""Smallest median time between two rows that any log has [s]; tells the unit of wrong times."""

MAX_STEP = 0.2
"""Largest median time between two rows [s]; no attitude loop can be seen at a slower rate."""

MAX_GAP = 600.0
"""Longest time without a row [s]; no battery lasts longer in the air."""

NORM_TOLERANCE = 1e-2
"""Largest deviation of a quaternion's norm from 1; printing three decimals deviates by 1e-3."""


def split_drones(columns: Columns, mass: float, spec: VehicleSpec) -> list[Columns]:
    """The checked columns of each drone by rising number, quaternions normed and continuous.

    Args:
        columns: All rows of a file.
        mass: What the operator believes that a drone weighs [kg].
        spec: The airframe.

    Raises:
        LogError: The numbers cannot be those of a flight. The message does not name the file.
    """
    check_finite(columns)
    drones = []
    for number, rows in _rows_of_drones(columns):
        drone = {name: values[rows] for name, values in columns.items() if name != "drone"}
        who = "" if number is None else f" of drone {number}"
        check_time(drone["t"], rows, who)
        check_moving(drone, who)
        quat = np.stack([drone[name] for name in GROUPS["quat"]], axis=1)
        quat = continuous_quat(quat, rows)
        drone.update(zip(GROUPS["quat"], quat.T, strict=True))
        check_upright(quat, who)
        check_units(drone, rows, mass, spec)
        drones.append(drone)
    return drones


def check_finite(columns: Columns) -> None:
    """Nothing, if every number is finite.

    Raises:
        LogError: There is a NaN, an empty cell or an infinity.
    """
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            what = "NaN or empty" if np.isnan(values[bad[0]]) else "infinite"
            raise LogError(
                f"column '{name}', row {bad[0] + 1}: {what}; a finite number is expected"
                f"{_more(bad.size, len(values))}."
            )


def check_time(t: Float64[np.ndarray, " rows"], rows: Int[np.ndarray, " rows"], who: str) -> None:
    """Nothing, if the times of one drone are enough, and increase.

    Raises:
        LogError: There are too few rows or seconds, time stands, goes backwards, jumps or cannot be
            in seconds.
    """
    if len(t) < MIN_ROWS:
        raise LogError(f"only {len(t)} rows{who}; at least {MIN_ROWS} are expected.")
    step = np.diff(t)
    bad = np.flatnonzero(step <= 0.0)
    if bad.size:
        k = bad[0]
        what = "is repeated" if step[k] == 0.0 else "goes backwards"
        raise LogError(
            f"column 't', row {rows[k + 1] + 1}: time{who} {what} ({t[k + 1]:.6g} s after "
            f"{t[k]:.6g} s); it must increase from row to row{_more(bad.size, len(step))}."
        )
    if np.median(step) > MAX_STEP:
        units = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
        median = float(np.median(step))
        likely = [unit for unit, s in units.items() if LEAST_STEP <= s * median <= MAX_STEP]
        hint = f" Is it in {' or '.join(likely)}?" if likely else ""
        raise LogError(
            f"column 't': the median time between rows{who} is {median:.4g}; at most "
            f"{MAX_STEP} s is expected.{hint}"
        )
    if step.max() > MAX_GAP:
        k = int(np.argmax(step))
        raise LogError(
            f"column 't', row {rows[k + 1] + 1}: {step[k]:.4g} s without a row{who}; at most "
            f"{MAX_GAP:g} s are expected within a flight. Did the clock jump?"
        )
    if t[-1] - t[0] < MIN_SECONDS:
        raise LogError(
            f"column 't': only {t[-1] - t[0]:.3g} s of flight{who}; at least {MIN_SECONDS} s are "
            f"expected."
        )


def check_moving(drone: Columns, who: str) -> None:
    """Nothing, if position or attitude change at all.

    Raises:
        LogError: They do not, which no sensor in the air reports.
    """
    if not any(np.ptp(drone[name]) for name in (*GROUPS["pos"], *GROUPS["quat"])):
        raise LogError(
            f"columns pos_x to quat_w: position and attitude{who} never change; a flight is "
            "expected. Did the logging or the positioning system stop?"
        )


def continuous_quat(
    quat: Float64[np.ndarray, "rows 4"], rows: Int[np.ndarray, " rows"]
) -> Float64[np.ndarray, "rows 4"]:
    """Unit quaternions of the same attitudes, none of them opposite to the one before it.

    Raises:
        LogError: A norm is too far from 1.
    """
    norm = np.linalg.norm(quat, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > NORM_TOLERANCE)
    if bad.size:
        raise LogError(
            f"columns quat_x to quat_w, row {rows[bad[0]] + 1}: the quaternion's norm is "
            f"{norm[bad[0]]:.4g}; 1 +- {NORM_TOLERANCE} is expected{_more(bad.size, len(norm))}."
        )
    quat = quat / norm[:, None]
    flips = np.where(np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0.0, -1.0, 1.0)
    return quat * np.concatenate([[1.0], np.cumprod(flips)])[:, None]


def check_upright(quat: Float64[np.ndarray, "rows 4"], who: str) -> None:
    """Nothing, if the drone is tilted by less than 60 degrees most of the time.

    Raises:
        LogError: It is not, which is what a quaternion with its scalar first looks like.
    """
    x, y, z, _ = quat.T
    cos_tilt = np.median(1.0 - 2.0 * (x**2 + y**2))
    if cos_tilt < 0.5:
        swapped = np.median(1.0 - 2.0 * (y**2 + z**2))  # were x the scalar, y and z were x and y
        hint = " It looks as if quat_x held the scalar." if swapped > 0.5 else ""
        raise LogError(
            f"columns quat_x to quat_w: the median tilt{who} is "
            f"{np.degrees(np.arccos(cos_tilt)):.0f} degrees; less than 60 is expected, with the "
            f"scalar last (quat_w) and from body to world, z up.{hint}"
        )


def _rows_of_drones(columns: Columns) -> list[tuple[int | None, Int[np.ndarray, " _rows"]]]:
    """Each drone's number, None where there is but one, with its rows counted from 0."""
    if "drone" not in columns or len(columns["t"]) == 0:
        return [(None, np.arange(len(columns["t"])))]
    drone = columns["drone"]
    bad = np.flatnonzero(drone != np.round(drone))
    if bad.size:
        raise LogError(
            f"column 'drone', row {bad[0] + 1}: {drone[bad[0]]:.6g}; an integer is expected."
        )
    order = np.argsort(drone, kind="stable")
    numbers, starts = np.unique(drone[order], return_index=True)
    return list(zip(map(int, numbers), np.split(order, starts[1:]), strict=True))


def _more(bad: int, total: int) -> str:
    """How many rows have the same fault, where it is more than the one that is named."""
    return f" ({bad} of {total} rows are like this)" if bad > 1 else ""
