r"""What the motors are given against how the drone turns: which column is which, and when it acts.

    dw/dt = k M u(t - d) + b

w are measured angular velocities about x and y, u the squares of what motors are given (their
thrusts, but for a factor), M the signs of crazyflow 0.4.0's ``mixing_matrix``: motor 1 in front on
the right, then clockwise seen from above. k is positive, d the lag that fits best. Motors explain
little of what a gyroscope beside them shakes, and that differs from flight to flight: errors of a
piece of flight count in units of its own angular acceleration, and the difference of two orders is
tested piece by piece, as Vuong (1989, Econometrica 57, 307-333) does.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy import stats

from diagnosis.interface.readings import ALPHA, FEWEST_NUMBERS, Chosen, lowest_at
from diagnosis.interface.scales import FEWEST_PIECES, Size, jackknife
from diagnosis.logs.flights import DroneLog

MOMENTS = np.asarray([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, 1.0, -1.0]])
"""Signs of the moments about x and y of motors 1 to 4."""
ORDERS = tuple(itertools.permutations(range(4)))
"""Orders of the motors, the one asked for first."""
STEP = 0.02
"""Time between two samples [s]; the angular acceleration is that over twice this time."""
LAG_STEP = 0.01
"""Time between two lags [s]."""
LAGS = np.round(np.arange(-0.1, 0.201, LAG_STEP), 6)
"""Lags that are tried [s]: motors and their loop delay the turning, a wrong clock shifts it."""
PIECE = 4.0
"""Duration of a piece [s], far longer than a gyroscope's noise remembers."""
SINCE = 0.01
"""Change of the lag [s] since a reference that is a fault; a choice: one row of a log at 100 Hz."""


@dataclasses.dataclass(frozen=True)
class Turning:
    """Sums of one piece of flight, over the squares of its angular acceleration."""

    cross: Float[np.ndarray, "lags 2 4"]
    """Products of the angular acceleration and what motors are given."""
    square: Float[np.ndarray, "lags 4 4"]
    """Products of what motors are given."""

    def moments(
        self, order: Sequence[int]
    ) -> tuple[Float[np.ndarray, "lags 2"], Float[np.ndarray, "lags 2"]]:
        """Products of both moments with the angular acceleration, and their squares."""
        M = MOMENTS[:, list(order)]
        along = np.einsum("ij,lij->li", M, self.cross)
        return along, np.einsum("ij,ljk,ik->li", M, self.square, M)


def turning(drone: DroneLog) -> list[Turning]:
    """The pieces of a drone's flight; none without motors' inputs or angular velocity."""
    given = drone.pwm if drone.pwm is not None else drone.rotor_vel
    if given is None or drone.ang_vel is None:
        return []
    rates, found = drone.ang_vel[:, :2].T, []
    times = np.arange(drone.t[0] + LAGS[-1], drone.t[-1] + LAGS[0], STEP)
    for t in np.array_split(times, max(1, int(len(times) * STEP / PIECE))):
        w = np.stack([np.interp(t, drone.t, axis) for axis in rates], axis=1)
        y = (w[2:] - w[:-2]) / (2.0 * STEP)
        y -= y.mean(axis=0) if len(y) else 0.0
        total = float(np.sum(y * y))
        if total <= 0.0:
            continue
        cross, square = np.zeros((len(LAGS), 2, 4)), np.zeros((len(LAGS), 4, 4))
        for i, lag in enumerate(LAGS):
            u = np.stack([np.interp(t[1:-1] - lag, drone.t, one) for one in (given**2).T], axis=1)
            u -= u.mean(axis=0)
            cross[i], square[i] = y.T @ u, u.T @ u
        found.append(Turning(cross / total, square / total))
    return found


def motor_order(pieces: Sequence[Turning]) -> Chosen | None:
    """In which order columns hold the motors; None if these pieces do not tell."""
    if len(pieces) < FEWEST_NUMBERS:
        return None
    told = np.asarray([_told(pieces, order) for order in ORDERS])
    best = int(told.sum(axis=1).argmax())
    if best == 0 or not _beyond_chance(told[best] - told[0], len(ORDERS)):
        return None
    explained, asked = (float(told[i].mean()) for i in (best, 0))
    order = ", ".join(str(i + 1) for i in ORDERS[best])
    return Chosen((f"motors {order} in columns 1 to 4",), explained, asked)


def turning_lag(drones: Sequence[Sequence[Turning]]) -> Size | None:
    """Time from what motors are given to the turning [s]; None if these pieces do not tell."""
    pieces = [piece for drone in drones for piece in drone]
    if len(pieces) < FEWEST_NUMBERS or not _beyond_chance(_told(pieces, ORDERS[0]), len(LAGS)):
        return None
    flown = [drone for drone in drones if drone]
    parts = flown if len(flown) >= FEWEST_PIECES else [[piece] for piece in pieces]
    return jackknife(len(parts), lambda some: _lag([one for i in some for one in parts[i]]))


def _lag(pieces: Sequence[Turning]) -> float:
    """The lag that fits best [s], between those tried."""
    return lowest_at(LAGS, -_gains(pieces, ORDERS[0]).sum(axis=1))


def _gains(pieces: Sequence[Turning], order: Sequence[int]) -> Float[np.ndarray, "lags 2"]:
    """What both moments explain of all pieces, for every lag."""
    along, size = (sum(x) for x in zip(*(one.moments(order) for one in pieces), strict=True))
    return np.maximum(along, 0.0) ** 2 / np.maximum(size, 1e-12)


def _told(pieces: Sequence[Turning], order: Sequence[int]) -> Float[np.ndarray, " pieces"]:
    """Share of each piece that the moments explain, at the best lag, with one gain an axis."""
    lag = int(_gains(pieces, order).sum(axis=1).argmax())
    products = [one.moments(order) for one in pieces]
    along, size = (np.asarray([p[i][lag] for p in products]) for i in (0, 1))
    k = np.maximum(along.sum(axis=0), 0.0) / np.maximum(size.sum(axis=0), 1e-12)
    return np.sum(2.0 * k * along - k**2 * size, axis=1)


def _beyond_chance(shares: Float[np.ndarray, " pieces"], choices: int) -> bool:
    """Whether the mean is positive, after the best of so many choices was taken."""
    least = float(stats.t.isf(ALPHA / choices, len(shares) - 1))
    return float(shares.mean()) > least * float(np.std(shares, ddof=1)) / math.sqrt(len(shares))
