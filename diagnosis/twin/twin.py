r"""The twin: the nominal simulator and a memory of what it lacks, learned from reference flights.

    twin = simulated + memory(simulated)

Every reference flight is predicted by the twin of all others; these left-out errors say how well
the twin follows, and, read as effects flight by flight, how much of each effect undisturbed flights
seem to have. They also say how an error now predicts the next, channel by channel:

    e(t) = sum_k a_k e(t - k) + w(t),     w ~ N(0, C),  C over the six channels.

Whitened errors and slopes, (x(t) - sum_k a_k x(t - k)) by the Cholesky factor of C, make the
likelihood whose covariance is that of the left-out errors. Runs of valid samples start anew.

Reference flights tell little of a motion that they do not fly. Where a channel moves further than
in any of them, its error may grow in proportion: errors and slopes are divided by that ratio. The
flights of `crazyflie_plain` hardly turn; of a full turn in `crazyflie_changed` (`log206`) the twin
misses 8 degrees, as the simulator does, where its errors in the reference are 0.09.

Named effects are not fitted to the reference beside the memory. With a prior of a tenth of each
range, nine flights of `crazyflie_plain` were followed no better when left out (0.1098 m/s^2
sideways, 0.1075 without, means of four splits), and their fit, in which effects cancel each other,
answered a thrust that was raised by 5.0 % with 4.5 % (without: 5.0 %).
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.decision import Decision
from diagnosis.logs.flights import LogError
from diagnosis.logs.segments import NODE_DT
from diagnosis.replay.library import Library
from diagnosis.twin.channels import PART, Channels, N
from diagnosis.twin.memory import GROUPS, LENGTH, Memory, fit_memories, gram, rms, scale_of

FEWEST_REFERENCES = 2
"""Reference flights without which none can be left out, and without which nothing is named. A
single one is cut into parts, which do not say how flights differ."""
FEWEST_PARTS = 3
"""Parts of a single reference flight; a choice."""
FEWEST_TO_JUDGE = 4
"""Flights below which none stands out; a choice."""
ORDERS = (0, 1, 2, 4)
"""Orders of the autoregression that reference flights choose from, for each group of channels.

Between slow measurements errors lie on splines, and an autoregression takes for noise what these
leave of a constant. Such flights choose order 0: with positions at 10 Hz and any order, 7 % less
thrust in `crazyflie_plain` was called a battery that fades (0.64, thrust 0.25; drift 82 to 33 mm),
with order 0 it is thrust (0.98; 82 to 14 mm)."""


@dataclasses.dataclass(frozen=True)
class Colour:
    """Autoregression of each channel and covariance of what it leaves."""

    a: Float[np.ndarray, "order 6"]
    """Coefficients by lag."""
    root: Float[np.ndarray, "seen seen"]
    """Inverse Cholesky factor of the covariance of w among the channels that are seen."""
    seen: tuple[int, ...]
    """Channels that say something: without a trusted attitude command, angles do not."""

    def whiten(
        self, x: Float[np.ndarray, "*n time 6"], valid: Bool[np.ndarray, " time"]
    ) -> Float[np.ndarray, "*n numbers"]:
        """Independent numbers of unit variance, if `x` is such an error."""
        white = _innovation(x, self.a)[..., usable(valid, len(self.a)), :][..., list(self.seen)]
        return (white @ self.root.T).reshape(*x.shape[:-2], -1)


def usable(valid: Bool[np.ndarray, " time"], order: int) -> Bool[np.ndarray, " time"]:
    """Samples before which `order` samples in a row are valid, too."""
    good = valid.copy()
    for k in range(1, order + 1):
        good[k:] &= valid[:-k]
        good[:k] = False
    return good


def _innovation(x: Float[np.ndarray, "*n time 6"], a: Float[np.ndarray, "order 6"]) -> np.ndarray:
    out = x.copy()
    for k, row in enumerate(a, start=1):
        out[..., k:, :] -= row * x[..., :-k, :]
    return out


def fit_colour(
    errors: Sequence[Float[np.ndarray, "_ 6"]],
    valid: Sequence[Bool[np.ndarray, " _"]],
    orders: Sequence[int],
    seen: tuple[int, ...],
) -> Colour:
    """The colour of left-out errors, by least squares over all runs of valid samples.

    Every channel has an order of its own.
    """
    longest = max(orders)
    a = np.zeros((longest, N))
    for c, order in enumerate(orders):
        if not order:
            continue
        now, past = [], []
        for e, v in zip(errors, valid, strict=True):
            at = np.flatnonzero(usable(v, order))
            now.append(e[at, c])
            past.append(np.stack([e[at - k, c] for k in range(1, order + 1)], axis=1))
        x, y = np.concatenate(past), np.concatenate(now)
        square = x.T @ x
        ridge = 1e-6 * np.trace(square) / order + 1e-12
        a[:order, c] = np.linalg.solve(square + ridge * np.eye(order), x.T @ y)
    left = [_innovation(e, a)[usable(v, longest)] for e, v in zip(errors, valid, strict=True)]
    w = np.concatenate(left)[:, list(seen)]
    covariance = w.T @ w / len(w) + np.diag(1e-12 + 1e-6 * np.mean(w**2, axis=0))
    return Colour(a, np.linalg.inv(np.linalg.cholesky(covariance)), seen)


@dataclasses.dataclass(frozen=True)
class Score:
    """What one flight says of every parameter, linearised at the twin."""

    name: str
    """The flight's name."""
    H: Float[np.ndarray, "params params"]
    """Information of its whitened slopes."""
    h: Float[np.ndarray, " params"]
    """Whitened slopes by whitened error."""
    misfit: float
    """Chi-square of the whitened error over its numbers."""
    alone: float
    """The same with every parameter at what this flight alone says of it, within its range: what
    no candidate explains."""
    samples: int
    """Samples that count."""


@dataclasses.dataclass(frozen=True)
class Twin:
    """A vehicle as its reference flights show it."""

    library: Library
    """The effects and the nominal simulator."""
    memory: Memory
    """How it follows the simulator."""
    colour: Colour
    """Noise of its left-out errors."""
    scores: tuple[Score, ...]
    """Every reference flight by the twin of all others."""
    gap: Float[np.ndarray, " 6"]
    """Root mean square of measured minus simulated in the reference flights."""
    error: Float[np.ndarray, " 6"]
    """The same of measured minus twin, flights left out in turn."""
    reach: Float[np.ndarray, " 6"]
    """How far each channel moves at most in a reference flight."""
    set_aside: tuple[str, ...]
    """Reference flights that no twin of the others follows."""

    def errors(self, flight: Channels) -> Float[np.ndarray, "time 6"]:
        """Measured minus twin."""
        return flight.gap - self.memory.predict(flight)

    def score(self, flight: Channels) -> Score:
        """What a flight says that is not among the reference flights."""
        width = self.library.high - self.library.low
        beyond = self.beyond(flight)
        errors, slopes = self.errors(flight) / beyond, self.memory.respond(flight) / beyond
        return score(self.colour, flight, errors, slopes, width)

    def beyond(self, flight: Channels) -> Float[np.ndarray, " 6"]:
        """By how much each channel's error may be larger than in the reference, at least 1."""
        return np.maximum(moved(flight) / self.reach, 1.0)


def score(
    colour: Colour,
    flight: Channels,
    errors: Float[np.ndarray, "time 6"],
    slopes: Float[np.ndarray, "params time 6"],
    width: Float[np.ndarray, " params"],
) -> Score:
    """The normal equations of one flight in whitened errors; `width` are the parameters' ranges."""
    r, J = colour.whiten(errors, flight.valid), colour.whiten(slopes, flight.valid)
    H, h, n = J @ J.T, J @ r, max(len(r), 1)
    Hw, hw = H * width[:, None] * width, h * width
    own = np.linalg.solve(Hw + np.eye(len(width)), hw)
    left = float(r @ r - 2.0 * own @ hw + own @ Hw @ own)
    return Score(flight.name, H, h, float(r @ r) / n, left / n, int(flight.valid.sum()))


def _joined(parts: Sequence[Score]) -> Score:
    """What a flight says that was scored in parts."""
    weight = np.asarray([part.samples for part in parts])
    return Score(
        name=parts[0].name,
        H=np.sum([part.H for part in parts], axis=0),
        h=np.sum([part.h for part in parts], axis=0),
        misfit=float(np.average([part.misfit for part in parts], weights=weight)),
        alone=float(np.average([part.alone for part in parts], weights=weight)),
        samples=int(weight.sum()),
    )


def make_twin(
    flights: Sequence[Channels],
    library: Library,
    seen: tuple[int, ...],
    decision: Decision = Decision(),
) -> Twin:
    """The twin of reference flights; those that no twin of the others follows are set aside.

    The parts of a single flight are predicted from one another.

    Raises:
        LogError: There is a single flight, and it has fewer than `FEWEST_PARTS` parts.
    """
    if len(flights) < FEWEST_REFERENCES:
        (flight,) = flights
        parts = flight.parts(LENGTH)
        if len(parts) < FEWEST_PARTS:
            raise LogError(
                f"the reference has 1 usable flight, with {NODE_DT * flight.valid.sum():.1f} s "
                f"that count; {FEWEST_REFERENCES} flights are expected, or one of "
                f"{NODE_DT * PART * FEWEST_PARTS:g} s, so that each part can be predicted from "
                "the others."
            )
        twin = _twin(parts, library, seen, ())
        return dataclasses.replace(twin, scores=(_joined(twin.scores),))
    twin = _twin(flights, library, seen, ())
    odd = standing_out([s.alone for s in twin.scores], decision)
    if not odd.any():
        return twin
    names = tuple(f.name for f, out in zip(flights, odd, strict=True) if out)
    kept = [f for f, out in zip(flights, odd, strict=True) if not out]
    return _twin(kept, library, seen, names)


def standing_out(
    misfit: Sequence[float], decision: Decision = Decision()
) -> Bool[np.ndarray, " flights"]:
    """Flights whose misfit is `flight_alone` times that of the median flight."""
    each = np.asarray(misfit)
    if len(each) < FEWEST_TO_JUDGE:
        return np.zeros(len(each), bool)
    return each > decision.flight_alone * np.median(each)


def _twin(
    flights: Sequence[Channels], library: Library, seen: tuple[int, ...], aside: tuple[str, ...]
) -> Twin:
    scale = scale_of(flights)
    width = library.high - library.low
    memory, others = fit_memories([gram(f, scale) for f in flights], scale)
    slopes = [memory.respond(f) for f in flights]
    valid = [f.valid for f in flights]
    errors = [f.gap - m.predict(f) for f, m in zip(flights, others, strict=True)]
    each = np.stack([moved(f) for f in flights])
    # Of a flight that is left out, the others say how far channels move.
    beyond = [np.maximum(x / np.delete(each, i, axis=0).max(axis=0), 1.0)
              for i, x in enumerate(each)]  # fmt: skip
    scaled = [e / k for e, k in zip(errors, beyond, strict=True)]
    slopes = [s / k for s, k in zip(slopes, beyond, strict=True)]

    @functools.cache
    def coloured(orders: tuple[int, ...]) -> tuple[float, Colour, tuple[Score, ...]]:
        colour = fit_colour(scaled, valid, orders, seen)
        parts = zip(flights, scaled, slopes, strict=True)
        scores = tuple(score(colour, *part, width) for part in parts)
        return _scatter(scores), colour, scores

    choice = ORDERS[:1] if any(flight.filled for flight in flights) else ORDERS
    orders = (choice[0],) * N
    for group in GROUPS:
        tried = [tuple(o if c in group else x for c, x in enumerate(orders)) for o in choice]
        orders = min(tried, key=lambda one: coloured(one)[0])
    _, colour, scores = coloured(orders)
    gap, error = rms([f.gap for f in flights], valid), rms(errors, valid)
    return Twin(library, memory, colour, scores, gap, error, each.max(axis=0), aside)


def moved(flight: Channels) -> Float[np.ndarray, " 6"]:
    """How far each simulated channel moves; channels that share their numbers, the larger."""
    span = np.ptp(flight.simulated[flight.valid], axis=0) + 1e-6
    out = np.zeros(N)
    for group in GROUPS:
        out[list(group)] = span[list(group)].max()
    return out


def _scatter(scores: Sequence[Score]) -> float:
    """How much flights differ in each parameter, as a mean logarithm."""
    information = np.stack([np.diag(s.H) for s in scores])
    seen = np.all(information > 0.0, axis=0)
    each = np.stack([s.h for s in scores])[:, seen] / information[:, seen]
    return float(np.mean(np.log(np.std(each, axis=0) + 1e-300)))
