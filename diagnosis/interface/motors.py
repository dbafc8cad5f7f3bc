r"""What the motors are given against how the drone turns: which column is which, and when it acts.

    dw/dt = k M u(t - d - r (t - t0)) + b

w are measured angular velocities about x and y, u the squares of what motors are given (their
thrusts, but for a factor), M the signs of crazyflow 0.4.0's ``mixing_matrix``: motor 1 in front on
the right, then clockwise seen from above. k is positive, d the lag that fits best, t0 the log's
start. The drift r is zero unless two clocks of different speed stamp u and w: motors and their loop
take the same time from the start of a flight to its end. The drift is fitted in pieces so short
that a clock hardly moves in them; the order and the lag are fitted without drift. Motors explain
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

from diagnosis.interface.fault import MOTOR_CLOCK, InterfaceFault
from diagnosis.interface.readings import ALPHA, FEWEST_NUMBERS, Chosen, lowest_at
from diagnosis.interface.scales import FEWEST_PIECES, Size, jackknife, parts_of, sized
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
"""Change of the lag [s], since a reference or along a flight, that is a fault; a choice: one row of
a log at 100 Hz."""
SHORT = 1.0
"""Duration of a piece [s], in which the largest drift moves a clock by 50 ms."""
FASTEST = 0.05
"""Largest drift that is tried [s/s]; the effect `clock_drift` has the same bound."""
FURTHEST = 2.5
"""Largest drift at the end of a flight that is tried [s]; a choice, for the memory it takes."""


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


def inputs_column(drone: DroneLog) -> str:
    """Field with what turns the drone: duties of its motors, else their speeds."""
    return "pwm" if drone.pwm is not None else "rotor_vel"


def turning(drone: DroneLog) -> list[Turning]:
    """The pieces of a drone's flight; none without motors' inputs or angular velocity."""
    given: Float[np.ndarray, "rows 4"] | None = getattr(drone, inputs_column(drone))
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


def later_since(
    now: Sequence[Sequence[Turning]], then: Sequence[Sequence[Turning]], commanded: bool
) -> InterfaceFault | None:
    """A change since the reference of the time from the motors' inputs to the turning.

    `commanded`: the inputs are what motors are told, and no measured speeds.
    """
    after, before = turning_lag(now), turning_lag(then)
    if after is None or before is None:
        return None
    size = after.since(before)
    if not size.beyond(0.0, 0.0) or abs(size.value) < SINCE:
        return None
    later = size.value > 0.0
    word, stamped = ("later", "early") if later else ("sooner", "late")
    what, cause = ("motor commands", ", and the motors") if commanded else ("rotor speeds", "")
    quantity = "time from motor inputs to turning, minus the same time in the reference"
    slower = (f"{'slower' if later else 'faster'} motors",) if commanded else ()
    return InterfaceFault(
        part="motor clock since the reference",
        readings=(f"{what} stamped {stamped}", *slower),
        advice=f"The drone turns {1e3 * abs(size.value):.0f} ms {word} after its {what} than in "
        f"the reference: check the clocks of {what} and pose{cause}.",
        evidence=(sized(quantity, size, "s", -SINCE, SINCE, 1.0),),
    )


@dataclasses.dataclass(frozen=True)
class Pieces:
    """How much of the turning of one drone its motors explain, piece by piece and lag by lag."""

    seconds: float
    """Duration of the flight [s]."""
    at: Float[np.ndarray, " pieces"]
    """Middle of each piece since the log's start [s]."""
    lags: Float[np.ndarray, " lags"]
    """Lags, at equal distances [s]."""
    told: Float[np.ndarray, "pieces lags"]
    """Share of the squared angular acceleration that the moments explain, with a gain for each axis
    and piece: a take-off would outweigh all flight if they shared one. 0 where an input is not
    known."""

    def moved(self, rates: Float[np.ndarray, " rates"]) -> Float[np.ndarray, "rates pieces lags"]:
        """The shares at the lags of `LAGS`, which grow along the flight."""
        late = (LAGS + (rates[:, None] * self.at)[:, :, None] - self.lags[0]) / LAG_STEP
        low = np.clip(late.astype(int), 0, len(self.lags) - 2)
        row = np.arange(len(self.at))[:, None]
        before, after = self.told[row, low], self.told[row, low + 1]
        return before + (late - low) * (after - before)


def pieces_of(drone: DroneLog) -> Pieces | None:
    """The pieces of a drone's flight; None without motors' inputs or angular velocity."""
    given: Float[np.ndarray, "rows 4"] | None = getattr(drone, inputs_column(drone))
    seconds = float(drone.t[-1] - drone.t[0])
    if given is None or drone.ang_vel is None or seconds < 2.0 * SHORT:
        return None
    reach = min(FASTEST * seconds, FURTHEST)
    steps = np.arange(round((LAGS[0] - reach) / LAG_STEP), round((LAGS[-1] + reach) / LAG_STEP) + 1)
    fine = np.arange(0.0, seconds, LAG_STEP)
    moments = MOMENTS @ [np.interp(fine, drone.t - drone.t[0], one) for one in (given**2).T]
    every = round(STEP / LAG_STEP)
    w = np.stack([np.interp(fine, drone.t - drone.t[0], one) for one in drone.ang_vel[:, :2].T])
    turned = (w[:, 2 * every :: every] - w[:, : -2 * every : every]) / (2.0 * STEP)
    here = every * np.arange(1, turned.shape[1] + 1)
    inside = (fine[here] >= LAGS[-1]) & (fine[here] <= seconds + LAGS[0])  # known at every lag
    turned, here = turned[:, inside], here[inside]
    at, told = [], []
    for rows in np.array_split(np.arange(len(here)), max(1, int(len(here) * STEP / SHORT))):
        y = turned[:, rows] - turned[:, rows].mean(axis=1, keepdims=True)
        then = here[rows] - steps[:, None]
        known = (then[:, 0] >= 0) & (then[:, -1] < len(fine))
        u = moments[:, np.clip(then, 0, len(fine) - 1)]
        u = u - u.mean(axis=2, keepdims=True)
        square, total = np.sum(u * u, axis=2), np.sum(y * y)
        along = np.maximum(np.einsum("in,iln->il", y, u), 0.0)
        share = along**2 / np.maximum(square * total, 1e-12)
        at.append(fine[here[rows]].mean())
        told.append(known * share.sum(axis=0))
    return Pieces(seconds, np.asarray(at), steps * LAG_STEP, np.asarray(told))


def drift(drones: Sequence[Pieces]) -> Size | None:
    """Growth of the lag [s/s]; None if these pieces do not tell."""
    if sum(len(one.at) for one in drones) < FEWEST_NUMBERS:
        return None
    longest = max(one.seconds for one in drones)
    fastest = min(FASTEST, FURTHEST / longest)
    n = int(np.ceil(fastest * longest / (2.0 * LAG_STEP)))
    rates = fastest * np.arange(-n, n + 1) / n  # the middle of the flight moves by a lag's step
    parts = np.stack([part for one in drones for part in _parts(one, rates, len(drones))])
    total = parts.sum(axis=0)
    rate, lag = np.unravel_index(np.argmax(total), total.shape)
    best = rates[rate : rate + 1]
    # Chance explains as much at any lag.
    more = [one.moved(best)[0, :, lag] - one.told.mean(axis=1) for one in drones]
    if not _beyond_chance(np.concatenate(more), total.size):
        return None
    return jackknife(
        len(parts), lambda some: lowest_at(rates, -parts[list(some)].sum(axis=0).max(axis=1))
    )


def _parts(
    drone: Pieces, rates: Float[np.ndarray, " rates"], n_drones: int
) -> list[Float[np.ndarray, "rates lags"]]:
    """What the motors explain of a flight, or of its parts where flights are few."""
    rows = np.array_split(np.arange(len(drone.at)), parts_of(n_drones))
    return [
        dataclasses.replace(drone, at=drone.at[some], told=drone.told[some])
        .moved(rates)
        .sum(axis=1)
        for some in rows
        if len(some)
    ]


def drifting(drones: Sequence[Pieces]) -> InterfaceFault | None:
    """A clock of motors' inputs that drifts by a row of a log or more in the longest flight."""
    size = drift(drones)
    if size is None or not size.beyond(0.0, 0.0):
        return None
    least = SINCE / max(one.seconds for one in drones)
    if abs(size.value) < least:
        return None
    quantity = "growth of the time from motor inputs to turning"
    ever = "later and later" if size.value > 0.0 else "earlier and earlier"
    return InterfaceFault(
        part=MOTOR_CLOCK,
        readings=(f"a clock that drifts by {1e3 * size.value:.1f} ms a second",),
        advice=f"What the motors are given acts {ever}, by {1e3 * abs(size.value):.1f} ms a second "
        "of flight: compare the clock of motor inputs with the clock of angular velocities. "
        "All else is said of flights without this drift.",
        evidence=(sized(quantity, size, "ms/s", -least, least, 1e3),),
    )
