"""Which effects changed: every candidate alone, the best class of aliases, then further ones."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from diagnosis.decision import Decision
from diagnosis.replay.library import Library
from diagnosis.twin.answer import Candidate, Change, ChangedParameter
from diagnosis.twin.evidence import Evidence, weigh
from diagnosis.twin.units import Comparison, Estimate, Group, compare

ALPHA = 0.01
"""Probability of naming anything in undisturbed flights, shared out among all candidates; a
choice, half of the false alarms that are allowed."""
MOST_EFFECTS = 3
"""Most effects of an answer; a choice."""
POWER = 0.95
"""Probability with which a change of the size of the limit is named."""
LEAST_SHARE = 0.5
"""Probability below which a class of aliases is not named."""
FEW = 5
"""Flights of either set below which silence is no answer."""


@dataclasses.dataclass(frozen=True)
class Named:
    """What was named, before flights are flown again with it."""

    change: Change
    """The verdict."""
    effects: tuple[str, ...]
    """Named effects."""
    aliases: tuple[str, ...]
    """What cannot be told from the first."""
    probability: float
    """That the first or one of its aliases is true."""
    parameters: tuple[ChangedParameter, ...]
    """Their parameters."""
    candidates: tuple[Candidate, ...]
    """All candidates by probability."""
    unseen: tuple[str, ...]
    """Effects that are none."""
    p_none: float
    """Probability of the flights without change."""
    p_left: float
    """The same after the named effects."""


def name_change(
    library: Library, reference: Group, target: Group, decision: Decision = Decision()
) -> Named:
    """What changed between two groups of scores in units of the library's ranges."""
    effects = [e for e in library.candidates if _free(library, e)]
    every = [i for e in effects for i in library.indices(e)]
    comparison = compare(reference, target, every)
    evidence = weigh(comparison, every)
    shown = {e: comparison.estimate(library.indices(e)) for e in effects}
    seen = [e for e in effects if np.any(shown[e].error * _limit(shown[e].dof, 1) < 1.0)]
    unseen = tuple(sorted(set(library.candidates) - set(seen)))
    candidates = _candidates(library, seen, shown, evidence, decision)
    alpha = ALPHA / max(len(seen), 1)
    sure = [c for c in candidates if c.p < alpha]
    p_none = evidence.p([])
    rest = {"candidates": candidates, "unseen": unseen, "p_none": p_none}
    share, aliases = _class_of(sure, candidates, decision)
    if not sure or share < LEAST_SHARE:
        change = Change.UNEXPLAINED if sure or p_none < ALPHA else Change.NONE
        if change is Change.NONE and min(len(reference), len(target)) < FEW:
            change = Change.TOO_FEW
        return Named(change, (), (), share, (), p_left=p_none, **rest)
    named = _further(
        library, comparison, evidence, (sure[0].effect,), sure, alpha, aliases, decision
    )
    columns = [i for e in named for i in library.indices(e)]
    parameters = changed(library, named, comparison.estimate(columns), len(seen))
    p_left = evidence.p(columns)
    change = Change.PARTLY if p_left < ALPHA else Change.EFFECT
    return Named(change, named, aliases, share, parameters, p_left=p_left, **rest)


def _free(library: Library, effect: str) -> bool:
    """Whether slopes at neutral say what an effect does."""
    return effect not in library.onsets and not library.card(effect).start


def _limit(dof: float, n_candidates: int) -> float:
    """Standard errors of the smallest change that is named with probability `POWER`."""
    named = student.isf(ALPHA / n_candidates / 2.0, dof)
    return float(named + student.ppf(POWER, dof))


def changed(
    library: Library, effects: Sequence[str], estimate: Estimate, n_candidates: int
) -> tuple[ChangedParameter, ...]:
    """The parameters of `effects` in their units, with intervals and limits."""
    width: Float[np.ndarray, " params"] = library.high - library.low
    columns = [i for e in effects for i in library.indices(e)]
    half = float(student.ppf(0.975, estimate.dof))
    limit = _limit(estimate.dof, n_candidates)
    made = []
    for i, value, error in zip(columns, estimate.value, estimate.error, strict=True):
        slot, w = library.slots[i], float(width[i])
        made.append(
            ChangedParameter(
                effect=slot.effect,
                parameter=slot.parameter,
                unit=slot.unit,
                value=float(value) * w,
                low=float(value - half * error) * w,
                high=float(value + half * error) * w,
                limit=limit * float(error) * w,
                at_bound=bool(abs(value) > 1.0),
            )
        )
    return tuple(made)


def _candidates(
    library: Library,
    seen: Sequence[str],
    shown: dict[str, Estimate],
    evidence: Evidence,
    decision: Decision,
) -> tuple[Candidate, ...]:
    log = {e: evidence.log_evidence(library.indices(e)) for e in seen}
    odds = np.asarray([0.0, *(x - decision.effect_cost for x in log.values())])
    shares = np.exp(odds - odds.max()) / np.exp(odds - odds.max()).sum()
    made = [
        Candidate(
            effect=e,
            p=shown[e].p(),
            log_evidence=log[e],
            share=float(share),
            parameters=changed(library, (e,), shown[e], len(seen)),
        )
        for e, share in zip(seen, shares[1:], strict=True)
    ]
    return tuple(sorted(made, key=lambda c: -c.log_evidence))


def _class_of(
    sure: Sequence[Candidate], candidates: Sequence[Candidate], decision: Decision
) -> tuple[float, tuple[str, ...]]:
    """The share of the best sure candidate with its aliases, and these aliases."""
    if not sure:
        return 0.0, ()
    best = sure[0]
    near = [
        c
        for c in candidates
        if c is not best and best.log_evidence - c.log_evidence < decision.alias_nats
    ]
    return best.share + sum(c.share for c in near), tuple(c.effect for c in near)


def _further(
    library: Library,
    comparison: Comparison,
    evidence: Evidence,
    named: tuple[str, ...],
    sure: Sequence[Candidate],
    alpha: float,
    aliases: Sequence[str],
    decision: Decision,
) -> tuple[str, ...]:
    """`named` with the effects that its flights show beside it, one after another."""
    while len(named) < MOST_EFFECTS:
        columns = [i for e in named for i in library.indices(e)]
        so_far = evidence.log_evidence(columns)
        gains = []
        for other in (c.effect for c in sure if c.effect not in (*named, *aliases)):
            more = library.indices(other)
            gain = evidence.log_evidence([*columns, *more]) - so_far - decision.effect_cost
            together = comparison.estimate([*columns, *more])
            p = together.p(range(len(columns), len(columns) + len(more)))
            if gain > 0.0 and p < alpha:
                gains.append((gain, other))
        if not gains:
            break
        named = (*named, max(gains)[1])
    return named
