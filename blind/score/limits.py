r"""How small an effect may be to be named: predicted by linear algebra, checked by diagnoses.

Flights without noise are linearised where one effect is true (vector u for a size of one). At the
size s and the logged noise the scores of all parameters are Gaussian,

    g = s H u + H^(1/2) z,      z ~ N(0, 1),

and every set S of effects promises a fall of chi-square g_S' H_SS^-1 g_S, noncentral chi-square
where S holds the effect. With that its log posterior is that of `diagnosis.decide.verdict`: half of
the fall, less Occam's term, less `effect_cost` an effect. Sets are nominal, every single effect,
the true one with any other, and a gust from every window on. The effect is named if the best set
holds it and what is left does not look like structure. The limit is the size at which 90 % of the
draws of z name it. More flights add information, so that H grows with the flights that are fitted.

The bound is the size at which the best test that looks at the same windows with unknown starts,
knows the effect's direction and has only to say whether it is there, is right in 90 % of cases with
2 % of false alarms: (z_0.98 + z_0.9) / sqrt(u' H u), H of all flights, those left out of the fit
included. Who links windows could do better: what follows from one start is known for longer.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from blind.draw import catalogue
from blind.draw.cases import Case
from blind.draw.catalogue import Withheld
from blind.fly.references import N_KINDS
from blind.score.identifiable import NEUTRAL, SECONDARY
from diagnosis.decide import verdict
from diagnosis.decide.decidable import with_truth
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Set
from diagnosis.fit.search import Fits
from diagnosis.fit.shrinkage import split
from diagnosis.logs.segments import REPLAY_WINDOW_S
from simulators.effects.card import Input, load_card

SECONDS = 10.0
"""Duration of a flight [s]."""
FLIGHTS = (1, 3, 6, 12, 30, 60)
"""Numbers of flights."""
NOISES = (0.3, 1.0, 3.0)
"""Noise over the usual one."""
NAMED = 0.9
"""Share of cases in which an effect of the limit's size is named."""
ALARMS = 0.02
"""False alarms of the test that the bound stands for."""
DRAWS = 1000
"""Draws of the noise."""
FACTORS = np.geomspace(0.003, 3000.0, 85)
"""Sizes that are tried, over that at which the flights are linearised."""
USUAL = 6
"""Flights for whose limit the flights are linearised."""
SEED = 20261121
"""Seed of directions, flights and draws; any would do."""


@dataclasses.dataclass(frozen=True)
class Limit:
    """How small an effect may be."""

    size: float
    """Smallest size that is named in `NAMED` of the cases; NaN if none within the bounds is."""
    bound: float
    """What a test that knows the effect needs."""
    rival: str
    """What is answered most often where the effect is not named."""


def sized(effect: Withheld, size: float) -> Withheld:
    """The effect with its strength changed to `size`, its direction and times kept."""
    factor = size / size_of(effect)
    values = {
        p: v if p in SECONDARY else NEUTRAL.get(p, 0.0) + factor * (v - NEUTRAL.get(p, 0.0))
        for p, v in effect.parameters.items()
    }
    return Withheld(effect.name, values)


def size_of(effect: Withheld) -> float:
    """Distance of the effect's parameters from neutral, in their unit."""
    values = {p: v for p, v in effect.parameters.items() if p not in SECONDARY}
    return math.dist(values.values(), [NEUTRAL.get(p, 0.0) for p in values])


def drawn(name: str, size: int = 1, seed: int = SEED) -> Withheld:
    """An effect of the catalogue, by the index of its size, in some direction."""
    return catalogue.draw_effect(name, size, np.random.default_rng(seed), SECONDS)


def make_single(effect: Withheld, n_flights: int, seed: int = SEED) -> Case:
    """A case in which nothing but `effect` is different; two drones fly where it needs them."""
    return Case(
        id=f"{seed:016x}",
        kind="single",
        effects=(effect,),
        size="",
        seed=seed,
        drones=2 if Input.NEIGHBOUR in load_card(effect.name).inputs else 1,
        n_flights=n_flights,
        seconds=SECONDS,
    )


@dataclasses.dataclass(frozen=True)
class _Set:
    """A candidate set in the linear problem."""

    names: Set
    """Effects."""
    signal: Float[np.ndarray, " free"]
    """Whitened score of the true effect at size one."""
    scores: Float[np.ndarray, "draws free"]
    """Whitened scores of the noise."""
    signs: Float[np.ndarray, " free"]
    """+1 or -1 where a parameter can only be on one side of neutral, 0 where on both."""
    cost: float
    """What its parameters and effects cost [nats]."""

    def posterior(self, size: float) -> Float[np.ndarray, " draws"]:
        """Log posterior beyond that of nominal, up to the evidence of data [nats]."""
        found = size * self.signal + self.scores
        return 0.5 * np.sum(np.where(found * self.signs < 0, 0.0, found) ** 2, axis=1) - self.cost


class Linear:
    """Flights with one true effect, linearised there."""

    def __init__(self, fits: Fits, effect: Withheld) -> None:
        self.evidence, self.effect = fits.evidence, effect
        found = with_truth(fits, {effect.name: effect.parameters})
        self.normal = found[Set({effect.name})].normal
        library, size = self.evidence.library, size_of(effect)
        self.unit = np.zeros(len(library.slots))
        for i in library.indices[effect.name]:
            name = library.slots[i].parameter
            if name not in SECONDARY:
                true = effect.parameters.get(name, library.slots[i].neutral)
                self.unit[i] = (true - library.slots[i].neutral) / size

    def limit(self, n_flights: int, noise: float) -> Limit:
        """The limit of so many flights, and the bound."""
        weighed = _Weighed(self, n_flights, noise)
        sizes = FACTORS * size_of(self.effect)
        shares = np.asarray([np.mean(weighed.named(size)) for size in sizes])
        sigmas = stats.norm.ppf(1.0 - ALARMS) + stats.norm.ppf(NAMED)
        bound = float(sigmas / weighed.strength)
        below = np.flatnonzero(shares < NAMED)
        if not len(below):
            raise ArithmeticError(f"{self.effect.name} is named at {sizes[0]:.1e}.")
        last = int(below[-1])
        if last + 1 >= len(sizes) or sizes[last + 1] > self._largest():
            return Limit(math.nan, bound, weighed.rival(sizes[min(last, len(sizes) - 1)]))
        part = (NAMED - shares[last]) / (shares[last + 1] - shares[last])
        found = float(sizes[last] * (sizes[last + 1] / sizes[last]) ** part)
        return Limit(found, bound, weighed.rival(sizes[last]))

    def named(self, size: float, n_flights: int, noise: float) -> float:
        """Share of cases in which an effect of `size` is named."""
        return float(np.mean(_Weighed(self, n_flights, noise).named(size)))

    def _largest(self) -> float:
        """The largest size within the bounds of the library."""
        library = self.evidence.library
        up, down = library.high - library.neutral, library.neutral - library.low
        room = np.where(self.unit > 0, up, down)
        used = self.unit != 0
        return float(np.min(room[used] / np.abs(self.unit[used])))


class _Weighed:
    """The linear problem of a number of flights at some noise."""

    def __init__(self, linear: Linear, n_flights: int, noise: float) -> None:
        self.linear, evidence = linear, linear.evidence
        kinds = np.bincount(np.asarray(split(n_flights)[0]) % N_KINDS, minlength=N_KINDS)
        count = kinds[linear.normal.flight].astype(float)
        self.H, self.index, self.onsets = _with_onsets(evidence, linear, count / noise**2)
        signal = self.H[:, : len(linear.unit)] @ linear.unit
        flown = np.bincount(np.arange(n_flights) % N_KINDS, minlength=N_KINDS)
        every = flown[linear.normal.flight] / noise**2
        told = np.einsum("a,wab,b->w", linear.unit, linear.normal.H, linear.unit)
        self.strength = float(np.sqrt(every @ told))
        rng = np.random.default_rng(SEED)
        scores = noise_scores(self.H, rng)
        self.sets = [self._set(*chosen, signal, scores) for chosen in self._choices()]
        local, freedom = _local(linear)
        self.local, self.dof = float(count @ local) / noise**2, freedom * float(count.sum())
        self.left = rng.chisquare(self.dof, DRAWS) / self.dof

    def named(self, size: float) -> np.ndarray:
        """Which draws name the effect."""
        best = np.argmax(self._posteriors(size), axis=1)
        right = np.asarray([self.linear.effect.name in s.names for s in [_NOMINAL, *self.sets]])
        return right[best] & ~self._structured(size)

    def rival(self, size: float) -> str:
        """What is answered most often by draws that do not name the effect."""
        best = np.argmax(self._posteriors(size), axis=1)
        names = [" + ".join(sorted(s.names)) or "none" for s in [_NOMINAL, *self.sets]]
        wrong = ~self.named(size)
        if not wrong.any():
            return ""
        said = np.where(self._structured(size), "unexplained", np.asarray(names, object)[best])
        found, counts = np.unique(said[wrong].astype(str), return_counts=True)
        return str(found[np.argmax(counts)])

    def _posteriors(self, size: float) -> Float[np.ndarray, "draws sets"]:
        nominal = np.zeros(DRAWS)
        return np.stack([nominal, *(s.posterior(size) for s in self.sets)], axis=1)

    def _structured(self, size: float) -> np.ndarray:
        """Which draws leave what looks like structure, by the thresholds of the verdict."""
        found = self.left + size**2 * self.local / self.dof
        share = np.clip((self.left - 1.0) / np.maximum(found - 1.0, 1e-9), 0.0, 1.0)
        return verdict.unexplained(
            share, lambda threshold: self.left > verdict.beyond_chance(threshold, self.dof)
        )

    def _choices(self) -> list[tuple[Set, list[int]]]:
        """Sets with their places in `H`."""
        library, true = self.linear.evidence.library, self.linear.effect.name
        own = library.indices[true]
        alone = [(name, library.indices[name]) for name in library.candidates if name != "gust"]
        alone += [("gust", onset) for onset in self.onsets]
        found = [(Set({true}), own)]
        found += [(Set({name}), at) for name, at in alone if name != true]
        return found + [(Set({true, name}), own + at) for name, at in alone if name != true]

    def _set(self, names: Set, at: list[int], signal: np.ndarray, noise: np.ndarray) -> _Set:
        evidence = self.linear.evidence
        H = self.H[np.ix_(at, at)]
        scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
        # One after the other, so that a bound of the last is one of what it adds to those before.
        lower = np.linalg.cholesky(H / np.outer(scale, scale) + 1e-9 * np.eye(len(at)))
        white = np.linalg.inv(lower) / scale
        slots = [evidence.library.slots[self.index[i]] for i in at]
        signs = [
            0.0
            if s.parameter in SECONDARY
            else float(s.low >= s.neutral) - float(s.high <= s.neutral)
            for s in slots
        ]
        cost = evidence.occam(H, [int(self.index[i]) for i in at])
        cost += evidence.decision.effect_cost * len(names)
        return _Set(names, white @ signal[at], noise[:, at] @ white.T, np.asarray(signs), cost)


_NOMINAL = _Set(Set(), np.zeros(0), np.zeros((0, 0)), np.zeros(0), 0.0)


def noise_scores(
    H: Float[np.ndarray, "n n"], rng: np.random.Generator
) -> Float[np.ndarray, "draws n"]:
    """Draws of scores with covariance `H`; zeros where flights say nothing of a parameter."""
    scale = np.sqrt(np.diag(H))
    unit = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(H / np.outer(unit, unit))
    z = rng.standard_normal((DRAWS, len(values)))
    return (z * np.sqrt(np.clip(values, 0.0, None))) @ vectors.T * scale


def _with_onsets(
    evidence: Evidence, linear: Linear, weight: Float[np.ndarray, " windows"]
) -> tuple[np.ndarray, Int[np.ndarray, " places"], list[list[int]]]:
    """Summed information with columns for gusts from every onset, each column's parameter, places.

    A gust that is true has its own columns, which know when it begins.
    """
    normal, library = linear.normal, evidence.library
    n = len(library.slots)
    axes = [i for i in library.indices.get("gust", []) if library.slots[i].parameter != "onset"]
    scanned = len(axes) == 3 and linear.effect.name != "gust"
    times = np.unique(normal.t)[evidence.decision.quiet_windows : -1] if scanned else np.zeros(0)
    index = np.concatenate([np.arange(n), np.tile(axes, len(times))]).astype(int)
    on = np.ones((len(normal.t), len(index)))
    for k, time in enumerate(times):
        on[:, n + 3 * k : n + 3 * k + 3] = (normal.t >= time - REPLAY_WINDOW_S / 2)[:, None]
    H = np.einsum("w,wa,wb,wab->ab", weight, on, on, normal.H[:, index][:, :, index], optimize=True)
    return H, index, [[n + 3 * k + i for i in range(3)] for k in range(len(times))]


def _local(linear: Linear) -> tuple[Float[np.ndarray, " windows"], int]:
    """Chi-square of the effect at size one that a window may take for a force and tilt of its own.

    And how many numbers it has for that.
    """
    normal, library = linear.normal, linear.evidence.library
    at = library.local
    H = normal.H[:, at][:, :, at]
    wanted = normal.H[:, at] @ linear.unit
    inverse = np.linalg.pinv(H, rcond=1e-6, hermitian=True)
    return np.einsum("wi,wij,wj->w", wanted, inverse, wanted), len(at)
