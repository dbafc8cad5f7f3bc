r"""Which motor stands in which column: the moments of the motors against how the drone turns.

    dw/dt = k M u(t - d) + b

w are measured angular velocities about x and y, u the squares of what motors are given (their
thrusts, but for a factor), M the signs of crazyflow 0.4.0's ``mixing_matrix``: motor 1 in front on
the right, then clockwise seen from above. k is positive, d the lag that fits best. Motors explain
little of what a gyroscope beside them shakes, so that sums of squares hardly differ: the difference
of two orders is tested piece by piece of flight, as Vuong (1989, Econometrica 57, 307-333) does.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy import stats

from diagnosis.interface.readings import ALPHA, FEWEST, Chosen
from diagnosis.logs.flights import DroneLog

MOMENTS = np.asarray([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, 1.0, -1.0]])
"""Signs of the moments about x and y of motors 1 to 4."""
ORDERS = tuple(itertools.permutations(range(4)))
"""Orders of the motors, the one asked for first."""
STEP = 0.02
"""Time between two samples [s]; the angular acceleration is that over twice this time."""
LAGS = (0.0, 0.02, 0.04, 0.06, 0.08)
"""Lags that are tried [s]: motors and loop."""

PIECE = 4.0
"""Duration of a piece [s], far longer than a gyroscope's noise remembers."""


def motor_order(drones: Sequence[DroneLog]) -> Chosen | None:
    """In which order columns hold the motors; None if these logs do not tell."""
    turning = [drone for drone in drones if _given(drone) is not None and drone.ang_vel is not None]
    sums = [one for drone in turning for one in _sums(drone)]
    if len(sums) < FEWEST:
        return None
    gains = np.asarray([_gains(sums, order) for order in ORDERS])
    lags = gains.sum(axis=2).argmax(axis=1).tolist()
    told = np.asarray([_told(sums, order, lag) for order, lag in zip(ORDERS, lags, strict=True)])
    total = sum(one[0] for one in sums)
    best = int(told.sum(axis=1).argmax())
    over = told[best] - told[0]
    least = float(stats.t.isf(ALPHA / len(ORDERS), len(over) - 1))
    spread = float(np.std(over, ddof=1)) / math.sqrt(len(over))
    explained, asked = (float(told[i].sum()) / total for i in (best, 0))
    if best == 0 or over.mean() <= least * spread:
        return None
    order = ", ".join(str(i + 1) for i in ORDERS[best])
    return Chosen((f"motors {order} in columns 1 to 4",), explained, asked)


Sums = tuple[float, Float[np.ndarray, "lags 2 4"], Float[np.ndarray, "lags 4 4"]]
"""Squares of the angular acceleration, its products with the motors', and those of the motors."""


def _given(drone: DroneLog) -> Float[np.ndarray, "rows 4"] | None:
    return drone.pwm if drone.pwm is not None else drone.rotor_vel


def _sums(drone: DroneLog) -> list[Sums]:
    """Sums of the pieces of a drone's flight."""
    given, rate = _given(drone), drone.ang_vel
    assert given is not None  # `motor_order` looked
    assert rate is not None
    found = []
    times = np.arange(drone.t[0] + max(LAGS), drone.t[-1], STEP)
    for t in np.array_split(times, max(1, int(len(times) * STEP / PIECE))):
        w = np.stack([np.interp(t, drone.t, axis) for axis in rate[:, :2].T], axis=1)
        y = (w[2:] - w[:-2]) / (2.0 * STEP)
        y -= y.mean(axis=0)
        cross, square = np.zeros((len(LAGS), 2, 4)), np.zeros((len(LAGS), 4, 4))
        for i, lag in enumerate(LAGS):
            u = np.stack([np.interp(t[1:-1] - lag, drone.t, one) for one in (given**2).T], axis=1)
            u -= u.mean(axis=0)
            cross[i], square[i] = y.T @ u, u.T @ u
        found.append((float(np.sum(y * y)), cross, square))
    return found


def _products(one: Sums, order: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Products of both moments with the angular acceleration, and their squares, for every lag."""
    M = MOMENTS[:, list(order)]
    _, cross, square = one
    return np.einsum("ij,lij->li", M, cross), np.einsum("ij,ljk,ik->li", M, square, M)


def _gains(sums: Sequence[Sums], order: Sequence[int]) -> Float[np.ndarray, "lags 2"]:
    """What both moments explain of all pieces [rad^2/s^4], for every lag."""
    along, size = (sum(x) for x in zip(*(_products(one, order) for one in sums), strict=True))
    return np.maximum(along, 0.0) ** 2 / np.maximum(size, 1e-12)


def _told(sums: Sequence[Sums], order: Sequence[int], lag: int) -> Float[np.ndarray, " pieces"]:
    """What the moments of all pieces, with one gain an axis, explain of each piece."""
    products = [_products(one, order) for one in sums]
    along, size = (np.sum([p[i][lag] for p in products], axis=0) for i in (0, 1))
    k = np.maximum(along, 0.0) / np.maximum(size, 1e-12)
    return np.asarray([float(np.sum(2.0 * k * a[lag] - k**2 * s[lag])) for a, s in products])
