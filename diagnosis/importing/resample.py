"""Streams with clocks of their own become rows on one clock.

Where all streams of a drone share one clock, its rows are kept as they are. Elsewhere rows stand at
equal distances, as fast as the slowest of position, velocity and attitude, so that no measurement
is counted more than once; but at `RATES` at least, for the commands:

- what was measured is interpolated by cubic splines between its neighbours (an attitude by its
  quaternion, normed again), battery voltage by straight lines;
- a command is held until the next one. A row takes its mean until the next row, which neither
  delays it nor loses any of it;
- a hole stays a hole: no row is made where neighbours are further apart than `HOLE` periods.

A velocity that was not logged is derived from position by local quadratic fits.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline

from diagnosis.importing.frames import is_attitude
from diagnosis.importing.reader import FIELDS, Stream
from diagnosis.logs.columns import LogError
from diagnosis.logs.table_files import Columns

RATES = (50.0, 500.0)
"""Slowest and fastest rate of rows [Hz]: nodes of a replay stand at 50 Hz
(`diagnosis.logs.segments`); crazyflow steps at 500 Hz."""
LONGEST_BACK_S = 1.0
"""Longest step back in time that is taken for a late message [s]; a choice. Another log that is
appended to a file begins anew."""
HOLE = 2.5
"""Distance of neighbours, in periods, from which there is a hole; one lost message is bridged, two
are not. A choice."""
BURST = 8
"""Steps over whose mean a period is taken, since messages may come in bursts; a choice."""
BACKWARDS = 0.01
"""Share of rows that may come out of order, as messages over a radio do; a choice."""
VEL_SPAN = 0.06
"""Half the span of the fits that derive a velocity [s]; that of a window's start
(`diagnosis.logs.segments`)."""
LARGEST_NUMBER = 1e5
"""Largest number in a log in our units; a rotor turns at 1e4 rad/s, a day has 86,400 s."""
FEWEST_ROWS = 4
"""Fewest rows of a stream that can be interpolated."""
ONE_CLOCK = 1e-7
"""Clocks that differ by less are one clock [s]; below a microsecond, the finest that logs count."""
REQUIRED = ("pos", "quat")
"""Fields without which nothing can be said about a flight; a velocity may be derived."""
INPUTS = (("cmd_angles", "cmd_thrust"), ("rotor_vel",), ("pwm", "battery"), ("cmd_thrust",))
"""Fields that drive a replay, any one group of them, the preferred group first."""
MEASURED = ("pos", "vel", "quat")
"""Fields that a replay is compared with."""
SLOW = 0.75
"""Share of the rows' rate below which a measurement is slower than they are; clocks jitter."""
HELD = ("cmd_angles", "cmd_thrust", "pwm")
"""Fields that hold until the next row."""


@dataclasses.dataclass(frozen=True)
class Taken:
    """What became of one stream."""

    field: str
    source: str
    change: str
    """What was done to units and frames."""
    rate: float
    """Rate of its rows [Hz]."""
    resampling: str
    """How its rows became those of the flight."""
    dropped: int
    """Rows without a number or an attitude, or at a time that was there before."""
    hole: float
    """Longest time between two of its rows [s]."""


@dataclasses.dataclass(frozen=True)
class Rows:
    """One drone's rows."""

    columns: Columns
    """The format's columns; time from the start of the recording."""
    taken: tuple[Taken, ...]
    notes: tuple[str, ...]


def make_rows(streams: Sequence[Stream], zero: float) -> Rows:
    """Rows of one drone, time counted from `zero` [s].

    Raises:
        LogError: A field is missing, or streams do not overlap.
    """
    clean, dropped, notes = _cleaned(streams)
    inputs = _inputs(clean, notes)
    if "cmd_angles" in clean and "cmd_thrust" not in clean:
        notes.append("The commanded attitude is left out: no commanded thrust was found beside it.")
        del clean["cmd_angles"]
    if "vel" in clean and _rate(clean["vel"].t) < SLOW * min(RATES[0], _rate(clean["pos"].t)):
        notes.append(f"The velocity is slower than the position: {clean['vel'].source}.")
        del clean["vel"]
    if "vel" not in clean:
        clean["vel"] = _derived_vel(clean["pos"])
        notes.append(
            "No usable velocity was logged: it is derived from positions within "
            f"{VEL_SPAN:g} s, so that its noise is not that of a measurement."
        )
    needed = [clean[name] for name in (*REQUIRED, "vel", *inputs)]
    t = _shared_clock(needed)
    resampled = t is None
    if t is None:
        t = _even_clock(needed)
    columns: Columns = {"t": t - zero}
    taken = []
    for name, stream in clean.items():
        values = _at(t, stream)
        if name not in inputs and not np.isfinite(values).all():
            notes.append(f"{name} does not cover the flight and is left out: {stream.source}.")
            continue
        columns |= dict(zip(FIELDS[name], values.T, strict=True))
        how, hole = _how(name, stream, t, resampled), float(np.diff(stream.t).max())
        said = (name, stream.source, stream.change, _rate(stream.t))
        taken.append(Taken(*said, how, dropped.get(name, 0), hole))
    slowest = min((clean[name] for name in MEASURED), key=lambda stream: _rate(stream.t))
    if _rate(slowest.t) < SLOW * _rate(t):
        columns["interpolated"] = _between(t, slowest.t)
    notes += _low_rates(clean, t)
    return Rows(columns, tuple(taken), tuple(notes))


def _cleaned(
    streams: Sequence[Stream],
) -> tuple[dict[str, Stream], dict[str, int], list[str]]:
    """Each field's stream in order of time without empty rows, how many rows went, and notes."""
    clean, dropped, notes = {}, {}, []
    for stream in streams:
        good = np.isfinite(stream.values).all(axis=1) & np.isfinite(stream.t)
        if stream.field == "quat":
            good &= is_attitude(stream.values)
        t, values = stream.t[good], stream.values[good]
        steps = np.diff(t)
        back = steps < 0.0
        if len(steps) and (back.mean() > BACKWARDS or steps.min() < -LONGEST_BACK_S):
            raise LogError(
                f"{stream.source}: time goes backwards {int(back.sum())} times; are there two logs "
                f"in one file?"
            )
        if len(t) and max(np.abs(values).max(), np.ptp(t)) > LARGEST_NUMBER:
            raise LogError(
                f"{stream.source}: a number is beyond {LARGEST_NUMBER:g}; the log is damaged."
            )
        order = np.argsort(t, kind="stable")
        t, values = t[order], values[order]
        new = np.concatenate([[True], np.diff(t) > 0.0]) if len(t) else np.zeros(0, bool)
        if new.sum() < FEWEST_ROWS:
            notes.append(
                f"{stream.field} ({stream.source}) is left out, because {new.sum()} of its "
                f"{len(stream.t)} rows are usable and {FEWEST_ROWS} are needed."
            )
            continue
        t, values = t[new], values[new]
        if stream.field == "quat":
            values = _unit(values, stream.source)
        if stream.field == "cmd_angles":
            values = np.unwrap(values, axis=0)
        clean[stream.field] = dataclasses.replace(stream, t=t, values=values)
        dropped[stream.field] = len(stream.t) - len(t)
    return clean, dropped, notes


def _unit(quat: Float[np.ndarray, "rows 4"], source: str) -> Float[np.ndarray, "rows 4"]:
    """Unit quaternions without jumps of sign."""
    norm = np.linalg.norm(quat, axis=1, keepdims=True)
    if np.abs(norm - 1.0).max() > 0.05:
        raise LogError(
            f"{source}: a quaternion has the norm {norm.ravel()[np.abs(norm - 1).argmax()]:.3g}; 1 "
            f"is expected."
        )
    quat = quat / norm
    signs = np.where(np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0.0, -1.0, 1.0)
    return quat * np.concatenate([[1.0], np.cumprod(signs)])[:, None]


def _inputs(clean: dict[str, Stream], notes: Sequence[str]) -> tuple[str, ...]:
    """The fields that drive a replay; `notes` say what else was found.

    Raises:
        LogError: A field is missing.
    """
    for name in REQUIRED:
        if name not in clean:
            raise LogError(" ".join([f"no {_WORDS[name]} was found{_found(clean)}.", *notes]))
    for group in INPUTS:
        if all(name in clean for name in group):
            return group
    expected = "commanded attitude and thrust are expected, or rotor speeds, or motor PWM with"
    why = f"no input was found: {expected} battery voltage{_found(clean)}."
    raise LogError(" ".join([why, *notes]))


_WORDS = {"pos": "position", "quat": "attitude"}
"""Required fields in words."""


def _found(clean: dict[str, Stream]) -> str:
    text = ", ".join(f"{name} ({stream.source})" for name, stream in clean.items())
    return f"; found: {text}" if text else "; nothing else was found either"


def _derived_vel(pos: Stream) -> Stream:
    """Velocity at the times of positions."""
    starts = np.searchsorted(pos.t, pos.t - VEL_SPAN - 1e-9)
    ends = np.searchsorted(pos.t, pos.t + VEL_SPAN + 1e-9)
    vel = np.empty_like(pos.values)
    for i, (low, high) in enumerate(zip(starts, ends, strict=True)):
        if high - low < 3:  # slow rows: the neighbours
            low, high = max(i - 1, 0), min(i + 2, len(pos.t))
        s = pos.t[low:high] - pos.t[i]
        basis = np.stack([np.ones_like(s), s, s * s][: min(3, len(s))], axis=1)
        vel[i] = np.linalg.lstsq(basis, pos.values[low:high], rcond=None)[0][1]
    return Stream("vel", pos.t, vel, pos.source, "derived from position")


def _shared_clock(needed: Sequence[Stream]) -> Float[np.ndarray, " rows"] | None:
    """The times of all streams, if these are the same."""
    t = needed[0].t
    same = all(len(s.t) == len(t) and np.abs(s.t - t).max() < ONE_CLOCK for s in needed)
    return t if same else None


def _even_clock(needed: Sequence[Stream]) -> Float[np.ndarray, " rows"]:
    """Times at equal distances at which every needed stream has neighbours.

    Raises:
        LogError: There are none.
    """
    slowest = min(_rate(s.t) for s in needed if s.field in MEASURED)
    dt = 1.0 / min(max(slowest, RATES[0]), RATES[1])
    start, end = max(s.t[0] for s in needed), min(s.t[-1] for s in needed)
    if end - start < dt:
        spans = ", ".join(f"{s.field} {s.t[0]:.3f} to {s.t[-1]:.3f} s" for s in needed)
        raise LogError(f"the streams do not overlap in time: {spans}. Do they share a clock?")
    # From the first row of the slowest, which then needs the least interpolation.
    slow = min(needed, key=lambda s: _rate(s.t))
    first = slow.t[np.searchsorted(slow.t, start)]
    first -= dt * np.floor((first - start) / dt)
    t = first + dt * np.arange(int((end - first) / dt + 1e-6) + 1)
    for stream in needed:
        t = t[_covered(t, stream.t)]
    if len(t) < FEWEST_ROWS:
        raise LogError("the streams share no stretch of time without holes.")
    return t


def _period(t: Float[np.ndarray, " rows"]) -> float:
    """Typical time from row to row [s], though rows may come in bursts or leave holes."""
    steps = min(BURST, len(t) - 1)
    return float(np.median((t[steps:] - t[:-steps]) / steps))


def _rate(t: Float[np.ndarray, " rows"]) -> float:
    return 1.0 / _period(t)


def _covered(
    t: Float[np.ndarray, " times"], rows: Float[np.ndarray, " rows"]
) -> Bool[np.ndarray, " times"]:
    """Times that lie between rows which are no hole apart."""
    right = np.clip(np.searchsorted(rows, t - ONE_CLOCK), 1, len(rows) - 1)
    inside = (t >= rows[0] - ONE_CLOCK) & (t <= rows[-1] + ONE_CLOCK)
    return inside & (np.diff(rows)[right - 1] <= HOLE * _period(rows))


def _at(t: Float[np.ndarray, " times"], stream: Stream) -> Float[np.ndarray, "times columns"]:
    """The stream's values at each time; NaN outside of it and in its holes."""
    rows, values = stream.t, stream.values
    if len(t) == len(rows) and np.abs(t - rows).max() < ONE_CLOCK:
        return values
    if stream.field == "battery":
        return np.interp(t, rows, values[:, 0])[:, None]
    covered = _covered(t, rows)
    if stream.field in HELD:
        out = _held(t, rows, values)
    else:
        out = spline(t, rows, values)
        if stream.field == "quat":
            out = out / np.linalg.norm(out, axis=1, keepdims=True)
    return np.where(covered[:, None], out, np.nan)


def _held(
    t: Float[np.ndarray, " times"],
    rows: Float[np.ndarray, " rows"],
    values: Float[np.ndarray, "rows columns"],
) -> Float[np.ndarray, "times columns"]:
    """The mean of held values from each time until a median step later."""
    step = float(np.median(np.diff(t)))
    ends = np.append(rows, max(rows[-1], t[-1]) + 2.0 * step)
    total = np.vstack([np.zeros(values.shape[1]), np.cumsum(values * np.diff(ends)[:, None], 0)])
    sums = [np.interp(t + step, ends, c) - np.interp(t, ends, c) for c in total.T]
    return np.stack(sums, axis=1) / step


def spline(
    t: Float[np.ndarray, " times"],
    rows: Float[np.ndarray, " rows"],
    values: Float[np.ndarray, "rows columns"],
) -> Float[np.ndarray, "times columns"]:
    """Cubic splines, one for each run of rows without a hole; NaN in holes."""
    out = np.full((len(t), values.shape[1]), np.nan)
    edges = [0, *(np.flatnonzero(np.diff(rows) > HOLE * _period(rows)) + 1), len(rows)]
    for low, high in itertools.pairwise(edges):
        inside = (t >= rows[low] - ONE_CLOCK) & (t <= rows[high - 1] + ONE_CLOCK)
        if high - low >= FEWEST_ROWS:
            out[inside] = CubicSpline(rows[low:high], values[low:high])(t[inside])
        elif high - low > 1:
            out[inside] = np.stack(
                [np.interp(t[inside], rows[low:high], v) for v in values[low:high].T], axis=1
            )
    return out


def _how(name: str, stream: Stream, t: Float[np.ndarray, " times"], resampled: bool) -> str:
    """In words, how a stream's rows became those of the flight."""
    if not resampled and len(stream.t) == len(t):
        return "rows as logged"
    to = f" at {_rate(t):.4g} Hz"
    if name in HELD:
        return "mean while held" + to
    return ("straight lines" if name == "battery" else "cubic splines") + to


def _between(
    t: Float[np.ndarray, " times"], rows: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " times"]:
    """1 for times to which none of the rows is the nearest one, else 0."""
    right = np.clip(np.searchsorted(t, rows), 1, len(t) - 1)
    nearest = right - (rows - t[right - 1] < t[right] - rows)
    between = np.ones(len(t))
    between[nearest] = 0.0
    return between


def _low_rates(clean: dict[str, Stream], t: Float[np.ndarray, " times"]) -> list[str]:
    """A line for each measurement that is slower than half of the rows."""
    names = ", ".join(
        f"{name} ({_rate(clean[name].t):.3g} Hz)"
        for name in MEASURED
        if name in clean and _rate(clean[name].t) < SLOW * _rate(t)
    )
    if not names:
        return []
    return [
        f"Slower than the rows ({_rate(t):.3g} Hz): {names}. Rows between measurements are "
        f"interpolated; those between rows of the slowest of them are compared with nothing."
    ]
