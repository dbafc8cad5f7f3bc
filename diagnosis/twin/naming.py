"""Which effects changed: each alone, then beside the others that the flights show, with aliases."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from diagnosis.decision import Decision
from diagnosis.replay.early import lowest
from diagnosis.replay.library import Library
from diagnosis.result import VerdictKind
from diagnosis.twin.answer import Candidate, ChangedParameter
from diagnosis.twin.evidence import weigh
from diagnosis.twin.hypothesis import Hypothesis, Named, Refly
from diagnosis.twin.twin import FEWEST_REFERENCES
from diagnosis.twin.units import Estimate, Group, compare

Aliases = Mapping[str, tuple[str, ...]]
"""Effects that flights cannot tell from each of some effects."""


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
    comparison = compare(reference, target, [i for e in effects for i in library.indices[e]])
    no_change = np.zeros(len(library.slots))
    nothing = Hypothesis(library, (), comparison, weigh(comparison), no_change)
    alone = {e: nothing.of(e) for e in effects}
    alone = {e: one for e, one in alone.items() if _shows(one.estimate, decision)}
    search = _Search(nothing, tuple(alone), refly, decision)
    alone = search.settle_best(alone)
    several = search.several(alone)
    tried = search.beside(alone, several)
    scale = max(tried.values(), key=lambda one: one.log_evidence).ratio if tried else 1.0
    search = dataclasses.replace(search, nothing=nothing.scaled(scale))
    alone, tried = ({e: x.scaled(scale) for e, x in each.items()} for each in (alone, tried))
    candidates = search.candidates(tried, several[1:])
    sure = search.sure(candidates)
    rivals = [c for c in candidates if c.effect not in several[1:]]
    leading = [c for c in sure if c in rivals]
    share, alike = search.class_of(leading, rivals, tried)
    rest = {
        "candidates": candidates,
        "beside": several[1:],
        "unseen": tuple(sorted(set(library.candidates) - set(alone))),
        "nothing": search.nothing,
    }

    def unnamed(change: VerdictKind) -> Named:
        return Named(change, (), {}, {}, (), at=search.nothing, **rest)

    if len(reference) < FEWEST_REFERENCES:  # nobody knows how flights of one vehicle differ
        return unnamed("too_few")
    if not leading or share < decision.least_chance:
        if sure or search.p_none < decision.alarm_chance or _elsewhere(reference, target, decision):
            return unnamed("unexplained")
        few = min(len(reference), len(target)) < decision.few_flights
        return unnamed("too_few" if few else "none")
    first, *others = alike
    together = alone[several[0]].of(*several)
    known = {e: together.alike(e, search.effects, decision) for e in several[1:]}
    at, found = search.together(tried[first], {first: tuple(others), **known})

    def as_named(
        at: Hypothesis, alike: Sequence[str], known: Aliases, instead: tuple[Named, ...]
    ) -> Named:
        first, *further = at.effects
        return Named(
            change="partly" if at.p_left < decision.alarm_chance else "effect",
            effects=at.effects,
            aliases={first: tuple(alike), **{e: known[e] for e in further}},
            probabilities={first: share, **{e: at.share(e, known[e], decision) for e in further}},
            parameters=search.sizes(at),
            at=at,
            instead=instead,
            **rest,
        )

    instead = tuple(
        as_named(tried[e], tuple(x for x in alike if x != e), known, ())
        for e in others
        if e in search.clear(tried[e])
    )
    return as_named(at, others, found, instead)


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


def _limit(dof: float, n_tests: int, decision: Decision) -> float:
    """Standard errors of the smallest change that is named with the probability `limit_power`."""
    named = student.isf(decision.alarm_chance / n_tests / 2.0, dof)
    return float(named + student.ppf(decision.limit_power, dof))


@dataclasses.dataclass(frozen=True)
class _Search:
    """A search for the effects that changed."""

    nothing: Hypothesis
    """No change."""
    effects: tuple[str, ...]
    """Those of which the flights would show a change."""
    refly: Refly | None
    """The changed flights elsewhere."""
    decision: Decision
    """What decides."""

    @property
    def p_none(self) -> float:
        """Probability of all that the flights show, if nothing changed."""
        return self.nothing.p_left

    @property
    def n_tests(self) -> int:
        """Tests: as many as directions, since effects that look alike fail and pass together."""
        return max(min(len(self.effects), len(self.nothing.evidence.delta)), 1)

    def sizes(self, at: Hypothesis) -> tuple[ChangedParameter, ...]:
        """The parameters of the effects in their units, with intervals and limits."""
        library, estimate = at.library, at.estimate
        width: Float[np.ndarray, " params"] = library.high - library.low
        half = float(student.ppf(0.975, estimate.dof))
        limit, first = _limit(estimate.dof, self.n_tests, self.decision), lowest(library)
        made = []
        for i, value, error in zip(at.columns, estimate.value, estimate.error, strict=True):
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
                    possible=bool(first[i] <= x <= slot.high),
                )
            )
        return tuple(made)

    def clear(self, at: Hypothesis) -> tuple[str, ...]:
        """Effects of which some parameter is not zero by its interval."""
        clear = {x.effect for x in self.sizes(at) if x.clear}
        return tuple(e for e in at.effects if e in clear)

    def settle_best(self, tried: Mapping[str, Hypothesis]) -> dict[str, Hypothesis]:
        """What was tried, by effect, the best of it settled."""
        log = {e: one.log_evidence for e, one in tried.items()}
        near = [e for e in tried if log[e] > max(log.values()) - self.decision.near_nats]
        near.sort(key=lambda e: -log[e])
        shown = [e for e in near if tried[e].estimate.p() < self.decision.alarm_chance]
        again = {e: tried[e].settled(self.refly) for e in shown[: self.decision.refits]}
        return {**tried, **again}

    def several(self, alone: Mapping[str, Hypothesis]) -> tuple[str, ...]:
        """The best single effect and, if it is sure, those that the flights show beside it.

        An effect that could do most of what the best one does is not tried beside it: each would
        take a part of the other's size, and then nothing would speak for either. The best effect is
        left out if its interval holds zero beside the others.
        """
        candidates = self.candidates(alone, ())
        sure = self.sure(candidates)
        if not sure:
            return tuple(c.effect for c in candidates[:1])
        first, best = sure[0].effect, alone[sure[0].effect]
        others = [e for e in self.effects if e != first]
        beside = [e for e in others if not best.looks_alike(first, e, self.decision)]
        named = tuple(self.further(best, {first: ()}, beside))
        return self.clear(best.of(*named)) or named

    def beside(
        self, alone: Mapping[str, Hypothesis], several: Sequence[str]
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
            tried[effect] = self.nothing.of(effect, *(e for e in others if e != effect))
        return self.settle_best(tried)

    def together(self, at: Hypothesis, known: Aliases) -> tuple[Hypothesis, Aliases]:
        """Effects that were tried together, with others that the flights show, and all aliases.

        Others are not added if the first of them is then not clear.
        """
        for more in (self.effects, ()):
            aliases = self.further(at, known, more)
            named, found, gone = tuple(aliases), at, set[str]()
            while True:
                if named != found.effects:
                    start = found if set(named) > set(found.effects) else self.nothing
                    found = start.of(*named).settled(self.refly)
                named = self.holding(found, aliases)
                if not named or named == found.effects:
                    break
                if at.effects[0] in named:
                    lost = next(e for e in found.effects if e not in named)
                    gone.add(lost)
                    found, aliases = self.replaced(found, lost, aliases, gone)
                    named = tuple(e for e in found.effects if e != lost)
            if at.effects[0] in named:
                return found, aliases
        held = tuple(e for e in at.effects if e in (at.effects[0], *self.holding(at, known)))
        return at if held == at.effects else self.nothing.of(*held).settled(self.refly), known

    def holding(self, at: Hypothesis, aliases: Aliases) -> tuple[str, ...]:
        """The first effect, if it is clear, and others that pass what `further` asks of them.

        Their sizes must be possible, too: what others leave is always like something.
        """
        impossible = {x.effect for x in self.sizes(at) if not x.possible}

        def held(effect: str) -> bool:
            likely = at.share(effect, aliases[effect], self.decision) >= self.decision.least_chance
            return likely and effect not in impossible and self.rare(at.p(effect))

        clear = self.clear(at)
        return tuple(e for e in clear if e == at.effects[0] or held(e))

    def rare(self, p: float) -> bool:
        """Whether undisturbed flights show so much too rarely; the candidates share the chance."""
        return p < self.decision.alarm_chance / self.n_tests

    def replaced(
        self, at: Hypothesis, lost: str, aliases: Aliases, gone: Collection[str]
    ) -> tuple[Hypothesis, Aliases]:
        """An effect that does not hold, with the likeliest of its aliases that does in its place.

        Of several that look alike, the one that fits best to first order may be nothing once the
        flights are simulated with it, where another is not. At most `refits` are tried, and none of
        those that are `gone`.
        """
        rest = tuple(e for e in at.effects if e != lost)
        alike = (lost, *aliases[lost])
        for alias in aliases[lost][: self.decision.refits]:
            if alias in (*rest, *gone):
                continue
            found = self.nothing.of(*rest, alias).settled(self.refly)
            others = {e: each for e, each in aliases.items() if e != lost}
            instead = {**others, alias: tuple(e for e in alike if e != alias)}
            if alias in self.holding(found, instead):
                return found, instead
        return at, aliases

    def further(
        self, at: Hypothesis, known: Aliases, among: Sequence[str]
    ) -> dict[str, tuple[str, ...]]:
        """The effects of `at` with others that the flights show beside them, one after another.

        Every effect is given with its aliases; `known` has the aliases of the effects of `at`. An
        effect is never added beside one of its aliases.
        """
        aliases, decision = dict(known), self.decision
        while len(aliases) < decision.largest_set:
            so_far = at.of(*aliases)
            passed = {*aliases, *(alias for alike in aliases.values() for alias in alike)}
            left = [e for e in among if e not in passed]
            gains = {}
            for other in left:
                more = at.of(*aliases, other)
                gain = more.log_evidence - so_far.log_evidence - decision.effect_cost
                if self.rare(more.p(other)) and gain > 0.0 and other in self.clear(more):
                    gains[other] = gain
            if not gains:
                break
            best = max(gains, key=lambda e: gains[e])
            aliases[best] = at.of(*aliases, best).alike(best, left, decision)
        return aliases

    def candidates(
        self, tried: Mapping[str, Hypothesis], beside: Sequence[str]
    ) -> tuple[Candidate, ...]:
        """What speaks for each effect with the others that it was tried with.

        Shares are those among no effect and all that are not `beside`, which all others are tried
        with.
        """
        made = []
        for effect, joint in tried.items():
            rest = self.nothing.of(*joint.effects[1:])
            made.append(
                Candidate(
                    effect=effect,
                    p=joint.p(effect),
                    log_evidence=joint.log_evidence - rest.log_evidence,
                    share=0.0,
                    parameters=tuple(x for x in self.sizes(joint) if x.effect == effect),
                )
            )
        odds = {c.effect: c.log_evidence - self.decision.effect_cost for c in made}
        rivals = [0.0, *(x for e, x in odds.items() if e not in beside)]

        def share(effect: str) -> float:
            others = [0.0, odds[effect]] if effect in beside else rivals
            return float(np.exp(odds[effect] - np.logaddexp.reduce(others)))

        shown = (dataclasses.replace(c, share=share(c.effect)) for c in made)
        return tuple(sorted(shown, key=lambda c: (c.effect in beside, -c.log_evidence)))

    def sure(self, candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Candidates that undisturbed flights show too rarely, and whose size is not zero.

        The candidates share the allowed chance of a false alarm. Where all directions together show
        a change, each candidate may use the whole chance, because with few flights each of several
        effects that look alike fails a stricter test. An effect that is likelier than a sure one
        may use the whole chance, too.
        """
        chance = self.decision.alarm_chance
        each = chance if self.p_none < chance else chance / self.n_tests
        clear = [c for c in candidates if c.p < chance and any(p.clear for p in c.parameters)]
        sure = [c for c in clear if c.p < each]
        most = max((c.log_evidence for c in sure), default=np.inf)
        return tuple(c for c in clear if c in sure or c.log_evidence > most)

    def class_of(
        self,
        leading: Sequence[Candidate],
        candidates: Sequence[Candidate],
        tried: Mapping[str, Hypothesis],
    ) -> tuple[float, tuple[str, ...]]:
        """The share of the best sure candidate with its aliases, and their names, first the named.

        Of effects that flights cannot tell apart, one whose size is possible goes before one whose
        size lies beyond its range: a battery that fades by 300 % a minute stands for a weak rotor.
        """
        if not leading:
            return 0.0, ()
        best = leading[0]
        near = [
            c
            for c in candidates
            if c is not best
            and best.log_evidence - c.log_evidence < self.decision.twin_alias_nats
            and tried[best.effect].looks_alike(best.effect, c.effect, self.decision)
        ]
        possible = [c for c in (best, *near) if c in leading and c.possible]
        first = possible[0] if possible else best
        alike = (first, *(c for c in (best, *near) if c is not first))
        return best.share + sum(c.share for c in near), tuple(c.effect for c in alike)
