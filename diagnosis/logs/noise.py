"""Measurement noise, estimated from the logs themselves.

Around every row a cubic polynomial in time is fitted to seven neighbouring rows at their true
times; what it leaves, corrected for the four numbers it takes, is noise. The median of the squares
makes the estimate blind to the few rows where a flight is rougher than a cubic. A floor keeps a
log that was rounded to its last digit from being believed exactly.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from diagnosis.logs.flights import DroneLog, FlightLog

ROWS = 7
"""Neighbouring rows of one local fit."""
DEGREE = 3
"""Degree of the polynomial."""
LARGEST_STEP = 0.03
"""Rows further apart than this [s] are not fitted together."""
COARSEST = 0.06
"""Rows further apart than this [s] follow no attitude, so that rows between them are needed; a
choice. Where these were interpolated from slower attitudes, its noise comes out too small."""
FLOOR = np.asarray([2e-4] * 3 + [2e-3] * 3 + [5e-4] * 3)
"""Smallest noise that is believed: 0.2 mm, 2 mm/s, 0.5 mrad; a choice below any motion capture."""
UNSEEN_ATTITUDE_RAD = 1e3
"""Noise [rad] of an attitude that is prescribed and therefore says nothing."""
CHANNELS = (
    *(f"position {axis}" for axis in "xyz"),
    *(f"velocity {axis}" for axis in "xyz"),
    *(f"attitude {axis}" for axis in ("roll", "pitch", "yaw")),
)
"""What a node measures."""
UNITS = ("m",) * 3 + ("m/s",) * 3 + ("rad",) * 3
"""Unit of each channel."""


def measured(log: DroneLog) -> Float[np.ndarray, "rows 9"]:
    """Position [m], velocity [m/s] and roll, pitch, yaw [rad], unwrapped."""
    rpy = np.unwrap(Rotation.from_quat(log.quat).as_euler("xyz"), axis=0)
    return np.concatenate([log.pos, log.vel, rpy], axis=1)


def estimate_noise(flights: Sequence[FlightLog]) -> Float[np.ndarray, " 9"]:
    """Standard deviation of each channel's noise: m, m/s, rad.

    The three axes of one kind of measurement are taken together.
    """
    squares = [_squares(drone) for flight in flights for drone in flight.drones]
    if not any(len(found) for kinds in squares for found in kinds):
        return FLOOR.copy()
    pooled = [np.concatenate(kind).ravel() for kind in zip(*squares, strict=True)]
    # The squared length of a vector of ROWS - DEGREE - 1 normal numbers has this median.
    typical = np.asarray([np.median(kind) if kind.size else 0.0 for kind in pooled])
    sigma = np.sqrt(typical / chi2.median(ROWS - DEGREE - 1))
    return np.maximum(np.repeat(sigma, 3), FLOOR)


def _squares(log: DroneLog) -> list[Float[np.ndarray, "_fits 3"]]:
    """Of position, velocity and attitude: sums of squared residuals of every local fit."""
    rows = measured(log)
    moved = turned = _left(log.t, rows)
    if log.interpolated is not None:
        seen = ~log.interpolated
        moved = _left(log.t[seen], rows[seen])
        if seen.sum() > 1 and np.median(np.diff(log.t[seen])) <= COARSEST:
            turned = moved
    return [moved[:, :3], moved[:, 3:6], turned[:, 6:]]


def _left(
    times: Float[np.ndarray, " rows"], y: Float[np.ndarray, "rows columns"]
) -> Float[np.ndarray, "_fits columns"]:
    """Sum of squared residuals of every local fit."""
    starts = np.arange(0, len(times) - ROWS + 1, 3)
    rows = starts[:, None] + np.arange(ROWS)
    t = times[rows]
    period = max(float(np.median(np.diff(times))), 0.0) if len(times) > 1 else 0.0
    close = np.diff(t, axis=1).max(axis=1) < max(LARGEST_STEP, 1.5 * period)
    rows, t = rows[close], t[close]
    if not len(rows):
        return np.zeros((0, y.shape[1]))
    scaled = (t - t.mean(axis=1, keepdims=True)) / (0.5 * np.ptp(t, axis=1)[:, None])
    basis, _ = np.linalg.qr(scaled[..., None] ** np.arange(DEGREE + 1))
    y = y[rows]
    y = y - y[:, :1]
    left = y - basis @ (basis.transpose(0, 2, 1) @ y)
    return np.sum(left**2, axis=1)
