r"""Candidate sets fitted one by one, from screening by one Jacobian to the refit of the best.

At any parameter vector the normal equations hold the slopes of the whole library, so that the gain
of every set that could be added there costs only linear algebra. Sets that this screening puts
near the top are refitted through the simulator (Gauss-Newton, bounds respected), and the screening
is repeated from where they end, until nothing is gained any more.

The log evidence of a set (Laplace's approximation, parameters uniform within their bounds) is

    ln E = -chi2 / (2 phi) - sum_j ln((high_j - low_j) / sqrt(2 pi)) - 1/2 ln det(H / phi)

with phi >= 1 the dispersion between flights (`dispersion`), which makes flights, not samples, the
unit of replication.

With a reference, what the nominal simulator lacks on both sets is held in a first search, then
eliminated to first order (`reduced.py`); the sets that end on top are flown with it
(`Problem.polish`). What differs between reference flights may differ here, too (`loosened`).
"""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from diagnosis.fit.equations import summed
from diagnosis.fit.fit import Fit, Set
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.reduced import Equations
from diagnosis.fit.windows import Normal
from diagnosis.logs.segments import WINDOW

LARGEST = 3
"""Most effects of a set."""
REFITS = 4
"""Most sets of one size that are refitted."""
NEAR = 0.2
"""Share of the best linear gain from which a set is worth refitting: far from neutral a linear gain
says little, and from a wrong effect the search does not come back."""
PARTS = (1.0, 0.5, 0.2, 0.05)
"""Parts of a Gauss-Newton step that are tried until one is better."""
DAMPINGS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
"""Shares of its own curvature by which a step of all parameters at once is damped, in turn.
With 0.01 as the least, the fit of one set of reference flights crept along a valley to its side."""
STEPS = 8
"""Most Gauss-Newton steps of a refit."""
FRONT = 3
"""Sets of one size from which larger ones are grown."""
NEEDED = 500.0
"""Log evidence [nats] that an effect must bring, to first order, not to be tried without."""
AGAIN = 100.0
"""Log evidence [nats] below the best at which a set is fitted again after `renew`."""
HOPELESS = 50.0
"""Log evidence [nats] below that of another set at which a refit ends early."""
ACROSS = 0.1
"""How near an onset must be to the edge of a window for the window beside to be tried [s]."""
WORTH = 3.0
"""Gain [nats] that another effect must promise to be tried; a choice below every threshold."""


class Problem(Equations):
    """Fits of candidate sets."""

    def __init__(
        self,
        likelihood: Likelihood,
        base: Float[np.ndarray, " params"] | None = None,
        precision: Float[np.ndarray, "params params"] | None = None,
        spread: Float[np.ndarray, " params"] | None = None,
    ) -> None:
        super().__init__(likelihood, base, precision, spread)
        self.fits: dict[Set, Fit] = {}
        self.known: dict[Set, Fit] = {}

    def renew(self) -> None:
        """Forgets all fits but where they ended: the likelihood was settled anew."""
        self.known = {
            effects: dataclasses.replace(fit, normal=summed(fit.normal))
            for effects, fit in self.fits.items()
        }
        self.fits = {}

    def nominal(self) -> Fit:
        """The base vector without any effect, from which candidates are screened."""
        if Set() not in self.fits:
            self.fits[Set()] = self.made(Set(), self.base)
        return self.fits[Set()]

    def polish(self, effects: Set, steps: int = 2 * STEPS, hopeless: float = HOPELESS) -> Fit:
        """The fit of a set with its whole shared shift flown, not taken to first order.

        It ends early where it will stay `hopeless` nats below another fit.
        """
        fit = self.as_flown(self.fits[effects])
        others = [self.log_evidence(other) for key, other in self.fits.items() if key != effects]
        goal = max(others, default=-np.inf) - hopeless
        for left in reversed(range(steps if self.precision is not None else 0)):
            further = self._jointly(fit)
            gain, fit = fit.objective - further.objective, further
            if self._ends(fit, gain, left, goal):
                break
        self.fits[effects] = fit
        return fit

    def _ends(self, fit: Fit, gain: float, left: int, goal: float) -> bool:
        """Whether a fit that gained so much is settled, or will not reach `goal` in `left` steps.

        `goal` is a log evidence [nats].
        """
        return gain < 0.05 * self.phi or -0.5 * (fit.objective - left * gain) / self.phi < goal

    def _jointly(self, fit: Fit) -> Fit:
        """A fit that flies better, by a step of the shared shift and the free parameters at once.

        Where flights hardly tell two of them apart (the arms of the rotors and the inertia, say),
        first order promises much that is not there: the step is damped until it is better.
        """
        for damping in DAMPINGS if np.isfinite(fit.normal.H).all() else ():
            at = self.joint_step(fit, damping)
            tried = self.as_flown(self.made(fit.effects, *at, whole=False))
            if tried.objective < fit.objective:
                # What flights draw for themselves goes by slopes, which are anew here.
                tried = self.as_flown(self.made(fit.effects, *at))
                if tried.objective < fit.objective:
                    return tried
        return fit

    def refit(self, effects: Set, near: Fit) -> Fit:
        """The set at its most likely parameters, started from what `near` promises."""
        if effects not in self.fits:
            near = self.known.get(effects, near)
            starts = [] if near.effects == effects else self._starts(effects, near)
            # A linear step may end where nothing is better; what it started from is never worse.
            fits = [
                self.made(effects, start, near.shared, whole=i == 0 and self.precision is not None)
                for i, start in enumerate((*starts, near.vector))
            ]
            best = min(fits, key=lambda fit: fit.objective)
            best = self._descended(best, self.free(effects))
            for name in sorted(effects & self.library.onsets.keys()):
                best = min(best, self._across(best, name), key=lambda fit: fit.objective)
            self.fits[effects] = self._whole(best)
        return self.fits[effects]

    def _whole(self, fit: Fit, hopeless: float = HOPELESS) -> Fit:
        """`fit` along all parameters, taken further if that changes what it is worth."""
        found = self.made(fit.effects, fit.vector, fit.shared)
        if abs(found.objective - fit.objective) < self.phi:
            return found
        further = self._descended(found, self.free(fit.effects), hopeless)
        return self.made(fit.effects, further.vector, further.shared)

    def _across(self, fit: Fit, name: str) -> Fit:
        """The fit whose effect `name` sets in on the other side of the nearest edge of a window.

        An onset shortly before an edge leaves a second minimum shortly behind it: to the window
        after, a start that is off and a push that sets in late look much the same.
        """
        at = self.library.onsets[name]
        edge = WINDOW * round(fit.vector[at] / WINDOW)
        if abs(fit.vector[at] - edge) > ACROSS:
            return fit
        vector = fit.vector.copy()
        vector[at] = edge + 0.597 * (-ACROSS if vector[at] >= edge else ACROSS)
        free = self.free(fit.effects)
        vector = self._within(vector, free)
        return self._descended(self.made(fit.effects, vector, fit.shared, whole=False), free)

    def _starts(self, effects: Set, near: Fit) -> list[Float[np.ndarray, " params"]]:
        """Where to start: one vector, but two where an onset may lie in either of two windows.

        An onset has a slope only while it lies within its window and between two steps.
        """
        starts, silent = [self._start(effects, near)], self._silent(effects, near)
        for at in silent.values():
            either = [(start, shift) for start in starts for shift in (-0.4987, 0.5013)]
            starts = [start.copy() for start, _ in either]
            for start, (_, shift) in zip(starts, either, strict=True):
                start[at] += shift * WINDOW
        return starts

    def _start(self, effects: Set, near: Fit) -> Float[np.ndarray, " params"]:
        """Inside the bounds: the linear solution at `near`, or the start that is declared."""
        fresh = near.vector.copy()
        for name in effects - near.effects:
            for parameter, value in self.library.card(name).start.items():
                fresh[self._place(name, parameter)] = value
        normal, times = self.set_in(effects, near)
        for name, time in times.items():
            fresh[self.library.onsets[name]] = time
        fresh, free = self._within(fresh, self.free(effects)), self._felt(effects, near)
        fresh[free] += self._bounded(normal, dataclasses.replace(near, vector=fresh), free)[0]
        return fresh

    def _descended(self, fit: Fit, free: list[int], hopeless: float = HOPELESS) -> Fit:
        best = max((self.log_evidence(other) for other in self.fits.values()), default=-np.inf)
        for left in reversed(range(STEPS)):
            better = self._step(fit, free)
            gain = fit.objective - better.objective if better else 0.0
            fit = better or fit
            if self._ends(fit, gain, left, best - hopeless):
                return fit
        return fit

    def _step(self, fit: Fit, free: list[int]) -> Fit | None:
        """A fit that is better, along the Gauss-Newton step or a part of it."""
        step, promise = self._bounded(fit.normal, fit, free)
        if promise < 0.02 * self.phi:
            return None
        follows = self._following(fit, free, step)
        for part in PARTS:
            vector = fit.vector.copy()
            vector[free] += part * step
            shift = self._inwards(vector, part * follows)
            tried = self.made(fit.effects, vector + shift, fit.shared + shift, whole=False)
            if tried.objective < fit.objective:
                return tried
        return None

    def promised(self, near: Fit, effects: Set) -> float:
        """Log evidence that the linear screening at `near` promises a set [nats]."""
        normal, gain = self._screened(near, effects)
        free = self.free(effects)
        H, _ = self.reduced(normal, near, free)
        return -0.5 * (near.objective - gain) / self.phi - self.occam(H, free)

    def gain(self, near: Fit, effects: Set) -> float:
        """Fall of chi-square that the linear screening at `near` promises a set."""
        return self._screened(near, effects)[1]

    def _screened(self, near: Fit, effects: Set) -> tuple[Normal, float]:
        """Normal equations at `near`, of what sets in from where it does, and the promised fall."""
        normal, _ = self.set_in(effects, near)
        return normal, self.solve(normal, near, self._felt(effects, near))[1]

    def search(self, largest: int = LARGEST) -> list[Fit]:
        """Fits of every set that came near the top, best evidence first.

        After `renew`, sets that had come near the top are fitted again, and grown from there.
        """
        self.nominal()
        before = sorted(self.known.values(), key=self.log_evidence, reverse=True)
        for fit in before:
            if self.log_evidence(fit) > self.log_evidence(before[0]) - AGAIN:
                self.refit(fit.effects, self.nominal())
        front = self.ranked()[:FRONT]
        while front := [fit for fit in front if len(fit.effects) < largest]:
            best = self.ranked()[0]
            grown = sorted(self._grow(front), key=self.log_evidence, reverse=True)
            front = grown[:FRONT]
            if self.ranked()[0] is best:
                break
        self._prune()
        return self.ranked()

    def search_firmly(self) -> list[Fit]:
        """The first search, at what the reference flights say: nothing of it may shift yet.

        Far from the right set, what is shared would be drawn along by the misfit, to first order;
        two drones' downwash beside a lost thrust or a battery was not found so.
        """
        firm = Problem(self.likelihood, self.base, spread=self.spread)
        firm.phi = self.phi
        found = firm.search()
        self.fits = dict(firm.fits)
        return found

    def ranked(self) -> list[Fit]:
        """All fits, best evidence first."""
        return sorted(self.fits.values(), key=self.log_evidence, reverse=True)

    def polish_best(self) -> None:
        """Polishes the set on top, and the next one if that takes its place.

        What that set would be without one of its effects is fitted again from there and polished: a
        larger set must not be better only because it was fitted for longer. Where polishing changed
        much, what the set left before says little of what it leaves now, and larger ones are tried
        from there.
        """
        polished: set[Set] = set()
        while (best := self.ranked()[0]).effects not in polished:
            polished.add(best.effects)
            fit = self.polish(best.effects)
            if (
                self.log_evidence(fit) - self.log_evidence(best) > AGAIN
                and len(fit.effects) < LARGEST
            ):
                self._outgrow(fit)
            self._prune(WORTH, polished=True)

    def _outgrow(self, fit: Fit) -> None:
        """Refits sets with one effect more than `fit` from there, the better fit is kept."""
        before = {effects: self.fits[effects] for effects in self.fits if fit.effects < effects}
        for effects in before:
            del self.fits[effects]
            self.known.pop(effects, None)
        for _ in self._grow([fit]):
            pass
        for effects, old in before.items():
            new = self.fits.setdefault(effects, old)
            self.fits[effects] = max(old, new, key=self.log_evidence)

    def _prune(self, within: float = AGAIN, polished: bool = False) -> None:
        """Refits the best set without each of its effects, as long as that is better.

        Growing one by one may pass through an effect that the last one made needless.
        """
        while True:
            best = self.ranked()[0]
            for name in best.effects:
                self._spare(best, name, within, polished)
            if best is self.ranked()[0]:
                return

    def _spare(self, best: Fit, name: str, within: float, polished: bool) -> None:
        """Fits `best` without an effect that brings little, unless that was done as well.

        As well is `within` so many nats of what the effect is worth to first order.
        """
        old, worth = self.fits.get(best.effects - {name}), self._worth(best, name)
        near = self.log_evidence(best) - worth - within
        if worth < NEEDED and (old is None or self.log_evidence(old) < near):
            less = self.without(best, name, np.inf if polished else HOPELESS)
            if polished:
                self.polish(less.effects)

    def without(self, best: Fit, name: str, hopeless: float = HOPELESS) -> Fit:
        """The fit of the other effects of a set, taken from there or kept where that was better.

        It ends early `hopeless` nats below another fit.
        """
        less, vector, gone = best.effects - {name}, best.vector.copy(), self.library.indices(name)
        vector[gone] = self.base[gone] + best.shared[gone]
        fit = self._descended(self.made(less, vector, best.shared), self.free(less), hopeless)
        fit = self._whole(fit, hopeless)
        self.fits[less] = max(self.fits.get(less, fit), fit, key=self.log_evidence)
        return self.fits[less]

    def _worth(self, fit: Fit, name: str) -> float:
        """What leaving out an effect of `fit` would cost in log evidence [nats], to first order."""
        gone, kept = self.library.indices(name), self.free(fit.effects - {name})
        (H, _), n = self.reduced(fit.normal, fit, [*gone, *kept]), len(gone)
        own = H[:n, :n] - H[:n, n:] @ np.linalg.pinv(H[n:, n:], hermitian=True) @ H[n:, :n]
        back: Float[np.ndarray, " gone"] = (self.base + fit.shared - fit.vector)[gone]
        return float(0.5 * back @ own @ back / self.phi)

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
        ranked = sorted(promised.items(), key=lambda item: item[1][0], reverse=True)
        top, kept = ranked[0][1][0] - base if ranked else 0.0, -np.inf
        for count, (effects, (value, near)) in enumerate(ranked):
            declared = any(self.library.card(name).start for name in effects - near.effects)
            # What the others must come near to: a promise, until it turns out to be too large.
            goal = min(top, kept)
            close = value - base > max(WORTH, NEAR * goal) or value - base > goal - 30.0
            if declared or (count < REFITS and value - base > WORTH and close):
                fit = self.refit(effects, near)
                kept = max(kept, self.log_evidence(fit) - base)
                yield fit
