"""One set of effects as the cause of a change, linearised where it fits the changed flights.

A twin is linear in small changes only: half of a thrust is not lost as a tenth of it is, five
times. So the changed flights are flown again at the estimate, by Gauss and Newton, until it moves
by less than a tenth of its standard error or follows them no better.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decision import Decision
from diagnosis.replay.library import Library
from diagnosis.twin.evidence import Evidence, weigh_at
from diagnosis.twin.units import Comparison, Estimate, Group, compare

MOST_REFLIGHTS = 3
"""Most flights again."""
STILL = 0.1
"""Standard errors by which an estimate that has settled moves."""

Refly = Callable[[Float[np.ndarray, " params"]], Group]
"""The changed flights' scores at a change of all parameters, in units of their ranges."""


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """Effects that may have changed."""

    effects: tuple[str, ...]
    """Their names; none for no change."""
    columns: tuple[int, ...]
    """Their parameters."""
    comparison: Comparison
    """Both groups, the changed flights' scores continued to no change from where they are taken."""
    evidence: Evidence
    """What is left there."""
    change: Float[np.ndarray, " params"]
    """Where the scores are taken, in units of the ranges."""

    @property
    def estimate(self) -> Estimate:
        """The parameters of the effects, together."""
        return self.comparison.estimate(self.columns)

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

    def alike(
        self, library: Library, effect: str, among: Sequence[str], decision: Decision
    ) -> tuple[str, ...]:
        """Effects that flights cannot tell from one of these effects beside the others."""
        rest = tuple(e for e in self.effects if e != effect)
        log = {e: self.of(library, (*rest, e)).log_evidence for e in among if e not in self.effects}
        return tuple(
            e
            for e in sorted(log, key=lambda e: -log[e])
            if log[e] > self.log_evidence - decision.twin_alias_nats
            and self.looks_alike(library, effect, e, decision)
        )

    def looks_alike(self, library: Library, effect: str, other: str, decision: Decision) -> bool:
        """Whether another effect does most of what one of these does beside the others."""
        rest = tuple(e for e in self.effects if e != effect)
        own, columns = self.of(library, (effect, *rest)), list(library.indices[effect])
        does = self.evidence.M[:, columns] @ own.estimate.value[: len(columns)]
        nothing, left = (
            self.evidence.beyond(does, self.of(library, effects).columns)
            for effects in (rest, (*rest, other))
        )
        return left <= decision.most_left * nothing

    def of(self, library: Library, effects: Sequence[str]) -> "Hypothesis":
        """Other effects, with the same scores."""
        columns = tuple(i for e in effects for i in library.indices[e])
        return dataclasses.replace(self, effects=tuple(effects), columns=columns)


def settle(
    start: Hypothesis, library: Library, every: Sequence[int], refly: Refly | None
) -> Hypothesis:
    """`start` with scores that are taken where its effects fit the changed flights.

    Without `refly`, it stays where it is.
    """
    width, columns = library.high - library.low, list(start.columns)
    low, high = ((end - library.neutral) / width for end in (library.low, library.high))
    at, misfit = start, float(np.mean(start.comparison.target.misfit))
    for _ in range(MOST_REFLIGHTS if refly else 0):
        assert refly is not None
        estimate = at.estimate
        change = np.zeros(len(width))
        change[columns] = np.clip(estimate.value, low[columns], high[columns])
        if np.all(np.abs(change - at.change)[columns] < STILL * estimate.error):
            break
        target = refly(change)
        if np.mean(target.misfit) > misfit:  # half as far, once
            change = 0.5 * (change + at.change)
            target = refly(change)
        if np.mean(target.misfit) > misfit:
            break
        misfit = float(np.mean(target.misfit))
        continued = dataclasses.replace(target, h=target.h + target.H @ change)
        reference = start.comparison.reference
        at = dataclasses.replace(
            at,
            comparison=compare(reference, continued, every),
            evidence=weigh_at(start.evidence, compare(reference, target, every)),
            change=change,
        )
    return at


def settle_best(
    library: Library,
    tried: Mapping[str, Hypothesis],
    every: Sequence[int],
    refly: Refly | None,
    decision: Decision,
) -> dict[str, Hypothesis]:
    """What was tried, by effect, the best of it settled."""
    log = {e: one.log_evidence for e, one in tried.items()}
    near = [e for e in tried if log[e] > max(log.values()) - decision.near_nats]
    near.sort(key=lambda e: -log[e])
    shown = [e for e in near if tried[e].estimate.p() < decision.alarm_chance]
    again = {e: settle(tried[e], library, every, refly) for e in shown[: decision.refits]}
    return {**tried, **again}
