r"""What flights without noise can tell: whether the truth stands out from all rivals, how sharply.

At the noise that was logged, chi-square of noise-free flights is the difference between a model and
what happened. With theta the parameters of the true set and R any other set of at most as many
effects,

    margin = min_R min_theta chi2(R, theta) - min_theta chi2(truth, theta),

the nominal simulator (R empty) among the rivals. A case is decidable if the margin is at least
`decidable_chi2`, where the log likelihood ratio of the two has means five standard deviations
apart. A set that contains the truth, also as a special case of one of its effects, is no rival. The
Cramer-Rao bound is the inverse of the normal equations at the truth.

Rivals are screened by what the linearised simulator promises, at nominal and at the truth, and
refitted where they could come close.
"""

import dataclasses
import itertools
from collections.abc import Collection, Iterator, Mapping

import numpy as np
from jaxtyping import Float

from diagnosis.decide.verdict import sizes
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Fit, Set
from diagnosis.fit.search import Fits, refit
from simulators.effects.card import load_card

Parameters = Mapping[str, Mapping[str, float]]
"""Values by effect and parameter."""


@dataclasses.dataclass(frozen=True)
class Decidability:
    """How far a case is from its best rival."""

    decidable: bool
    """Whether `margin` is at least `decidable_chi2`."""
    margin: float
    """Chi-square of the best rival beyond that of the truth."""
    rival: tuple[str, ...]
    """The best rival; empty for the nominal simulator."""
    gap: float
    """Chi-square of the nominal simulator beyond that of the truth."""
    left: float
    """Chi-square that the truth leaves: what the library and the reality do not agree on."""


def with_truth(fits: Fits, truth: Parameters) -> Fits:
    """These with the true set, started at its true values.

    Raises:
        ValueError: A name is not in the library.
    """
    evidence, library = fits.evidence, fits.evidence.library
    vector = evidence.base.copy()
    for effect, given in truth.items():
        if effect not in library.effects:
            raise ValueError(
                f"`truth` must name effects of the library ({', '.join(library.effects)}), got "
                f"'{effect}'."
            )
        for i in library.indices[effect]:
            slot = library.slots[i]
            true = given.get(slot.parameter, slot.neutral)
            vector[i] = slot.on_top(true, evidence.base[i])
    effects = Set(truth)
    near = dataclasses.replace(fits.nominal, effects=effects, vector=vector)
    return refit(fits, effects, near)


def decidability(fits: Fits, truth: Parameters) -> Decidability:
    """Whether the true set can be told from every other one of at most as many effects."""
    fits = with_truth(fits, truth)
    true, decision = fits[Set(truth)], fits.evidence.decision
    least = decision.decidable_chi2
    gap = fits.nominal.objective - true.objective
    best, found = Set(), gap
    screened = sorted(_screened(fits, true), key=lambda item: item[1])
    for rival, excess in screened[: decision.rivals]:
        if found < least or excess > least + decision.close_share * gap:
            break
        fits = refit(fits, rival, _near(fits, rival))
        if fits[rival].objective - true.objective < found:
            best, found = rival, fits[rival].objective - true.objective
    if screened and screened[0][1] < found and screened[0][0] not in fits.by_set:
        best, found = screened[0]
    left = true.objective
    return Decidability(found >= least, found, tuple(sorted(best)), gap, left)


def unexplained(
    fits: Fits, allowed: Collection[str], left: float, largest: int = 2
) -> Decidability:
    """Whether the flights differ from nominal and from every set of allowed effects.

    Args:
        fits: Flights without noise.
        allowed: Effects of the library that may be named.
        left: Chi-square that the truth would leave.
        largest: Number of effects in the largest sets.
    """
    front, best, decision = [fits.nominal], fits.nominal, fits.evidence.decision
    for _ in range(largest):
        grown = {
            fit.effects | {name}: fit
            for fit in reversed(front)
            for name in allowed
            if name not in fit.effects
        }
        promised = {s: fits.evidence.promised(near, s) for s, near in grown.items()}
        chosen = sorted(promised, key=lambda s: -promised[s])[: decision.rivals - 1]
        for effects in chosen:
            fits = refit(fits, effects, grown[effects])
        front = sorted((fits[effects] for effects in chosen), key=lambda f: f.objective)[:2]
        best = min([best, *front], key=lambda f: f.objective)
    margin = best.objective - left
    gap = fits.nominal.objective - left
    clear = margin >= decision.decidable_chi2
    return Decidability(clear, margin, tuple(sorted(best.effects)), gap, left)


def cramer_rao(evidence: Evidence, fit: Fit) -> Parameters:
    """Smallest standard deviation of each parameter of a set, by effect, in the parameter's unit.

    Of what `values` gives. What these flights say nothing about is left out.
    """
    return _named(evidence, fit, sizes(evidence, fit)[1])


def values(evidence: Evidence, fit: Fit) -> Parameters:
    """The parameters of a fit by effect, on top of what nominal and reference differ by."""
    return _named(evidence, fit, sizes(evidence, fit)[0])


def _named(evidence: Evidence, fit: Fit, numbers: Float[np.ndarray, " free"]) -> Parameters:
    """Finite numbers of a set's free entries by effect and parameter."""
    found: dict[str, dict[str, float]] = {}
    for i, number in zip(evidence.free(fit.effects), numbers, strict=True):
        if np.isfinite(number):
            slot = evidence.library.slots[i]
            found.setdefault(slot.effect, {})[slot.parameter] = float(number)
    return found


def rivals(truth: Set, names: Collection[str]) -> Iterator[Set]:
    """Sets of one effect to as many as the truth has that do not contain it."""
    for size in range(1, len(truth) + 1):
        for chosen in itertools.combinations(sorted(names), size):
            if not contains(Set(chosen), truth):
                yield Set(chosen)


def contains(effects: Set, truth: Set) -> bool:
    """Whether each true effect is there, by itself or as a special case of another one."""
    found = effects.union(*(load_card(name).special_cases for name in effects))
    return found >= truth


def _screened(fits: Fits, true: Fit) -> Iterator[tuple[Set, float]]:
    """Every rival with the chi-square beyond the truth's that it promises at least."""
    evidence, nominal = fits.evidence, fits.nominal
    for rival in rivals(true.effects, evidence.library.candidates):
        from_nominal = nominal.objective - evidence.gain(nominal, rival)
        from_truth = true.objective + _exchanged(evidence, true, rival)
        yield rival, min(from_nominal, from_truth) - true.objective


def _exchanged(evidence: Evidence, true: Fit, rival: Set) -> float:
    """Rise of chi-square if true effects go to neutral and the rival's take their place."""
    gone = evidence.free(true.effects - rival)
    new = evidence.free(rival)
    H, g = evidence.reduced(true.normal, true, [*gone, *new])
    n = len(gone)
    back: Float[np.ndarray, " gone"] = (evidence.base + true.shared - true.vector)[gone]
    right = g[n:] - H[n:, :n] @ back
    gain = float(right @ np.linalg.pinv(H[n:, n:], hermitian=True, rcond=1e-9) @ right)
    return float(back @ H[:n, :n] @ back - 2.0 * g[:n] @ back) - gain


def _near(fits: Fits, rival: Set) -> Fit:
    """The best fit of a part of `rival` to start from."""
    parts = [fit for effects, fit in fits.by_set.items() if effects and effects < rival]
    return min(parts, key=lambda fit: fit.objective, default=fits.nominal)
