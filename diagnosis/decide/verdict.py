r"""From fitted candidate sets to an answer: effects, aliases, none beyond noise, or unexplained.

The posterior of a set is its evidence times a prior that every effect costs `effect_cost` nats;
beside a reference an effect must also explain a least part of the gap (`least_share`, and
`worthy_share` where the reference is not followed). Whether the best set explains the flights is
asked afterwards, of the data alone: every window may have its own force and tilt, and if windows
use that freedom more than noise would (`structure`), something is left that no candidate explains.

Thresholds stand in `Decision` with their evidence; `blame` says what of it all may be named.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from diagnosis.decision import Decision
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Fit, Set
from diagnosis.fit.search import Fits
from diagnosis.fit.windows import Normal
from diagnosis.replay.library import Library
from diagnosis.result_parts import AtBound
from diagnosis.statements import Judged


@dataclasses.dataclass(frozen=True)
class Floor:
    """Structure where nothing changed, which a simulator that follows its flights leaves at one."""

    value: float = 1.0
    """That of all reference flights."""
    scatter: float = 0.0
    """Standard deviation between reference flights, beyond noise."""

    def unlike(self, decision: Decision = Decision()) -> float:
        """How far undisturbed flights are from being followed: 0 if they are, 1 at the most.

        It is 1 from a structure of `slight_structure` on.
        What a change does to such a reality is known no better than the reality itself.
        """
        return float(np.clip((self.value - 1.0) / (decision.slight_structure - 1.0), 0.0, 1.0))


FOLLOWED = Floor()
"""That of a simulator without reference flights: it is taken to follow what has not changed."""


@dataclasses.dataclass(frozen=True)
class Structure:
    """Mean squared force and tilt that windows want for themselves, in units of their noise."""

    value: float
    """One for windows that differ by noise only."""
    count: int
    """Numbers in the mean: the fewer, the further noise alone takes it from one."""
    flights: int
    """Flights that they come from."""

    def exceeds(self, threshold: float, floor: Floor, decision: Decision = Decision()) -> bool:
        """Whether it is above `threshold` floors and not by chance, nor as flights differ."""
        differing = floor.value + decision.chance_sigmas * floor.scatter / math.sqrt(self.flights)
        return self.value > max(
            beyond_chance(threshold, self.count, decision) * floor.value, differing
        )


@dataclasses.dataclass(frozen=True)
class Ranked:
    """A candidate set with its probability."""

    effects: Set
    """Names."""
    probability: float
    """Posterior probability among all sets that were looked at."""
    fit: Fit
    """Where it ended."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What the flights say."""

    kind: Judged
    """What the likeliest set is judged to be by the structure that it leaves."""
    chosen: Ranked
    """The best set, also where it does not explain enough."""
    ranked: tuple[Ranked, ...]
    """All refitted sets, most probable first."""
    true_share: float
    """How often the effects of such an answer are true [-]."""
    doubted: bool
    """Whether that is rare, because more structure is left than noise makes."""
    probability: dict[str, float]
    """Of each chosen effect: of all sets that hold it, times how often such an answer is true."""
    aliases: dict[str, list[str]]
    """Of each chosen effect: what these flights cannot tell from it."""
    found: Structure
    """What the nominal simulator leaves."""
    structure: Structure
    """What is left by the best set."""
    unexplained_share: float
    """Part of the gap beyond noise that the best set leaves."""


def judge(fits: Fits, floor: Floor = FOLLOWED) -> Verdict:
    """The verdict on all fits; `floor` is of reference flights."""
    evidence, decision = fits.evidence, fits.evidence.decision
    among = fits.ranked()
    ranked = _posterior(fits, among, _cost(fits, among, floor))
    chosen = ranked[0]
    left = structure(evidence.library, chosen.fit.normal)
    found = structure(evidence.library, fits.nominal.normal)
    share = (left.value - floor.value) / max(found.value - floor.value, 1e-9)
    share = float(np.clip(share, 0.0, 1.0)) if found.value > floor.value else 0.0
    kind: Judged = "effect" if chosen.effects else "none"
    least, most = decision.unexplained_share, decision.unfollowed_share
    tolerated = least + floor.unlike(decision) * (most - least)
    if unexplained(share, lambda x: left.exceeds(x, floor, decision), tolerated, decision):
        kind = "unexplained"
    # Not beside the reference: how often names are true was counted where it is followed.
    doubted = left.exceeds(decision.slight_structure, FOLLOWED, decision)
    true = decision.doubted_share if doubted else decision.true_share
    return Verdict(
        kind=kind,
        chosen=chosen,
        ranked=tuple(ranked),
        true_share=true,
        doubted=doubted,
        probability={
            name: true * sum(r.probability for r in ranked if name in r.effects)
            for name in sorted(chosen.effects)
        },
        aliases={name: _aliases(evidence, ranked, name) for name in sorted(chosen.effects)},
        found=found,
        structure=left,
        unexplained_share=share,
    )


def unexplained(
    share: Any,
    exceeds: Callable[[float], Any],
    tolerated: float | None = None,
    decision: Decision = Decision(),
) -> Any:
    """Whether what is left, and its share of the gap, say that no candidate is right.

    Of one answer, or of an array of them: `exceeds` says which leave more structure than given.
    """
    tolerated = decision.unexplained_share if tolerated is None else tolerated
    clear = exceeds(decision.structure) & (share > tolerated)
    return clear | exceeds(decision.slight_structure) & (share > decision.much_share)


def _cost(fits: Fits, among: Sequence[Fit], floor: Floor) -> float:
    """What an effect costs [nats]."""
    gap = fits.nominal.objective - min(fit.objective for fit in among)
    decision = fits.evidence.decision
    least = 0.0 if fits.evidence.precision is None else decision.least_share
    share = max(least, floor.unlike(decision) * decision.worthy_share)
    return decision.effect_cost + share * 0.5 * max(gap, 0.0) / fits.evidence.phi


def _posterior(fits: Fits, among: Sequence[Fit], cost: float) -> list[Ranked]:
    """Sets by probability; single effects that were only screened count with what they promise."""
    evidence = fits.evidence
    log = np.asarray([evidence.log_evidence(fit) - cost * len(fit.effects) for fit in among])
    seen = {fit.effects for fit in among}
    screened = [
        evidence.promised(fits.nominal, Set({name})) - cost
        for name in evidence.library.candidates
        if Set({name}) not in seen
    ]
    every = np.concatenate([log, screened])
    weight = np.exp(every - every.max())
    probability = weight[: len(log)] / weight.sum()
    order = np.argsort(-probability, kind="stable")
    return [Ranked(among[i].effects, float(probability[i]), among[i]) for i in order]


def _aliases(evidence: Evidence, ranked: Sequence[Ranked], name: str) -> list[str]:
    """Effects whose exchange for `name` costs less than `alias_nats`, likeliest first."""
    rest, best = ranked[0].effects - {name}, evidence.log_evidence(ranked[0].fit)
    found = []
    for other in ranked:
        new = other.effects - rest
        exchanged = rest < other.effects and len(new) == 1 and name not in other.effects
        if exchanged and best - evidence.log_evidence(other.fit) < evidence.decision.alias_nats:
            found.extend(sorted(new))
    return found


def beyond_chance(threshold: float, count: float | int, decision: Decision = Decision()) -> float:
    """`threshold`, raised where the mean of `count` squares exceeds it by chance."""
    return max(threshold, 1.0 + decision.chance_sigmas * math.sqrt(2.0 / max(count, 1.0)))


def structure(library: Library, normal: Normal) -> Structure:
    """What windows want for themselves along the slopes of local effects."""
    columns = library.local
    normal = normal.of(normal.dof > 0)  # windows alone, without what `loosened` added
    H, g = normal.H[:, columns][:, :, columns], normal.g[:, columns]
    scale = np.sqrt(np.clip(np.einsum("wii->wi", H), 1e-12, None))
    values, vectors = np.linalg.eigh(H / (scale[:, :, None] * scale[:, None, :]))
    along = np.einsum("wij,wi->wj", vectors, g / scale)
    kept = values > 1e-3
    total = np.sum(np.where(kept, along**2 / np.where(kept, values, 1.0), 0.0))
    count, flights = int(kept.sum()), len(np.unique(normal.flight))
    return Structure(float(total / max(count, 1)), count, flights)


def floor_of(library: Library, normal: Normal) -> Floor:
    """The floor that reference flights set at their own fit."""
    every = structure(library, normal)
    each = [structure(library, one) for one in normal.by_flight()]
    values = np.asarray([one.value for one in each])
    noise = np.mean([2.0 * one.value**2 / max(one.count, 1) for one in each])
    beyond = np.var(values, ddof=1) - noise if len(each) > 2 else 0.0
    return Floor(max(1.0, every.value), float(np.sqrt(max(beyond, 0.0))))


def intervals(
    evidence: Evidence, fit: Fit
) -> tuple[list[int], Float[np.ndarray, " free"], Float[np.ndarray, " free"]]:
    """Free entries of a set's vector with the ends of their 95 % intervals.

    Standard errors come from the curvature, widened by the dispersion between flights, by
    `interval_widening`, and by the root of the structure that the fit leaves (Birge's ratio): what
    all flights have in common and no effect describes, moves parameters by as much, and flights do
    not differ in it. They have no end where flights say nothing of a parameter.

    Where what the reference shares stands at a bound, nobody knows whether a change counts from
    there or from where the flights would have it: an interval holds both (`past_bounds`).
    """
    phi = evidence.phi * max(1.0, structure(evidence.library, fit.normal).value)
    free, value, slope, following = _on_top(evidence, fit)
    error = np.abs(slope) * np.sqrt(evidence.variance(fit, free, following))
    width = 1.96 * evidence.decision.interval_widening * np.sqrt(phi) * error
    past = value + slope * evidence.past_bounds(fit, free, following)
    return free, np.minimum(value, past) - width, np.maximum(value, past) + width


def sizes(
    evidence: Evidence, fit: Fit
) -> tuple[Float[np.ndarray, " free"], Float[np.ndarray, " free"]]:
    """Free entries of a set's vector on top of what the reference has, with standard errors.

    What the reference has, and what the shared shift moved, is no change. Errors are over the root
    of `phi`, infinite where flights say nothing of a parameter; a factor of what is known badly may
    be known well.
    """
    free, value, slope, following = _on_top(evidence, fit)
    return value, np.abs(slope) * np.sqrt(evidence.variance(fit, free, following))


def _on_top(
    evidence: Evidence, fit: Fit
) -> tuple[
    list[int], Float[np.ndarray, " free"], Float[np.ndarray, " free"], Float[np.ndarray, " free"]
]:
    """Free entries, their sizes and slopes, and the share of a shared shift that counts as size."""
    base, slots, free = (
        evidence.base + fit.shift,
        evidence.library.slots,
        evidence.free(fit.effects),
    )
    found = [slots[i].beyond(fit.total[i], base[i]) for i in free]
    value, slope = np.asarray(found, float).reshape(-1, 2).T
    following = [
        slots[i].neutral - x if slots[i].multiplies(base[i]) else 0.0
        for i, x in zip(free, value, strict=True)
    ]
    return free, value, slope, np.asarray(following)


def at_bounds(evidence: Evidence, fit: Fit) -> list[AtBound]:
    """Of each free entry of a set's vector, the end of its allowed range at which it lies."""
    free, found = evidence.free(fit.effects), []
    for i, low, high in zip(free, *evidence.bounds_of(free), strict=True):
        ends: tuple[tuple[AtBound, float], ...] = (("low", low), ("high", high))
        at = [end for end, x in ends if math.isclose(fit.total[i], x, rel_tol=1e-6, abs_tol=1e-9)]
        found.append(at[0] if at else "no")
    return found


def limits(evidence: Evidence, fit: Fit) -> list[tuple[int, float]]:
    """Smallest size of each parameter that these flights would have shown, by Fisher information.

    The parameters of the best set are estimated along; other effects are taken as absent.
    """
    chosen, sigmas = evidence.free(fit.effects), evidence.decision.limit_sigmas
    found = []
    for i in range(len(fit.vector)):
        hidden = evidence.library.slots[i].effect in evidence.library.withheld
        if hidden or i in chosen or fit.normal.H[:, i, i].sum() <= 0:
            continue
        H, _ = evidence.reduced(fit.normal, fit, [*chosen, i])
        variance = np.linalg.pinv(H, hermitian=True)[-1, -1]
        if variance > 0.0:  # by rounding, less than nothing may be left of what is hardly seen
            found.append((i, float(sigmas * np.sqrt(evidence.phi * variance))))
    return found
