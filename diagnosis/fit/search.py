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
eliminated to first order (`evidence.py`); the sets that end on top are flown with it
(`polish`). What differs between reference flights may differ here, too (`loosened`).
"""

import dataclasses
import itertools
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from diagnosis.fit.descent import descended, fitted, polished, whole
from diagnosis.fit.equations import summed
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Fit, Set
from diagnosis.fit.windows import Spoiled


@dataclasses.dataclass(frozen=True)
class Fits:
    """Fits of candidate sets to the same evidence."""

    evidence: Evidence
    """What was fitted to."""
    by_set: Mapping[Set, Fit]
    """Every set that was fitted; the empty one is the base vector without any effect."""
    known: Mapping[Set, Fit] = dataclasses.field(default_factory=lambda: MappingProxyType({}))
    """Where fits ended before the likelihood was settled anew."""

    @classmethod
    def of(cls, evidence: Evidence) -> "Fits":
        """The base vector alone, from which candidates are screened."""
        return cls(evidence, {Set(): evidence.made(Set(), evidence.base)})

    def __getitem__(self, effects: Set) -> Fit:
        return self.by_set[effects]

    @property
    def nominal(self) -> Fit:
        """The base vector without any effect."""
        return self.by_set[Set()]

    @property
    def best(self) -> Fit:
        """The fit with the most evidence."""
        return self.ranked()[0]

    def ranked(self) -> list[Fit]:
        """All fits, best evidence first."""
        return sorted(self.by_set.values(), key=self.evidence.log_evidence, reverse=True)

    def below_best(self, nats: float, but: Set | None = None) -> float:
        """Log evidence so many `nats` below the best fit's, `but` one set's."""
        others = (fit for effects, fit in self.by_set.items() if effects != but)
        return max(map(self.evidence.log_evidence, others), default=-np.inf) - nats

    def plus(self, fit: Fit) -> "Fits":
        """These and another fit, which takes the place of that of the same set."""
        return dataclasses.replace(self, by_set={**self.by_set, fit.effects: fit})

    def weighed(self, phi: float) -> "Fits":
        """The same fits under another dispersion."""
        return dataclasses.replace(self, evidence=dataclasses.replace(self.evidence, phi=phi))

    def settled(
        self, vector: Float[np.ndarray, " params"], spoiled: Spoiled | None = None
    ) -> "Fits":
        """No fits but where these ended, in a likelihood that is settled at `vector`."""
        likelihood = self.evidence.likelihood.settled(vector, spoiled)
        known = {
            effects: dataclasses.replace(fit, normal=summed(fit.normal))
            for effects, fit in self.by_set.items()
        }
        anew = Fits.of(dataclasses.replace(self.evidence, likelihood=likelihood))
        return dataclasses.replace(anew, known=known)


def search(fits: Fits, largest: int | None = None) -> Fits:
    """Fits of every set that came near the top, of `largest_set` effects or at most `largest`.

    Sets that were near the top before the likelihood was settled anew are fitted again, and grown
    from there.
    """
    value, decision = fits.evidence.log_evidence, fits.evidence.decision
    largest = decision.largest_set if largest is None else largest
    before = sorted(fits.known.values(), key=value, reverse=True)
    for fit in before:
        if value(fit) > value(before[0]) - decision.again_nats:
            fits = refit(fits, fit.effects, fits.nominal)
    front = fits.ranked()[: decision.front]
    while front := [fit for fit in front if len(fit.effects) < largest]:
        best = fits.best
        fits, grown = _grow(fits, front)
        front = sorted(grown, key=value, reverse=True)[: decision.front]
        if fits.best is best:
            break
    return _prune(fits, decision.again_nats)


def search_firmly(evidence: Evidence) -> Fits:
    """Fits at what the reference flights say, of which nothing may shift yet.

    Far from the right set, what is shared would be drawn along by the misfit, to first order;
    two drones' downwash beside a lost thrust or a battery was not found so.
    """
    return search(Fits.of(dataclasses.replace(evidence, precision=None)))


def refit(fits: Fits, effects: Set, near: Fit) -> Fits:
    """These with a set's fit, started from what `near` promises; as they are if they have it."""
    if effects in fits.by_set:
        return fits
    near = fits.known.get(effects, near)
    goal = fits.below_best(fits.evidence.decision.hopeless_nats)
    return fits.plus(fitted(fits.evidence, effects, near, goal))


def polish(fits: Fits, effects: Set, hopeless: float | None = None) -> Fits:
    """These with the whole shared shift of a set flown, not taken to first order.

    Its steps end early where it will stay `hopeless` nats below another fit.
    """
    hopeless = fits.evidence.decision.hopeless_nats if hopeless is None else hopeless
    goal = fits.below_best(hopeless, but=effects)
    return fits.plus(polished(fits.evidence, fits[effects], goal))


def polish_best(fits: Fits) -> Fits:
    """Polishes the set on top, and the next one if that takes its place.

    What that set would be without one of its effects is fitted again from there and polished: a
    larger set must not be better only because it was fitted for longer. Where polishing changed
    much, what the set left before says little of what it leaves now, and larger ones are tried
    from there.
    """
    done: set[Set] = set()
    value, decision = fits.evidence.log_evidence, fits.evidence.decision
    while (best := fits.best).effects not in done:
        done.add(best.effects)
        fits = polish(fits, best.effects)
        fit = fits[best.effects]
        gained = value(fit) - value(best)
        if gained > decision.again_nats and len(fit.effects) < decision.largest_set:
            fits = outgrow(fits, fit)
        fits = _prune(fits, decision.worth_nats, polished=True)
    return fits


def outgrow(fits: Fits, fit: Fit) -> Fits:
    """These with larger sets refitted from `fit`, where that is better than what they had."""
    value = fits.evidence.log_evidence
    before = {effects: old for effects, old in fits.by_set.items() if fit.effects < effects}
    fewer = dataclasses.replace(
        fits,
        by_set={effects: old for effects, old in fits.by_set.items() if effects not in before},
        known={effects: old for effects, old in fits.known.items() if effects not in before},
    )
    found, _ = _grow(fewer, [fit])
    for effects, old in before.items():
        found = found.plus(max(old, found.by_set.get(effects, old), key=value))
    return found


def without(fits: Fits, best: Fit, name: str, hopeless: float | None = None) -> Fits:
    """These with the other effects of a set, fitted from there or kept where that was better.

    Its steps end early `hopeless` nats below another fit (`hopeless_nats` if None).
    """
    evidence = fits.evidence
    goal = fits.below_best(evidence.decision.hopeless_nats if hopeless is None else hopeless)
    less, vector, gone = best.effects - {name}, best.vector.copy(), evidence.library.indices[name]
    vector[gone] = evidence.base[gone] + best.shared[gone]
    fit = descended(evidence, evidence.made(less, vector, best.shared), goal)
    fit = whole(evidence, fit, goal)
    return fits.plus(max(fits.by_set.get(less, fit), fit, key=evidence.log_evidence))


def _prune(fits: Fits, within: float, polished: bool = False) -> Fits:
    """These with the best set refitted without each of its effects, as long as that is better.

    Growing one by one may pass through an effect that the last one made needless.
    """
    while True:
        best = fits.best
        for name in best.effects:
            fits = _spare(fits, best, name, within, polished)
        if best is fits.best:
            return fits


def _spare(fits: Fits, best: Fit, name: str, within: float, polished: bool) -> Fits:
    """These with `best` without an effect that brings little, unless that was done as well.

    As well is `within` so many nats of what the effect is worth to first order.
    """
    value, old = fits.evidence.log_evidence, fits.by_set.get(best.effects - {name})
    worth = fits.evidence.worth(best, name)
    near = value(best) - worth - within
    if worth < fits.evidence.decision.needed_nats and (old is None or value(old) < near):
        fits = without(fits, best, name, np.inf if polished else None)
        return polish(fits, best.effects - {name}) if polished else fits
    return fits


def _grow(fits: Fits, front: list[Fit]) -> tuple[Fits, list[Fit]]:
    """These with sets of one effect more than those of the front, and the fits of such sets."""
    evidence, decision, found = fits.evidence, fits.evidence.decision, []
    promised: dict[Set, tuple[float, Fit]] = {}
    for near, name in itertools.product(front, evidence.library.candidates):
        effects = near.effects | {name}
        if name in near.effects:
            continue
        value = evidence.promised(near, effects)
        if effects not in promised or value > promised[effects][0]:
            promised[effects] = (value, near)
    base = max(evidence.log_evidence(fit) for fit in front)
    ranked = sorted(promised.items(), key=lambda item: item[1][0], reverse=True)
    top, kept = ranked[0][1][0] - base if ranked else 0.0, -np.inf
    for count, (effects, (value, near)) in enumerate(ranked):
        declared = any(evidence.library.card(name).start for name in effects - near.effects)
        # What the others must come near to: a promise, until it turns out to be too large.
        goal = min(top, kept)
        gain, least = value - base, decision.worth_nats
        close = gain > max(least, decision.near_share * goal) or gain > goal - decision.near_nats
        if declared or (count < decision.refits and gain > least and close):
            fits = refit(fits, effects, near)
            kept = max(kept, evidence.log_evidence(fits[effects]) - base)
            found.append(fits[effects])
    return fits, found
