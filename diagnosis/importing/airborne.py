"""Take-off and landing: left out at the operator's word, or else the report says that they show.

Near the floor a drone stands, slides and flies on a cushion of air, which no nominal simulator
does. The floor is taken to lie at the lowest height of the log.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.importing.resample import Rows
from diagnosis.logs.columns import LogError

REST_S = 0.5
"""How long a drone rests at an end of its log, for the report to say so [s]; a choice."""
REST_M = 0.05
"""Its way in that time, and its distance from the lowest height, at most [m]; a choice above the
noise of indoor positions (millimetres)."""
CLIMB_M = 0.3
"""How far it must rise above that [m]; a choice."""


def airborne(rows: Rows, above: float) -> Rows:
    """The rows in which the drone is more than `above` [m] higher than the lowest of all.

    Raises:
        LogError: There are none.
    """
    t, height = rows.columns["t"], _height(rows)
    kept = height > above
    if not kept.any():
        span = f"{height.max():.3g} m"
        raise LogError(f"`--above` {above:g} m leaves nothing: the log's heights differ by {span}.")
    lost = np.median(np.diff(t)) * (~kept).sum()
    seconds = f"{lost:.1f} of {t[-1] - t[0]:.1f} s"
    note = f"Left out: what is at most {above:g} m above the lowest height, {seconds}."
    columns = {name: values[kept] for name, values in rows.columns.items()}
    return dataclasses.replace(rows, columns=columns, notes=(*rows.notes, note))


def with_hint(rows: Rows) -> Rows:
    """The same rows, with a note where they seem to hold take-off or landing."""
    t, height = rows.columns["t"], _height(rows)
    first, last = t <= t[0] + REST_S, t >= t[-1] - REST_S
    ends = [name for name, end in (("begins", first), ("ends", last)) if _rests(rows, end)]
    if not ends or height.max() < CLIMB_M:
        return rows
    note = (
        f"The log {' and '.join(ends)} at rest, at its lowest height. If the drone stood on the "
        "ground there, import again with --above 0.5, which leaves out what is lower than 0.5 m."
    )
    return dataclasses.replace(rows, notes=(*rows.notes, note))


def _rests(rows: Rows, end: Bool[np.ndarray, " rows"]) -> bool:
    """Whether the drone stays at its lowest height."""
    height = _height(rows)[end]
    moved = max(np.ptp(rows.columns[name][end]) for name in ("pos_x", "pos_y", "pos_z"))
    return bool(moved < REST_M and height.max() < REST_M)


def _height(rows: Rows) -> Float[np.ndarray, " rows"]:
    """Height above the lowest row [m]."""
    z = rows.columns["pos_z"]
    return z - z.min()
