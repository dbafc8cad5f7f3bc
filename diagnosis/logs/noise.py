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
FLOOR = np.asarray([2e-4] * 3 + [2e-3] * 3 + [5e-4] * 3)
"""Smallest noise that is believed: 0.2 mm, 2 mm/s, 0.5 mrad; a choice below any motion capture."""
UNSEEN = 1e3
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
    pooled = np.concatenate(squares) if squares else np.zeros((0, 9))
    if not len(pooled):
        return FLOOR.copy()
    kinds = pooled.reshape(len(pooled), 3, 3).transpose(1, 0, 2).reshape(3, -1)
    # The squared length of a vector of ROWS - DEGREE - 1 normal numbers has this median.
    sigma = np.sqrt(np.median(kinds, axis=1) / chi2.median(ROWS - DEGREE - 1))
    return np.maximum(np.repeat(sigma, 3), FLOOR)


def _squares(log: DroneLog) -> Float[np.ndarray, "fits 9"]:
    """Sum of squared residuals of every local fit."""
    starts = np.arange(0, len(log.t) - ROWS + 1, 3)
    rows = starts[:, None] + np.arange(ROWS)
    t = log.t[rows]
    period = max(float(np.median(np.diff(log.t))), 0.0)
    close = np.diff(t, axis=1).max(axis=1) < max(LARGEST_STEP, 1.5 * period)
    rows, t = rows[close], t[close]
    if not len(rows):
        return np.zeros((0, 9))
    scaled = (t - t.mean(axis=1, keepdims=True)) / (0.5 * np.ptp(t, axis=1)[:, None])
    basis, _ = np.linalg.qr(scaled[..., None] ** np.arange(DEGREE + 1))
    y = measured(log)[rows]
    y = y - y[:, :1]
    left = y - basis @ (basis.transpose(0, 2, 1) @ y)
    return np.sum(left**2, axis=1)
