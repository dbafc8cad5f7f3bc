r"""How the measured roll and pitch follow their commands: lag, order, sign and turn.

    y(t) = k P u(t - d) + b

y are measured roll and pitch, u the commanded ones, P an order and sign of the axes, or a turn in
yaw. For each lag d everything follows from the covariance C(d) of y and u, with k >= 0:
error(P, d) = tr S_yy - max(0, <P, C(d)>)^2 / tr S_uu(d).
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.interface.readings import (
    AXES,
    RIGHT,
    TURNED,
    Chosen,
    Reading,
    choose,
    choose_signs,
    lowest_at,
    signed_orders,
)
from diagnosis.logs.flights import DroneLog
from diagnosis.logs.noise import measured

STEP = 0.01
"""Time between two samples and two lags [s]."""
LAGS = np.round(np.arange(-0.3, 0.601, STEP), 6)
"""Lags that are tried [s]."""
SHORTEST = 1.0
"""Shortest stretch whose sums are taken [s]."""
INDEPENDENT = 0.3
"""Time after which errors are taken to be independent [s], three time constants of the loop."""


@dataclasses.dataclass(frozen=True)
class Following:
    """Sums of squares of one drone or of many, about each drone's means."""

    yy: Float[np.ndarray, "2"]
    """Of measured roll and pitch [rad^2]."""
    uu: Float[np.ndarray, "lags 2 2"]
    """Products of commanded angles."""
    yu: Float[np.ndarray, "lags 2 2"]
    """Of measured and commanded angles."""
    seconds: float
    """Duration."""

    def __add__(self, other: "Following") -> "Following":
        return Following(
            self.yy + other.yy, self.uu + other.uu, self.yu + other.yu, self.seconds + other.seconds
        )

    def errors(self, matrix: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, " lags"]:
        """Squared error of every lag."""
        return self._left(np.maximum(np.einsum("ij,lij->l", matrix, self.yu), 0.0))

    def turned_errors(self) -> Float[np.ndarray, " lags"]:
        """Squared error of every lag, with the turn in yaw that fits best."""
        C = self.yu
        return self._left(np.hypot(C[:, 1, 0] - C[:, 0, 1], C[:, 0, 0] + C[:, 1, 1]))

    def _left(self, along: Float[np.ndarray, " lags"]) -> Float[np.ndarray, " lags"]:
        """Squared error of every lag, where `along` are the products <P, C> of some P."""
        # P is orthogonal: u and P u have the same length, and the same trace of S_uu.
        size = np.trace(self.uu, axis1=1, axis2=2)
        return self.yy.sum() - along**2 / np.maximum(size, 1e-12)

    def one_axis(self, axis: int) -> tuple[float, float, float]:
        """Squared error of one angle: by its command, by that with the other sign, by neither.

        The other command may act, too: a frame turned in yaw mixes the two, and a controller that
        corrects for it commands one angle in proportion to the other.
        """
        own, cross = self.uu[:, axis, axis], self.uu[:, 0, 1]
        other = np.maximum(self.uu[:, 1 - axis, 1 - axis], 1e-12)
        neither = self.yy[axis] - self.yu[:, axis, 1 - axis] ** 2 / other
        size = np.maximum(own - cross**2 / other, 1e-12)
        along = self.yu[:, axis, axis] - self.yu[:, axis, 1 - axis] * cross / other
        right, wrong = (neither - np.maximum(s * along, 0.0) ** 2 / size for s in (1.0, -1.0))
        return float(right.min()), float(wrong.min()), float(neither.min())

    def lag(self, matrix: Float[np.ndarray, "2 2"]) -> float:
        """The lag that fits best [s], between those tried."""
        return lowest_at(LAGS, self.errors(matrix))

    def turn(self) -> float:
        """The angle [rad] by which measured tilts are turned against commanded ones."""
        i = int(np.argmin(self.turned_errors()))
        C = self.yu[i]
        return float(np.arctan2(C[1, 0] - C[0, 1], C[0, 0] + C[1, 1]))


def following(drone: DroneLog, parts: int = 1) -> list[Following]:
    """The sums of a drone's flight in as many parts, or fewer where they would be too short.

    None without commands, or where the flight is shorter than one part.
    """
    if drone.cmd is None:
        return []
    t = np.arange(drone.t[0] + LAGS[-1], drone.t[-1] + LAGS[0], STEP)
    t = t[_whole(t, drone.t)] if len(t) else t
    parts = max(1, min(parts, int(len(t) * STEP / SHORTEST)))
    return [_sums(drone, part) for part in np.array_split(t, parts) if len(part) >= SHORTEST / STEP]


def _sums(drone: DroneLog, t: Float[np.ndarray, " times"]) -> Following:
    assert drone.cmd is not None  # `following` looked
    rpy = measured(drone)[:, 6:8]
    y = np.stack([np.interp(t, drone.t, angle) for angle in rpy.T], axis=1)
    y -= y.mean(axis=0)
    uu, yu = np.zeros((len(LAGS), 2, 2)), np.zeros((len(LAGS), 2, 2))
    for i, lag in enumerate(LAGS):
        held = np.clip(np.searchsorted(drone.t, t - lag, side="right") - 1, 0, None)
        u = drone.cmd[held, :2]
        u = u - u.mean(axis=0)
        uu[i], yu[i] = u.T @ u, y.T @ u
    return Following(np.sum(y * y, axis=0), uu, yu, len(t) * STEP)


def order(found: Following) -> tuple[Chosen | None, Float[np.ndarray, "2 2"]]:
    """What commanded roll and pitch hold, None if flights do not tell, and the order and sign.

    Where they are turned by more than `RIGHT`, that is a turn in place of an order and sign.
    """
    orders = signed_orders(2)
    readings = [
        Reading(_WORDS.get(words, words), float(found.errors(matrix).min()), changes)
        for words, changes, matrix in orders
    ]
    readings.append(Reading(TURNED, float(found.turned_errors().min()), len(AXES)))
    n = 2 * int(found.seconds / INDEPENDENT)
    chosen = choose(readings, float(found.yy.sum()), n)
    if chosen is not None and chosen.names == (TURNED,):
        chosen = dataclasses.replace(chosen, names=())
        if abs(turn := found.turn()) > RIGHT:
            c, s = math.cos(turn), math.sin(turn)
            return chosen, np.asarray([[c, -s], [s, c]])
    chosen = choose_signs(chosen, _signs(found))
    if chosen is None or not chosen.names:
        return chosen, np.eye(2)
    place = next(i for i, r in enumerate(readings) if r.name == chosen.names[0])
    return chosen, orders[place][2]


def _signs(found: Following) -> dict[str, tuple[list[Reading], float, int]]:
    axes = {}
    for i, axis in enumerate(("roll", "pitch")):
        right, wrong, total = found.one_axis(i)
        readings = [Reading("", right), Reading(f"{axis} with the opposite sign", wrong, 1)]
        axes[axis] = (readings, total, int(found.seconds / INDEPENDENT))
    return axes


_WORDS = {
    "x with the opposite sign": "roll with the opposite sign",
    "y with the opposite sign": "pitch with the opposite sign",
    "x and y with the opposite sign": "roll and pitch with the opposite sign",
    "x and y exchanged": "roll and pitch exchanged",
    "x and y exchanged, x with the opposite sign": "roll and pitch exchanged and turned",
    "x and y exchanged, y with the opposite sign": "roll and pitch exchanged and turned",
}


def together(drones: Sequence[Following]) -> Following:
    """The sums of all."""
    return sum(drones[1:], drones[0])


def _whole(t: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Which times lie in no hole."""
    i = np.clip(np.searchsorted(rows, t, side="right"), 1, len(rows) - 1)
    return rows[i] - rows[i - 1] < 0.1
