r"""Candidate sets fitted one by one, from screening by one Jacobian to the refit of the best.

At any parameter vector the normal equations hold the slopes of the whole library, so that the gain
of every set that could be added there costs only linear algebra. Sets that this screening puts
near the top are refitted through the simulator (Gauss-Newton, bounds respected), and the screening
is repeated from where they end, until nothing is gained any more.

The log evidence of a set (Laplace's approximation, parameters uniform within their bounds) is

    ln E = -chi2 / (2 phi) - sum_j ln((high_j - low_j) / sqrt(2 pi)) - 1/2 ln det(H / phi)

with phi >= 1 the dispersion between flights (`dispersion`), which makes flights, not samples, the
unit of replication.

With a reference, what the nominal simulator lacks on both sets is a shared vector s with a
Gaussian precision S from the reference flights; it is eliminated from every solve.
"""

import dataclasses
import itertools
from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from diagnosis.library import Library
from diagnosis.likelihood import Likelihood, Normal
from diagnosis.segments import WINDOW

Set = frozenset[str]

START = {
    "attitude_loop": {"natural_freq": 15.0, "damping": 1.0},
    "gust": {"onset": 0.0},
}
"""Where a fit starts whose slope at neutral vanishes; gust's onset is found by scanning."""
QUIET = 3
"""Windows before the earliest onset: a gust that blows from the start is a wind."""
REFITS = 4
"""Most sets of one size that are refitted."""
NEAR = 0.85
"""Share of the best linear gain from which a set is worth refitting."""
PARTS = (1.0, 0.5, 0.2, 0.05)
"""Parts of a Gauss-Newton step that are tried until one is better."""
STEPS = 8
"""Most Gauss-Newton steps of a refit."""
HOPELESS = 50.0
"""Log evidence [nats] below that of another set at which a refit ends early."""
ACROSS = 0.1
"""How near an onset must be to the edge of a window for the window beside to be tried [s]."""
WORTH = 3.0
"""Gain [nats] that another effect must promise to be tried; a choice below every threshold."""


@dataclasses.dataclass(frozen=True)
class Fit:
    """A candidate set at its most likely parameters."""

    effects: Set
    """Names; empty for the nominal simulator."""
    vector: Float[np.ndarray, " params"]
    """All parameters of the library."""
    normal: Normal
    """Normal equations of the target flights at `vector`, along every parameter."""
    shared: Float[np.ndarray, " params"]
    """What separates nominal and reference, as a shift of the vector; zero without reference."""
    penalty: float
    """What that shift costs, in units of chi-square."""

    @property
    def objective(self) -> float:
        """Chi-square of the target flights, and of the shared shift; infinite for NaN."""
        value = self.normal.chi2 + self.penalty
        return value if np.isfinite(value) else np.inf


class Problem:
    """Target flights, the nominal (or reference) vector, and what is known of it."""

    def __init__(
        self,
        likelihood: Likelihood,
        base: Float[np.ndarray, " params"] | None = None,
        precision: Float[np.ndarray, "params params"] | None = None,
        phi: float = 1.0,
    ) -> None:
        self.likelihood, self.precision, self.phi = likelihood, precision, phi
        self.library: Library = likelihood.replay.library
        self.base = self.library.neutral if base is None else base
        self.earliest = min(group.start.min() for group in likelihood.groups) + QUIET * WINDOW
        self.fits: dict[Set, Fit] = {}
        self.known: dict[Set, Fit] = {}

    def renew(self) -> None:
        """Forgets all fits but where they ended: the likelihood was settled anew."""
        self.known, self.fits = self.fits, {}

    def free(self, effects: Iterable[str]) -> list[int]:
        """Entries of the vector that a set sets free."""
        return [i for name in sorted(effects) for i in self.library.indices(name)]

    def anchor(self) -> Fit:
        """The base vector as it is, from which candidates are screened."""
        zero = np.zeros(len(self.base))
        return Fit(Set(), self.base, self.likelihood.normal(self.base), zero, 0.0)

    def nominal(self) -> Fit:
        """The fit without any effect: the anchor, but for a shared shift."""
        if Set() not in self.fits:
            self.fits[Set()] = self._descended(self.anchor(), [])
        return self.fits[Set()]

    def refit(self, effects: Set, near: Fit) -> Fit:
        """The set at its most likely parameters, started from what `near` promises."""
        if effects not in self.fits:
            near = self.known.get(effects, near)
            starts = [near.vector] if near.effects == effects else self._starts(effects, near)
            # A linear step may end where nothing is better; what it started from is never worse.
            fits = [
                Fit(effects, start, self.likelihood.normal(start), near.shared, near.penalty)
                for start in (*starts, near.vector)
            ]
            best = min(fits, key=lambda fit: fit.objective)
            best = self._descended(best, self.free(effects))
            if "gust" in effects:
                best = min(best, self._across(best), key=lambda fit: fit.objective)
            self.fits[effects] = best
        return self.fits[effects]

    def _across(self, fit: Fit) -> Fit:
        """The fit whose gust begins on the other side of the nearest edge between windows.

        An onset shortly before an edge leaves a second minimum shortly behind it: to the window
        after, a start that is off and a gust that begins late look much the same.
        """
        at = self._place("gust", "onset")
        edge = WINDOW * round(fit.vector[at] / WINDOW)
        if abs(fit.vector[at] - edge) > ACROSS:
            return fit
        vector = fit.vector.copy()
        vector[at] = edge + 0.597 * (-ACROSS if vector[at] >= edge else ACROSS)
        free = self.free(fit.effects)
        vector = self._within(vector, free)
        moved = dataclasses.replace(fit, vector=vector, normal=self.likelihood.normal(vector))
        return self._descended(moved, free)

    def _starts(self, effects: Set, near: Fit) -> list[Float[np.ndarray, " params"]]:
        """Where to start: one vector, but two where a gust may begin in either of two windows.

        An onset has a slope only while it lies within its window and between two steps.
        """
        start = self._start(effects, near)
        if "gust" not in effects - near.effects:
            return [start]
        at, found = self._place("gust", "onset"), []
        for shift in (-0.4987, 0.5013):
            moved = start.copy()
            moved[at] += shift * WINDOW
            found.append(moved)
        return found

    def _start(self, effects: Set, near: Fit) -> Float[np.ndarray, " params"]:
        """Inside the bounds: the linear solution at `near`, or the start that is declared."""
        fresh = near.vector.copy()
        for name in effects - near.effects:
            for parameter, value in START.get(name, {}).items():
                at = [i for i in self.library.indices(name) if self._is(i, parameter)]
                fresh[at] = value
        normal = near.normal
        if "gust" in effects - near.effects:
            onset = self.onset(near, effects)
            fresh[self._place("gust", "onset")] = onset
            normal = _switched(normal, self.library.indices("gust"), onset)
        free = self.free(effects)
        fresh = self._within(fresh, free)
        fresh[free] += self._bounded(normal, dataclasses.replace(near, vector=fresh), free)[0]
        return fresh

    def onset(self, near: Fit, effects: Set) -> float:
        """The time [s] at which a gust would begin to explain most."""
        free = self.free(effects)
        times = np.unique(near.normal.t)[QUIET:]
        gust = self.library.indices("gust")
        gains = [self.solve(_switched(near.normal, gust, t), near, free)[1] for t in times[:-1]]
        return float(times[int(np.argmax(gains))]) if gains else 0.0

    def _is(self, i: int, parameter: str) -> bool:
        return self.library.slots[i].parameter == parameter

    def _place(self, effect: str, parameter: str) -> int:
        return next(i for i in self.library.indices(effect) if self._is(i, parameter))

    def _within(self, vector: np.ndarray, free: list[int]) -> np.ndarray:
        vector = vector.copy()
        vector[free] = np.clip(vector[free], *self._bounds(free))
        return vector

    def _bounds(self, free: list[int]) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.library.low.copy(), self.library.high
        if "gust" in self.library.effects:
            low[self._place("gust", "onset")] = self.earliest
        return low[free], high[free]

    def _bounded(
        self, normal: Normal, fit: Fit, free: list[int]
    ) -> tuple[Float[np.ndarray, " free"], float]:
        """Linear step within the bounds, and the fall in chi-square that it promises."""
        H, g = self.reduced(normal, fit, free)
        if not free or not np.isfinite(H).all():
            return np.zeros(len(free)), 0.0
        low, high = self._bounds(free)
        step = bounded_step(H, g, low - fit.vector[free], high - fit.vector[free])
        return step, float(2 * g @ step - step @ H @ step)

    def solve(
        self, normal: Normal, fit: Fit, free: list[int]
    ) -> tuple[Float[np.ndarray, " free"], float]:
        """Linear step of the free parameters, and the fall in chi-square that it promises."""
        H, g = self.reduced(normal, fit, free)
        if not free:
            return np.zeros(0), 0.0
        step = np.linalg.lstsq(*_scaled(H, g), rcond=1e-9)[0] / _scale(H)
        return step, float(2 * g @ step - step @ H @ step)

    def reduced(
        self, normal: Normal, fit: Fit, free: list[int]
    ) -> tuple[Float[np.ndarray, "free free"], Float[np.ndarray, " free"]]:
        """Normal equations of the free parameters, the shared shift eliminated."""
        H, g = normal.H.sum(axis=0), normal.g.sum(axis=0)
        inner, right = H[np.ix_(free, free)], g[free]
        if self.precision is None:
            return inner, right
        known = H + self.precision
        pull = np.linalg.solve(
            known, np.column_stack([H[:, free], g - self.precision @ fit.shared])
        )
        return inner - H[free] @ pull[:, :-1], right - H[free] @ pull[:, -1]

    def _descended(self, fit: Fit, free: list[int]) -> Fit:
        best = max((self.log_evidence(other) for other in self.fits.values()), default=-np.inf)
        for left in reversed(range(STEPS)):
            better = self._step(fit, free)
            gain = fit.objective - better.objective if better else 0.0
            fit = better or fit
            within_reach = -0.5 * (fit.objective - left * gain) / self.phi
            if gain < 0.05 * self.phi or within_reach < best - HOPELESS:
                return fit
        return fit

    def _step(self, fit: Fit, free: list[int]) -> Fit | None:
        """A fit that is better, along the Gauss-Newton step or a part of it."""
        step, promise = self._bounded(fit.normal, fit, free)
        if promise < 0.02 * self.phi and not np.any(self._shared_step(fit, free, step)):
            return None
        for part in PARTS:
            shift = part * self._shared_step(fit, free, step)
            own = fit.vector + shift
            own[free] += part * step
            shared = fit.shared + shift
            tried = dataclasses.replace(
                fit,
                vector=own,
                normal=self.likelihood.normal(own),
                shared=shared,
                penalty=0.0 if self.precision is None else float(shared @ self.precision @ shared),
            )
            if tried.objective < fit.objective:
                return tried
        return None

    def _shared_step(self, fit: Fit, free: list[int], step: np.ndarray) -> np.ndarray:
        if self.precision is None:
            return np.zeros(len(fit.vector))
        H, g = fit.normal.H.sum(axis=0), fit.normal.g.sum(axis=0)
        right = g - self.precision @ fit.shared - H[:, free] @ step
        return np.linalg.solve(H + self.precision, right)

    def log_evidence(self, fit: Fit) -> float:
        """Laplace's log evidence [nats]."""
        free = self.free(fit.effects)
        H, _ = self.reduced(fit.normal, fit, free)
        return -0.5 * fit.objective / self.phi - self.occam(H, free)

    def occam(self, H: Float[np.ndarray, "free free"], free: list[int]) -> float:
        """What the parameters cost: ln of prior range over posterior width [nats]."""
        if not free:
            return 0.0
        width = (self.library.high - self.library.low)[free]
        sizes = np.linalg.slogdet(H / self.phi + np.diag(2 * np.pi / width**2))[1]
        return float(np.sum(np.log(width / np.sqrt(2 * np.pi))) + 0.5 * sizes)

    def promised(self, near: Fit, effects: Set) -> float:
        """Log evidence that the linear screening at `near` promises a set [nats]."""
        free, normal = self.free(effects), near.normal
        if "gust" in effects - near.effects:
            normal = _switched(normal, self.library.indices("gust"), self.onset(near, effects))
        _, gain = self.solve(normal, near, free)
        H, _ = self.reduced(normal, near, free)
        return -0.5 * (near.objective - gain) / self.phi - self.occam(H, free)

    def search(self, largest: int = 3) -> list[Fit]:
        """Fits of every set that came near the top, best evidence first."""
        best, front = [self.nominal()], [self.anchor()]
        for _ in range(largest):
            grown = list(self._grow(front))
            if not grown:
                break
            ranked = sorted([*best, *grown], key=self.log_evidence, reverse=True)
            improved = ranked[0] is not sorted(best, key=self.log_evidence, reverse=True)[0]
            best = ranked
            front = sorted(grown, key=self.log_evidence, reverse=True)[:3]
            if not improved:
                break
        self._prune()
        return sorted(self.fits.values(), key=self.log_evidence, reverse=True)

    def _prune(self) -> None:
        """Refits the best set without each of its effects, as long as that is better.

        Growing one by one may pass through an effect that the last one made needless.
        """
        while True:
            best = max(self.fits.values(), key=self.log_evidence)
            for name in best.effects:
                less = best.effects - {name}
                if less not in self.fits:
                    vector = best.vector.copy()
                    gone = self.library.indices(name)
                    vector[gone] = self.base[gone] + best.shared[gone]
                    near = dataclasses.replace(best, effects=less, vector=vector)
                    self.refit(less, near)
            if best is max(self.fits.values(), key=self.log_evidence):
                return

    def _grow(self, front: list[Fit]) -> Iterator[Fit]:
        """Refitted sets with one effect more than those of the front."""
        promised: dict[Set, tuple[float, Fit]] = {}
        for near, name in itertools.product(front, self.library.candidates):
            effects = near.effects | {name}
            if name in near.effects:
                continue
            value = self.promised(near, effects)
            if effects not in promised or value > promised[effects][0]:
                promised[effects] = (value, near)
        base = max(self.log_evidence(fit) for fit in front)
        best = max(self.log_evidence(fit) for fit in self.fits.values())
        ranked = sorted(promised.items(), key=lambda item: item[1][0], reverse=True)
        top, kept = ranked[0][1][0] - base if ranked else 0.0, -np.inf
        for count, (effects, (value, near)) in enumerate(ranked):
            declared = any(name in START and name != "gust" for name in effects - near.effects)
            # What the others must come near to: a promise, until it turns out to be too large.
            goal = min(top, kept) if count else top
            close = value - base > max(WORTH, NEAR * goal) or value - base > goal - 30.0
            if declared or (count < REFITS and value - base > WORTH and close):
                fit = self.refit(effects, near)
                kept = max(kept, self.log_evidence(fit) - best)
                yield fit


def bounded_step(
    H: Float[np.ndarray, "free free"],
    g: Float[np.ndarray, " free"],
    low: Float[np.ndarray, " free"],
    high: Float[np.ndarray, " free"],
) -> Float[np.ndarray, " free"]:
    """The step that solves H step = g as well as `low` and `high` allow; zero is allowed."""
    scale = _scale(H)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    kept = values > 1e-9 * max(values.max(), 1e-9)
    if not kept.any():
        return np.zeros(len(g))
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = vectors[:, kept].T @ (g / scale) / np.sqrt(values[kept])
    low, high = scale * np.minimum(low, 0.0) - 1e-12, scale * np.maximum(high, 0.0) + 1e-12
    return np.asarray(lsq_linear(root, target, (low, high)).x) / scale


def _scale(H: np.ndarray) -> np.ndarray:
    """Square roots of the diagonal, one where it vanishes."""
    root = np.sqrt(np.clip(np.diag(H), 0.0, None))
    return np.where(root > 0, root, 1.0)


def _scaled(H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations with a unit diagonal."""
    scale = _scale(H)
    return H / np.outer(scale, scale), g / scale


def _switched(normal: Normal, columns: list[int], onset: float) -> Normal:
    """Normal equations in which some parameters act only in windows from `onset` on."""
    on = (normal.t >= onset - WINDOW / 2).astype(float)
    mask = np.ones((len(normal.t), normal.H.shape[1]))
    mask[:, columns] = on[:, None]
    return dataclasses.replace(
        normal, H=normal.H * mask[:, :, None] * mask[:, None, :], g=normal.g * mask
    )


def dispersion(normal: Normal, n_flights: int) -> float:
    """Variance of the flights' scores over what independent samples would give, at least 1.

    Computed after the step that the whole library would take, so that an effect which is merely
    missing does not count as dispersion. With fewer than three flights, blocks of time stand in.
    """
    groups = normal.flight if n_flights >= 3 else np.arange(len(normal.t)) * 8 // len(normal.t)
    H, g = normal.H.sum(axis=0), normal.g.sum(axis=0)
    seen = np.diag(H) > 1e-9 * np.max(np.diag(H))
    H, g = H[np.ix_(seen, seen)], g[seen]
    values, vectors = np.linalg.eigh(_scaled(H, g)[0])
    kept = values > 1e-6
    whiten = (vectors[:, kept] / np.sqrt(values[kept])).T / _scale(H)
    step = whiten.T @ (whiten @ g)
    scores = []
    for group in np.unique(groups):
        rows = groups == group
        left = (
            normal.g[rows][:, seen].sum(axis=0) - normal.H[rows][:, seen][:, :, seen].sum(0) @ step
        )
        scores.append(whiten @ left)
    n = len(scores)
    return max(1.0, float(np.sum(np.square(scores)) / kept.sum() / (1.0 - 1.0 / n)))
