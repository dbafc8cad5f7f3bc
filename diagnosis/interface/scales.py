r"""Sizes of the interface with their intervals: thrust over weight, turns in yaw, lag, heading.

An estimate pools all flights; its standard error is the jackknife's, each piece of flight left out
in turn (Efron and Stein, 1981, Annals of Statistics 9, 586-596), with Student's t of as many pieces
less one. So every scatter between pieces is in it, whatever its cause. A size is a fault only if
the whole interval lies beyond what vehicles do by themselves: those limits say where physics ends
and the interface begins, and stand below.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from diagnosis.interface.commands import Following, together
from diagnosis.interface.fault import Evidence
from diagnosis.interface.orders import path_fitted, tilt_terms
from diagnosis.interface.readings import ALPHA
from diagnosis.interface.windows import Windows
from simulators.vehicle import GRAVITY

FEWEST_PIECES = 8
"""Pieces of flight below which flights are cut; Student's t of 4 is 12.9 at this level, of 8 5.4.
What pieces of one flight share is then missing from the scatter; the limits leave room for it."""
THRUST = (1 / 1.6, 1.6)
"""Thrust over the force that the path needs [-]. Published vehicles of one type weigh 27 to 33 g
and give 0.86 to 1.03 of their thrust, 1.4 together; the limit is a choice beyond that."""
TURN = math.radians(5.0)
"""Angle in yaw [rad]; a choice: markers are set by eye, real sets show 0 to 3 degrees."""
TURN_SINCE = math.radians(3.0)
"""Turn of the path's frame [rad] since the reference; a choice. Undisturbed halves of real sets
differed by 2.6 degrees at most (200 splits of two sets). Of 450 pairs of simulated sets, one of
them with an effect in most, none differed by more than the 99.9 % interval of the difference."""
HEADING = math.radians(30.0)
"""Angle between the heading and its command [rad]: the largest that an effect describes."""
UNITS = (1 / 1.5, 1.5)
"""Speed of the path over the logged one, and units of the path in a metre by the tilt [-]. Three
real sets have 0.91 to 1.00 and 0.86 to 0.94, 321 simulated ones 1.00 and 0.77 to 1.15; the units
nearest to m and m/s are knots (1.94), miles per hour (2.24) and feet (3.28). The limit is a choice
between them."""
UPRIGHT = 0.5
"""Least cosine of a tilt that is compared with the path: 60 degrees; a choice."""
LAG = (-0.02, 0.35)
"""Time from a command to its attitude [s]. No vehicle acts before it is told, but for one period
of its controller; the slowest published loop, rotor and radio make 0.3 s together."""


@dataclasses.dataclass(frozen=True)
class Size:
    """A size with its interval at the level of the test."""

    value: float
    """Most likely value."""
    low: float
    """Lower end."""
    high: float
    """Upper end."""

    def beyond(self, low: float, high: float) -> bool:
        """Whether the whole interval lies below `low`, or above `high`."""
        return self.high < low or self.low > high

    def since(self, before: "Size") -> "Size":
        """How far it is from the same size of other flights, whose errors are independent."""
        value = self.value - before.value
        reach = math.hypot(self.high - self.value, before.high - before.value)
        return Size(value, value - reach, value + reach)


def jackknife(n: int, estimate: Callable[[Sequence[int]], float]) -> Size | None:
    """The estimate from pieces 0 to n - 1 with its interval; None with fewer than two pieces."""
    if n < 2:
        return None
    every = list(range(n))
    value = estimate(every)
    without = np.asarray([estimate(every[:i] + every[i + 1 :]) for i in every])
    spread = math.sqrt((n - 1) / n * float(np.sum((without - without.mean()) ** 2)))
    reach = float(stats.t.isf(ALPHA / 2.0, n - 1)) * spread
    return Size(value, value - reach, value + reach)


def sized(quantity: str, size: Size, unit: str, low: float, high: float, scale: float) -> Evidence:
    """A size as evidence: `low` to `high` is allowed, and all numbers are shown times `scale`."""
    return Evidence(
        quantity=quantity,
        value=scale * size.value,
        low=scale * size.low,
        high=scale * size.high,
        unit=unit,
        allowed=f"{scale * low:.3g} to {scale * high:.3g}",
    )


def parts_of(n_flights: int) -> int:
    """Parts into which each flight is cut."""
    return -(-FEWEST_PIECES // max(n_flights, 1))


def pieces(windows: Windows) -> Int[np.ndarray, " windows"]:
    """Which piece each window belongs to: its flight, or a part of it where flights are few."""
    found = np.unique(windows.flight)
    parts = parts_of(len(found))
    at = np.zeros(len(windows), int)
    for k, flight in enumerate(found):
        mine = np.flatnonzero(windows.flight == flight)
        at[mine] = k * parts + np.arange(len(mine)) * parts // len(mine)
    return np.unique(at, return_inverse=True)[1]


def thrust_over_force(windows: Windows, mass: float) -> Size | None:
    """Thrust that the inputs stand for, over the force that the path needs at that mass."""
    if windows.thrust is None:
        return None
    given = windows.thrust * windows.rotation[:, 2, 2]
    needed, piece = mass * windows.force[:, 2], pieces(windows)

    def ratio(chosen: Bool[np.ndarray, " windows"]) -> float:
        return float(np.sum(given[chosen]) / np.sum(needed[chosen]))

    return _over(piece, ratio)


def path_turn(windows: Windows) -> Size | None:
    """Angle in yaw [rad] by which the path's frame is turned against the attitude's."""
    terms, force = tilt_terms(windows, windows.rotation[:, :, 2])
    twice = np.concatenate([pieces(windows)] * 2)

    def turn(chosen: Bool[np.ndarray, " rows"]) -> float:
        return path_fitted(terms[chosen], force[chosen])[1]

    return _over(twice, turn)


def path_over_velocity(windows: Windows) -> tuple[Size, Size] | None:
    """Speed of the path over the logged one, estimated twice: noise makes one low, the other high.

    None where the two are not in the same direction, or in fewer than two pieces.
    """
    p, v = windows.path, windows.vel
    both = np.sum(p * v, axis=1)

    def low(chosen: Bool[np.ndarray, " windows"]) -> float:
        return float(np.sum(both[chosen]) / np.sum(v[chosen] ** 2))

    def high(chosen: Bool[np.ndarray, " windows"]) -> float:
        return float(np.sum(p[chosen] ** 2) / np.sum(both[chosen]))

    piece = pieces(windows)
    if not np.all(np.bincount(piece, both) > 0.0):
        return None
    sizes = _over(piece, low), _over(piece, high)
    return None if sizes[0] is None or sizes[1] is None else (sizes[0], sizes[1])


def path_over_tilt(windows: Windows) -> Size | None:
    """Units of the path in a metre, by the tilt; noise in tilts draws it low.

    A path that is accelerated by a [units/s^2] and tilted by t, the thrust axis' horizontal part
    over its vertical one, has k units in a metre, where a_xy = (a_z + k g) t.
    """
    windows = windows.some(windows.rotation[:, 2, 2] > UPRIGHT)
    if not len(windows):
        return None
    tilt = windows.rotation[:, :2, 2] / windows.rotation[:, 2, 2, None]
    acc = windows.force - [0.0, 0.0, GRAVITY]
    left = (acc[:, :2] - acc[:, 2:] * tilt).T.ravel()
    terms, _ = tilt_terms(windows, np.pad(tilt, ((0, 0), (0, 1))), GRAVITY)
    twice = np.concatenate([pieces(windows)] * 2)

    def over(chosen: Bool[np.ndarray, " rows"]) -> float:
        return path_fitted(terms[chosen], left[chosen])[0]

    return _over(twice, over)


def lag(drones: Sequence[Following], matrix: Float[np.ndarray, "2 2"]) -> Size | None:
    """Time from a command to its attitude [s]."""
    return jackknife(len(drones), lambda some: together([drones[i] for i in some]).lag(matrix))


def command_turn(drones: Sequence[Following]) -> Size | None:
    """Angle in yaw [rad] by which measured tilts are turned against commanded ones."""
    return jackknife(len(drones), lambda some: together([drones[i] for i in some]).turn())


def heading(off: Sequence[float]) -> Size | None:
    """Heading less its command [rad], from the mean of each piece of flight.

    Ends may lie beyond a half turn, so that one of 180 degrees has an interval as any other.
    """
    turns = np.exp(1j * np.asarray(off))
    whole = np.sum(turns)

    def turn(some: Sequence[int]) -> float:
        return float(np.angle(whole) + np.angle(np.sum(turns[list(some)]) / whole))

    return jackknife(len(turns), turn)


def _over(piece: Int[np.ndarray, " rows"], estimate: Callable[[np.ndarray], float]) -> Size | None:
    return jackknife(int(piece.max()) + 1, lambda some: estimate(np.isin(piece, list(some))))
