"""Stored flights in the form in which a page plays them: whole millimetres as base64.

    {"t": [s], "drones": [number], "unit": m, "radius": m, "xyz": base64 of int16}

`xyz` runs over times, then drones, then x, y, z in the world frame, little-endian, in steps of
`unit`; `GAP` stands where there is no position. A flight that leaves +-32 m gets a coarser unit.
"""

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from simulators.vehicle import COLLISION_RADIUS

GAP = -32768
"""Stands for a position that is not finite or not stored."""
UNIT = 0.001
"""Smallest step between two positions [m]."""
FARTHEST = 1_000.0
"""Positions beyond this distance from the origin [m] are gaps: the flight is lost by then."""
MAX_SAMPLES = 1_500_000
"""Positions of all flights of a page together: 12 MB of text. Beyond it, times are left out."""


def positions(
    frame: pd.DataFrame,
) -> tuple[Float[np.ndarray, " time"], list[int], Float[np.ndarray, "time drones 3"]]:
    """Times [s], drones and positions [m] of one run's rows of `trajectories`; NaN where none."""
    t, row = np.unique(frame["t"].to_numpy(float), return_inverse=True)
    drones, column = np.unique(frame["drone"].to_numpy(int), return_inverse=True)
    pos = np.full((len(t), len(drones), 3), np.nan)
    pos[row, column] = frame[["pos_x", "pos_y", "pos_z"]].to_numpy(float)
    return t, drones.tolist(), pos


def playable(frame: pd.DataFrame, stride: int = 1) -> dict[str, Any] | None:
    """One run's flight as above, every `stride`-th time and the last; None if nobody flew."""
    t, drones, pos = positions(frame)
    if not len(t):
        return None
    keep = np.unique(np.r_[np.arange(0, len(t), stride), len(t) - 1])
    t, pos = t[keep], pos[keep]
    known = (np.abs(pos) < FARTHEST).all(axis=-1, keepdims=True)  # not where it is no number
    reach = float(np.abs(np.where(known, pos, 0.0)).max())
    unit = max(UNIT, reach / 32_767)
    steps = np.where(known, np.round(np.where(known, pos, 0.0) / unit), GAP).astype("<i2")
    return {
        "t": [round(float(x), 4) for x in t],
        "drones": drones,
        "unit": unit,
        "radius": COLLISION_RADIUS,
        "xyz": base64.b64encode(steps.tobytes()).decode(),
    }


def playable_all(flights: Mapping[str, pd.DataFrame]) -> dict[str, dict[str, Any]]:
    """Flights by run, thinned alike so that all together stay below `MAX_SAMPLES`."""
    total = sum(map(len, flights.values()))
    stride = max(1, -(-total // MAX_SAMPLES))
    found = {run: playable(frame, stride) for run, frame in flights.items()}
    return {run: flight for run, flight in found.items() if flight is not None}
