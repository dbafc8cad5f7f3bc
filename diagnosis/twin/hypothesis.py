"""One set of effects as the cause of a change, linearised where it fits the changed flights.

A twin is linear in small changes only: half of a thrust is not lost as a tenth of it is, five
times. So the changed flights are flown again at the estimate, by Gauss and Newton, until it moves
by less than a tenth of its standard error or follows them no better.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decision import Decision
from diagnosis.replay.early import lowest
from diagnosis.replay.library import Library
from diagnosis.twin.answer import Naming
from diagnosis.twin.evidence import Evidence, weigh_at
from diagnosis.twin.units import Comparison, Estimate, Group, compare

MOST_REFLIGHTS = 3
"""Most flights again."""
STILL = 0.1
"""Standard errors by which an estimate that has settled moves."""

Refly = Callable[[Float[np.ndarray, " params"], Sequence[int]], Group]
"""The changed flights' scores at a change of the parameters at some places, in units of the ranges.

Only these have slopes of there, which takes 40 % of the time that all would take (four and nine
flights, 1 December); the others keep their slopes without a change."""


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """Effects that may have changed."""

    library: Library
    """All effects."""
    effects: tuple[str, ...]
    """The names of those that may have changed; none for no change."""
    comparison: Comparison
    """Both groups, the changed flights' scores continued to no change from where they are taken."""
    evidence: Evidence
    """What is left there."""
    change: Float[np.ndarray, " params"]
    """Where the scores are taken, in units of the ranges."""

    def of(self, *effects: str) -> "Hypothesis":
        """Other effects, with the same scores."""
        return dataclasses.replace(self, effects=effects)

    @property
    def columns(self) -> tuple[int, ...]:
        """The parameters of the effects."""
        return tuple(i for e in self.effects for i in self.library.indices[e])

    @property
    def estimate(self) -> Estimate:
        """The parameters of the effects, together."""
        return self.comparison.estimate(self.columns)

    def p(self, effect: str) -> float:
        """Probability of values so far from zero of one of the effects, by Hotelling's test."""
        own = self.library.indices[effect]
        return self.estimate.p([k for k, i in enumerate(self.columns) if i in own])

    @property
    def log_evidence(self) -> float:
        """Log evidence against no change [nats]."""
        return self.evidence.log_evidence(self.columns)

    @property
    def p_left(self) -> float:
        """Probability of what the effects leave, if nothing else changed."""
        return self.evidence.p(self.columns)

    @property
    def ratio(self) -> float:
        """Birge's ratio, squared: T^2 that the effects leave, over what chance does."""
        free = max(len(self.evidence.delta) - len(self.columns), 1)
        return max(1.0, self.evidence.left(self.columns) / free)

    def scaled(self, ratio: float) -> "Hypothesis":
        """The same with all T^2 divided by a ratio.

        What even the best effects leave beyond chance may as well hide what speaks for rivals.
        """
        return dataclasses.replace(self, evidence=dataclasses.replace(self.evidence, scale=ratio))

    def alike(self, effect: str, among: Sequence[str], decision: Decision) -> tuple[str, ...]:
        """Effects that flights cannot tell from one of these effects beside the others."""
        rest = tuple(e for e in self.effects if e != effect)
        log = {e: self.of(*rest, e).log_evidence for e in among if e not in self.effects}
        return tuple(
            e
            for e in sorted(log, key=lambda e: -log[e])
            if log[e] > self.log_evidence - decision.twin_alias_nats
            and self.looks_alike(effect, e, decision)
        )

    def share(self, effect: str, aliases: Sequence[str], decision: Decision) -> float:
        """Probability that one of these effects, or an alias of it, acts beside the others."""
        rest = tuple(e for e in self.effects if e != effect)
        without = self.of(*rest).log_evidence + decision.effect_cost
        odds = [self.of(*rest, e).log_evidence - without for e in (effect, *aliases)]
        return float(np.exp(np.logaddexp.reduce(odds) - np.logaddexp.reduce([0.0, *odds])))

    def looks_alike(self, effect: str, other: str, decision: Decision) -> bool:
        """Whether another effect does most of what one of these does beside the others."""
        rest = tuple(e for e in self.effects if e != effect)
        own, columns = self.of(effect, *rest), list(self.library.indices[effect])
        does = self.evidence.M[:, columns] @ own.estimate.value[: len(columns)]
        nothing, left = (
            self.evidence.beyond(does, self.of(*effects).columns)
            for effects in (rest, (*rest, other))
        )
        return left <= decision.most_left * nothing

    def settled(self, refly: Refly | None) -> "Hypothesis":
        """The same with scores that are taken where the effects fit the changed flights.

        Without `refly`, it stays where it is.
        """
        library, columns = self.library, list(self.columns)
        width = library.high - library.low
        ends = (lowest(library), library.high)
        low, high = ((end - library.neutral) / width for end in ends)
        at, misfit = self, float(np.mean(self.comparison.target.misfit))
        for _ in range(MOST_REFLIGHTS if refly else 0):
            assert refly is not None
            change = np.zeros(len(width))
            estimate = at.estimate
            likeliest = estimate.shrunk(at.evidence.width(columns))
            change[columns] = np.clip(likeliest, low[columns], high[columns])
            if np.all(np.abs(change - at.change)[columns] < STILL * estimate.error):
                break
            target = refly(change, columns)
            if np.mean(target.misfit) > misfit:  # half as far, once
                change = 0.5 * (change + at.change)
                target = refly(change, columns)
            if np.mean(target.misfit) > misfit:
                break
            misfit = float(np.mean(target.misfit))
            at = at._at(change, target)
        return at

    def _at(self, change: Float[np.ndarray, " params"], target: Group) -> "Hypothesis":
        """The same with the changed flights' scores as they are at a change."""
        reference, every = self.comparison.reference, self.comparison.columns
        return dataclasses.replace(
            self,
            comparison=compare(reference, target.continued(change), every),
            evidence=weigh_at(self.evidence, compare(reference, target, every), change),
            change=change,
        )


@dataclasses.dataclass(frozen=True)
class Named(Naming):
    """What was named, before the drift is scored with it."""

    at: Hypothesis
    """The named effects, linearised where they fit; without any, no change."""
    nothing: Hypothesis
    """No change."""
    instead: tuple["Named", ...] = ()
    """The same with each alias in the place of the first effect, the most probable first."""

    def unexplained(self) -> "Named":
        """The same without a name: the effects do not help flights that they were not fitted to."""
        return dataclasses.replace(
            self,
            change="unexplained",
            effects=(),
            aliases={},
            probabilities={},
            parameters=(),
            at=self.nothing,
            instead=(),
        )
