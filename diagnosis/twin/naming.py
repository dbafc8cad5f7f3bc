"""Which effects changed: every candidate alone, the best class of aliases, then further ones."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from diagnosis.decision import Decision
from diagnosis.replay.library import Library
from diagnosis.result import VerdictKind
from diagnosis.twin.answer import Candidate, ChangedParameter, Naming
from diagnosis.twin.evidence import weigh
from diagnosis.twin.hypothesis import Hypothesis, Refly, settle
from diagnosis.twin.twin import FEWEST_REFERENCES
from diagnosis.twin.units import Estimate, Group, compare


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
            aliases=(),
            probability=0.0,
            parameters=(),
            at=self.nothing,
            instead=(),
        )


def name_change(
    library: Library,
    reference: Group,
    target: Group,
    decision: Decision = Decision(),
    refly: Refly | None = None,
) -> Named:
    """What changed between two groups of scores in units of the library's ranges.

    With `refly`, candidates that may be named are taken to where they fit.
    """
    effects = [e for e in library.candidates if _free(library, e)]
    every = [i for e in effects for i in library.indices[e]]
    comparison = compare(reference, target, every)
    nothing = Hypothesis((), (), comparison, weigh(comparison, every), np.zeros(len(library.slots)))
    alone = {e: nothing.of(library, (e,)) for e in effects}
    seen = [e for e in effects if _shows(alone[e].estimate, decision)]
    # Effects that look alike fail and pass together: there are as many tests as directions.
    p_none, n = nothing.p_left, max(min(len(seen), len(nothing.evidence.delta)), 1)
    alone = _scaled(_settled(library, alone, seen, every, refly, decision), seen)
    candidates = _candidates(library, [alone[e] for e in seen], n, decision)
    sure = _sure(candidates, p_none, n, decision)
    share, alike = _class_of(sure, candidates, decision)
    rest = {
        "candidates": candidates,
        "unseen": tuple(sorted(set(library.candidates) - set(seen))),
        "nothing": nothing,
    }
    if (
        len(reference) < FEWEST_REFERENCES
    ):  # nobody knows how flights of an unchanged vehicle differ
        return Named("too_few", (), (), 0.0, (), at=nothing, **rest)
    if not sure or share < decision.least_chance:
        other = p_none < decision.alarm_chance or _elsewhere(reference, target, decision)
        change: VerdictKind = "unexplained" if sure or other else "none"
        if change == "none" and min(len(reference), len(target)) < decision.few_flights:
            change = "too_few"
        return Named(change, (), (), share, (), at=nothing, **rest)
    first, *aliases = alike
    at = alone[first]
    named = _further(library, at, sure, aliases, n, decision)
    while named != at.effects:
        tried = settle(at.of(library, named), library, every, refly)
        named = _clear(library, tried, n, decision)
        at = tried if named == tried.effects else alone[first].of(library, named)

    def with_first(at: Hypothesis, aliases: tuple[str, ...], instead: tuple[Named, ...]) -> Named:
        return Named(
            change="partly" if at.p_left < decision.alarm_chance else "effect",
            effects=at.effects,
            aliases=aliases,
            probability=share,
            parameters=changed(library, at.effects, at.estimate, n, decision),
            at=at,
            instead=instead,
            **rest,
        )

    instead = tuple(
        with_first(alone[e], tuple(x for x in alike if x != e), ())
        for e in aliases
        if any(p.clear for p in changed(library, (e,), alone[e].estimate, n, decision))
    )
    return with_first(at, tuple(aliases), instead)


def _elsewhere(reference: Group, target: Group, decision: Decision) -> bool:
    """Whether the twin misses the target as it would miss no flight like the reference.

    A log that is turned over is far from all that candidates can do, and no direction of theirs.
    Of fewer flights than `few_flights` nobody knows what is usual.
    """
    usual = float(np.median(reference.misfit))
    enough = min(len(reference), len(target)) >= decision.few_flights
    return enough and float(np.median(target.misfit)) > decision.flight_alone * usual


def _free(library: Library, effect: str) -> bool:
    """Whether slopes at neutral say what an effect does."""
    return effect not in library.onsets and not library.card(effect).start


def _shows(estimate: Estimate, decision: Decision) -> bool:
    """Whether a change within the range of some parameter would be named if it were the only."""
    return bool(np.any(estimate.error * _limit(estimate.dof, 1, decision) < 1.0))


def _limit(dof: float, n_candidates: int, decision: Decision) -> float:
    """Standard errors of the smallest change that is named with the probability `limit_power`."""
    named = student.isf(decision.alarm_chance / n_candidates / 2.0, dof)
    return float(named + student.ppf(decision.limit_power, dof))


def _settled(
    library: Library,
    alone: Mapping[str, Hypothesis],
    seen: Sequence[str],
    every: Sequence[int],
    refly: Refly | None,
    decision: Decision,
) -> dict[str, Hypothesis]:
    """Single effects, the best of them linearised where they fit."""
    log = {e: alone[e].log_evidence for e in seen}
    near = [e for e in seen if log[e] > max(log.values()) - decision.near_nats]
    near.sort(key=lambda e: -log[e])
    shown = [e for e in near if alone[e].estimate.p() < decision.alarm_chance]
    again = {e: settle(alone[e], library, every, refly) for e in shown[: decision.refits]}
    return {**alone, **again}


def _scaled(alone: Mapping[str, Hypothesis], seen: Sequence[str]) -> dict[str, Hypothesis]:
    """Single effects, with the evidence scaled by what the best of them leaves."""
    if not seen:
        return dict(alone)
    best = max((alone[e] for e in seen), key=lambda one: one.log_evidence)
    left, n = best.evidence.left(best.columns), len(best.columns)
    return {
        e: dataclasses.replace(one, evidence=one.evidence.scaled(left, n))
        for e, one in alone.items()
    }


def _clear(library: Library, at: Hypothesis, n: int, decision: Decision) -> tuple[str, ...]:
    """The first effect, with those others of which some parameter is not zero by its interval."""
    sizes = changed(library, at.effects, at.estimate, n, decision)
    clear = {x.effect for x in sizes if x.clear}
    return tuple(e for e in at.effects if e == at.effects[0] or e in clear)


def changed(
    library: Library,
    effects: Sequence[str],
    estimate: Estimate,
    n_candidates: int,
    decision: Decision = Decision(),
) -> tuple[ChangedParameter, ...]:
    """The parameters of `effects` in their units, with intervals and limits."""
    width: Float[np.ndarray, " params"] = library.high - library.low
    columns = [i for e in effects for i in library.indices[e]]
    half = float(student.ppf(0.975, estimate.dof))
    limit = _limit(estimate.dof, n_candidates, decision)
    made = []
    for i, value, error in zip(columns, estimate.value, estimate.error, strict=True):
        slot, w = library.slots[i], float(width[i])
        x = slot.neutral + float(value) * w
        made.append(
            ChangedParameter(
                effect=slot.effect,
                parameter=slot.parameter,
                unit=slot.unit,
                value=float(value) * w,
                low=float(value - half * error) * w,
                high=float(value + half * error) * w,
                limit=limit * float(error) * w,
                beyond="low" if x < slot.low else "high" if x > slot.high else "no",
            )
        )
    return tuple(made)


def _candidates(
    library: Library, alone: Sequence[Hypothesis], n: int, decision: Decision
) -> tuple[Candidate, ...]:
    odds = np.asarray([0.0, *(one.log_evidence - decision.effect_cost for one in alone)])
    shares = np.exp(odds - odds.max()) / np.exp(odds - odds.max()).sum()
    made = [
        Candidate(
            effect=one.effects[0],
            p=one.estimate.p(),
            log_evidence=one.log_evidence,
            share=float(share),
            parameters=changed(library, one.effects, one.estimate, n, decision),
        )
        for one, share in zip(alone, shares[1:], strict=True)
    ]
    return tuple(sorted(made, key=lambda c: -c.log_evidence))


def _sure(
    candidates: Sequence[Candidate], p_none: float, n: int, decision: Decision
) -> tuple[Candidate, ...]:
    """Candidates that undisturbed flights show too rarely, and whose size is not zero.

    Each may raise its part of the false alarms. Where all directions together say that something
    changed, each may raise all of them: with few flights, effects that look alike fail one by one.
    So may a likelier effect than one that is sure.
    """
    chance = decision.alarm_chance
    clear = [c for c in candidates if c.p < chance and any(p.clear for p in c.parameters)]
    sure = [c for c in clear if c.p < (chance if p_none < chance else chance / n)]
    most = max((c.log_evidence for c in sure), default=np.inf)
    return tuple(c for c in clear if c in sure or c.log_evidence > most)


def _class_of(
    sure: Sequence[Candidate], candidates: Sequence[Candidate], decision: Decision
) -> tuple[float, tuple[str, ...]]:
    """The share of the best sure candidate with its aliases, and their names, to be named first.

    Of effects that flights cannot tell apart, one whose size is possible goes before one whose size
    lies beyond its range: a battery that fades by 300 % a minute stands for a weak rotor.
    """
    if not sure:
        return 0.0, ()
    best = sure[0]
    near = [
        c
        for c in candidates
        if c is not best and best.log_evidence - c.log_evidence < decision.twin_alias_nats
    ]
    possible = [c for c in (best, *near) if c in sure and c.possible]
    first = possible[0] if possible else best
    alike = (first, *(c for c in (best, *near) if c is not first))
    return best.share + sum(c.share for c in near), tuple(c.effect for c in alike)


def _further(
    library: Library,
    at: Hypothesis,
    sure: Sequence[Candidate],
    aliases: Sequence[str],
    n_candidates: int,
    decision: Decision,
) -> tuple[str, ...]:
    """The named effects with those that the flights show beside them, one after another."""
    named = at.effects
    while len(named) < decision.largest_set:
        so_far = at.of(library, named)
        gains = []
        for other in (c.effect for c in sure if c.effect not in (*named, *aliases)):
            more = at.of(library, (*named, other))
            gain = more.log_evidence - so_far.log_evidence - decision.effect_cost
            estimate = more.estimate
            p = estimate.p(range(len(so_far.columns), len(more.columns)))
            sizes = changed(library, more.effects, estimate, n_candidates, decision)
            clear = any(x.clear for x in sizes if x.effect == other)
            if clear and gain > 0.0 and p < decision.alarm_chance / n_candidates:
                gains.append((gain, other))
        if not gains:
            break
        named = (*named, max(gains)[1])
    return named
