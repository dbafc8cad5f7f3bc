"""Which effects changed: each alone, then beside the others that the flights show, with aliases."""

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
from diagnosis.twin.hypothesis import Hypothesis, Refly, settle, settle_best
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
    alone = {e: one for e, one in alone.items() if _shows(one.estimate, decision)}
    # Effects that look alike fail and pass together: there are as many tests as directions.
    p_none, n = nothing.p_left, max(min(len(alone), len(nothing.evidence.delta)), 1)
    alone = settle_best(library, alone, every, refly, decision)
    several = _several(library, nothing, alone, p_none, n, decision)
    tried = _beside(library, nothing, alone, several, every, refly, decision)
    scale = max(tried.values(), key=lambda one: one.log_evidence).ratio if tried else 1.0
    nothing, alone, tried = (
        nothing.scaled(scale),
        *({e: one.scaled(scale) for e, one in each.items()} for each in (alone, tried)),
    )
    candidates = _candidates(library, nothing, tried, several[1:], n, decision)
    sure = _sure(candidates, p_none, n, decision)
    rivals = [c for c in candidates if c.effect not in several[1:]]
    leading = [c for c in sure if c in rivals]
    share, alike = _class_of(leading, rivals, library, tried, decision)
    rest = {
        "candidates": candidates,
        "beside": several[1:],
        "unseen": tuple(sorted(set(library.candidates) - set(alone))),
        "nothing": nothing,
    }
    if (
        len(reference) < FEWEST_REFERENCES
    ):  # nobody knows how flights of an unchanged vehicle differ
        return Named("too_few", (), {}, 0.0, (), at=nothing, **rest)
    if not leading or share < decision.least_chance:
        other = p_none < decision.alarm_chance or _elsewhere(reference, target, decision)
        change: VerdictKind = "unexplained" if sure or other else "none"
        if change == "none" and min(len(reference), len(target)) < decision.few_flights:
            change = "too_few"
        return Named(change, (), {}, share, (), at=nothing, **rest)
    first, *others = alike
    together = alone[several[0]].of(library, several)
    known = {e: together.alike(library, e, [*alone], decision) for e in several[1:]}
    known = {first: tuple(others), **known}
    at, known = _together(
        library, nothing, tried[first], known, [*alone], n, every, refly, decision
    )

    def as_named(at: Hypothesis, alike: Sequence[str], instead: tuple[Named, ...]) -> Named:
        first, *further = at.effects
        return Named(
            change="partly" if at.p_left < decision.alarm_chance else "effect",
            effects=at.effects,
            aliases={first: tuple(alike), **{e: known[e] for e in further}},
            probability=share,
            parameters=changed(library, at.effects, at.estimate, n, decision),
            at=at,
            instead=instead,
            **rest,
        )

    instead = tuple(
        as_named(tried[e], tuple(x for x in alike if x != e), ())
        for e in others
        if e in _clear(library, tried[e], n, decision)
    )
    return as_named(at, others, instead)


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


def _several(
    library: Library,
    nothing: Hypothesis,
    alone: Mapping[str, Hypothesis],
    p_none: float,
    n_candidates: int,
    decision: Decision,
) -> tuple[str, ...]:
    """The best single effect and, if it is sure, those that the flights show beside it.

    If these do what it seemed to do, so that its interval then holds zero, it is left out.
    """
    candidates = _candidates(library, nothing, alone, (), n_candidates, decision)
    sure = _sure(candidates, p_none, n_candidates, decision)
    if not sure:
        return tuple(c.effect for c in candidates[:1])
    best = alone[sure[0].effect]
    named = tuple(_further(library, best, {sure[0].effect: ()}, [*alone], n_candidates, decision))
    return _clear(library, best.of(library, named), n_candidates, decision) or named


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
    return settle_best(library, tried, every, refly, decision)


def _together(
    library: Library,
    nothing: Hypothesis,
    at: Hypothesis,
    known: Mapping[str, tuple[str, ...]],
    seen: Sequence[str],
    n_candidates: int,
    every: Sequence[int],
    refly: Refly | None,
    decision: Decision,
) -> tuple[Hypothesis, Mapping[str, tuple[str, ...]]]:
    """Effects that were tried together, with others that the flights show, and all their aliases.

    Others are not added if the first of them is then not clear.
    """
    for more in (seen, ()):
        aliases = _further(library, at, known, more, n_candidates, decision)
        named, found = tuple(aliases), at
        while True:
            if named != found.effects:
                start = found if set(named) > set(found.effects) else nothing
                found = settle(start.of(library, named), library, every, refly)
            named = _clear(library, found, n_candidates, decision)
            if not named or named == found.effects:
                break
        if at.effects[0] in named:
            return found, aliases
    return at, known


def _clear(library: Library, at: Hypothesis, n: int, decision: Decision) -> tuple[str, ...]:
    """Effects of which some parameter is not zero by its interval."""
    sizes = changed(library, at.effects, at.estimate, n, decision)
    clear = {x.effect for x in sizes if x.clear}
    return tuple(e for e in at.effects if e in clear)


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
    beside: Sequence[str],
    n: int,
    decision: Decision,
) -> tuple[Candidate, ...]:
    """What speaks for each effect with the others that it was tried with.

    Shares are those among no effect and all that are not `beside`, which all others are tried with.
    """
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
    odds = {c.effect: c.log_evidence - decision.effect_cost for c in made}
    rivals = [0.0, *(x for e, x in odds.items() if e not in beside)]

    def share(effect: str) -> float:
        others = [0.0, odds[effect]] if effect in beside else rivals
        return float(np.exp(odds[effect] - np.logaddexp.reduce(others)))

    shown = (dataclasses.replace(c, share=share(c.effect)) for c in made)
    return tuple(sorted(shown, key=lambda c: (c.effect in beside, -c.log_evidence)))


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
        and tried[best.effect].looks_alike(library, best.effect, c.effect, decision)
    ]
    possible = [c for c in (best, *near) if c in leading and c.possible]
    first = possible[0] if possible else best
    alike = (first, *(c for c in (best, *near) if c is not first))
    return best.share + sum(c.share for c in near), tuple(c.effect for c in alike)


def _further(
    library: Library,
    at: Hypothesis,
    known: Mapping[str, tuple[str, ...]],
    seen: Sequence[str],
    n_candidates: int,
    decision: Decision,
) -> dict[str, tuple[str, ...]]:
    """The effects of `at` with others that the flights show beside them, one after another.

    Each has its aliases, those of `at` the `known` ones; none is named beside its alias.
    """
    aliases = dict(known)
    while len(aliases) < decision.largest_set:
        so_far = at.of(library, tuple(aliases))
        passed = {*aliases, *(alias for alike in aliases.values() for alias in alike)}
        sure = {}
        for other in (e for e in seen if e not in passed):
            more = at.of(library, (*aliases, other))
            gain = more.log_evidence - so_far.log_evidence - decision.effect_cost
            estimate = more.estimate
            p = estimate.p(range(len(so_far.columns), len(more.columns)))
            clear = other in _clear(library, more, n_candidates, decision)
            if clear and gain > 0.0 and p < decision.alarm_chance / n_candidates:
                sure[other] = gain
        if not sure:
            break
        best = max(sure, key=lambda e: sure[e])
        more = at.of(library, (*aliases, best))
        aliases[best] = more.alike(library, best, [e for e in seen if e not in passed], decision)
    return aliases
