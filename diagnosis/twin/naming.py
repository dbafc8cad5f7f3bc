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
            aliases={},
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
    aliases: dict[str, tuple[str, ...]] = {}
    alone = _settled(library, {e: alone[e] for e in seen}, every, refly, decision)
    several = _several(library, nothing, alone, aliases, p_none, n, decision)
    tried = _beside(library, nothing, alone, several, every, refly, decision)
    scale = max((tried[e] for e in seen), key=lambda one: one.log_evidence).ratio if seen else 1.0
    nothing, tried = nothing.scaled(scale), {e: one.scaled(scale) for e, one in tried.items()}
    if len(several) > 1:  # what looks alike, by the scaled evidence
        scaled: dict[str, tuple[str, ...]] = {}
        _further(library, alone[several[0]].scaled(scale), seen, scaled, n, decision)
        aliases |= scaled
    candidates = _candidates(library, nothing, tried, n, decision)
    sure = _sure(candidates, p_none, n, decision)
    leading = [c for c in sure if c.effect not in several[1:]] or sure
    share, alike = _class_of(leading, candidates, library, tried, decision)
    rest = {
        "candidates": candidates,
        "unseen": tuple(sorted(set(library.candidates) - set(seen))),
        "nothing": nothing,
    }
    if (
        len(reference) < FEWEST_REFERENCES
    ):  # nobody knows how flights of an unchanged vehicle differ
        return Named("too_few", (), {}, 0.0, (), at=nothing, **rest)
    if not sure or share < decision.least_chance:
        other = p_none < decision.alarm_chance or _elsewhere(reference, target, decision)
        change: VerdictKind = "unexplained" if sure or other else "none"
        if change == "none" and min(len(reference), len(target)) < decision.few_flights:
            change = "too_few"
        return Named(change, (), {}, share, (), at=nothing, **rest)
    first, *others = alike
    at = _together(library, nothing, tried[first], seen, aliases, n, every, refly, decision)

    def with_first(at: Hypothesis, alike: Sequence[str], instead: tuple[Named, ...]) -> Named:
        first, *further = at.effects
        return Named(
            change="partly" if at.p_left < decision.alarm_chance else "effect",
            effects=at.effects,
            aliases={first: tuple(alike), **{e: aliases.get(e, ()) for e in further}},
            probability=share,
            parameters=changed(library, at.effects, at.estimate, n, decision),
            at=at,
            instead=instead,
            **rest,
        )

    instead = tuple(
        with_first(tried[e], tuple(x for x in alike if x != e), ())
        for e in others
        if e in _clear(library, tried[e], n, decision)
    )
    return with_first(at, [e for e in alike if e != at.effects[0]], instead)


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
    tried: Mapping[str, Hypothesis],
    every: Sequence[int],
    refly: Refly | None,
    decision: Decision,
) -> dict[str, Hypothesis]:
    """What was tried, the best of it linearised where it fits."""
    log = {e: one.log_evidence for e, one in tried.items()}
    near = [e for e in tried if log[e] > max(log.values()) - decision.near_nats]
    near.sort(key=lambda e: -log[e])
    shown = [e for e in near if tried[e].estimate.p() < decision.alarm_chance]
    again = {e: settle(tried[e], library, every, refly) for e in shown[: decision.refits]}
    return {**tried, **again}


def _several(
    library: Library,
    nothing: Hypothesis,
    alone: Mapping[str, Hypothesis],
    aliases: dict[str, tuple[str, ...]],
    p_none: float,
    n_candidates: int,
    decision: Decision,
) -> tuple[str, ...]:
    """The best single effect and, if it is sure, those that the flights show beside it."""
    candidates = _candidates(library, nothing, alone, n_candidates, decision)
    sure = _sure(candidates, p_none, n_candidates, decision)
    if not sure:
        return tuple(c.effect for c in candidates[:1])
    best = alone[sure[0].effect]
    return _further(library, best, [*alone], aliases, n_candidates, decision)


def _beside(
    library: Library,
    nothing: Hypothesis,
    alone: Mapping[str, Hypothesis],
    several: Sequence[str],
    every: Sequence[int],
    refly: Refly | None,
    decision: Decision,
) -> dict[str, Hypothesis]:
    """Each effect in the place of the first of `several`, or with the others of them.

    Two changes at once leave much where either is taken alone, and then little would speak for
    either.
    """
    if len(several) < 2:
        return dict(alone)
    tried = {}
    for effect in alone:
        others = several if effect in several else several[1:]
        tried[effect] = nothing.of(library, (effect, *(e for e in others if e != effect)))
    return _settled(library, tried, every, refly, decision)


def _together(
    library: Library,
    nothing: Hypothesis,
    at: Hypothesis,
    seen: Sequence[str],
    aliases: dict[str, tuple[str, ...]],
    n_candidates: int,
    every: Sequence[int],
    refly: Refly | None,
    decision: Decision,
) -> Hypothesis:
    """Effects that were tried together, with others that the flights show, where they all fit.

    Those whose intervals hold zero there are left out.
    """
    named = _further(library, at, seen, aliases, n_candidates, decision)
    while True:
        if named != at.effects:
            more = set(named) > set(at.effects)
            at = settle((at if more else nothing).of(library, named), library, every, refly)
        named = _clear(library, at, n_candidates, decision)
        if named == at.effects:
            return at


def _clear(library: Library, at: Hypothesis, n: int, decision: Decision) -> tuple[str, ...]:
    """Effects of which some parameter is not zero by its interval; if none is, the first."""
    sizes = changed(library, at.effects, at.estimate, n, decision)
    clear = {x.effect for x in sizes if x.clear}
    return tuple(e for e in at.effects if e in clear) or at.effects[:1]


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
    library: Library,
    nothing: Hypothesis,
    tried: Mapping[str, Hypothesis],
    n: int,
    decision: Decision,
) -> tuple[Candidate, ...]:
    """What speaks for each effect beside the others that it was tried with."""
    made = []
    for effect, joint in tried.items():
        rest = nothing.of(library, joint.effects[1:])
        sizes = changed(library, joint.effects, joint.estimate, n, decision)
        made.append(
            Candidate(
                effect=effect,
                p=joint.estimate.p(range(len(library.indices[effect]))),
                log_evidence=joint.log_evidence - rest.log_evidence,
                share=0.0,
                parameters=tuple(x for x in sizes if x.effect == effect),
            )
        )
    odds = np.asarray([0.0, *(one.log_evidence - decision.effect_cost for one in made)])
    shares = np.exp(odds - odds.max()) / np.exp(odds - odds.max()).sum()
    shown = (
        dataclasses.replace(one, share=float(x)) for one, x in zip(made, shares[1:], strict=True)
    )
    return tuple(sorted(shown, key=lambda c: -c.log_evidence))


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
    leading: Sequence[Candidate],
    candidates: Sequence[Candidate],
    library: Library,
    tried: Mapping[str, Hypothesis],
    decision: Decision,
) -> tuple[float, tuple[str, ...]]:
    """The share of the best sure candidate with its aliases, and their names, to be named first.

    Of effects that flights cannot tell apart, one whose size is possible goes before one whose size
    lies beyond its range: a battery that fades by 300 % a minute stands for a weak rotor.
    """
    if not leading:
        return 0.0, ()
    best = leading[0]
    near = [
        c
        for c in candidates
        if c is not best
        and best.log_evidence - c.log_evidence < decision.twin_alias_nats
        and _looks_alike(library, tried[best.effect], best.effect, c.effect, decision)
    ]
    possible = [c for c in (best, *near) if c in leading and c.possible]
    first = possible[0] if possible else best
    alike = (first, *(c for c in (best, *near) if c is not first))
    return best.share + sum(c.share for c in near), tuple(c.effect for c in alike)


def _further(
    library: Library,
    at: Hypothesis,
    seen: Sequence[str],
    aliases: dict[str, tuple[str, ...]],
    n_candidates: int,
    decision: Decision,
) -> tuple[str, ...]:
    """The named effects with those that the flights show beside them, one after another.

    What flights cannot tell from a further effect joins `aliases`; no alias is named beside the
    effect that it looks like.
    """
    named = at.effects
    while len(named) < decision.largest_set:
        so_far = at.of(library, named)
        passed = {*named, *(alias for alike in aliases.values() for alias in alike)}
        gains, sure = {}, []
        for other in (e for e in seen if e not in passed):
            more = at.of(library, (*named, other))
            gains[other] = more.log_evidence - so_far.log_evidence - decision.effect_cost
            estimate = more.estimate
            p = estimate.p(range(len(so_far.columns), len(more.columns)))
            sizes = changed(library, more.effects, estimate, n_candidates, decision)
            clear = any(x.clear for x in sizes if x.effect == other)
            if clear and gains[other] > 0.0 and p < decision.alarm_chance / n_candidates:
                sure.append(other)
        if not sure:
            break
        best = max(sure, key=lambda e: gains[e])
        more = at.of(library, (*named, best))
        aliases[best] = tuple(
            e
            for e in sorted(gains, key=lambda e: -gains[e])
            if e != best
            and gains[e] > gains[best] - decision.twin_alias_nats
            and _looks_alike(library, more, best, e, decision)
        )
        named = (*named, best)
    return named


def _looks_alike(
    library: Library, at: Hypothesis, effect: str, other: str, decision: Decision
) -> bool:
    """Whether another effect does most of what one effect of `at` does beside the others."""
    rest = tuple(e for e in at.effects if e != effect)
    if other in rest:
        return False
    without, instead = at.of(library, rest), at.of(library, (*rest, other))
    own = at.of(library, (effect, *rest))
    columns = list(library.indices[effect])
    does = at.evidence.M[:, columns] @ own.estimate.value[: len(columns)]
    nothing, left = (at.evidence.beyond(does, one.columns) for one in (without, instead))
    return left <= decision.most_left * nothing
