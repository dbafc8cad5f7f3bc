r"""What separates the nominal simulator from reference flights, as knowledge for the next set.

The whole library is fitted to the reference flights with a Gaussian prior on every parameter
(`prior_share`, `unbelieved_share`, `EffectCard.prior`), so that what these flights cannot tell
stays near neutral. How a drone turns tells gains, arms and inertia up to one common scale, which is
set by what is believed of the airframe (`EffectCard.prior`).

Three things carry over to the target flights: the vector itself, its precision, and the noise,
which is enlarged per channel until the reference flights agree with their own fit. What no effect
explains on both sets is thereby noise and not a finding. And parameters in which reference flights
differ from each other by more than that may differ between the target flights, too (`spread`).
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.decide.verdict import Floor, floor_of
from diagnosis.decision import Decision
from diagnosis.fit.descent import polished
from diagnosis.fit.equations import dispersion, loosened, spread_between
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Set
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.outliers import beyond
from diagnosis.replay.library import Library
from diagnosis.result_parts import SharedParameter

UNSEEN_PRECISION = 1e12
"""Times as precise as the prior is what is not fitted to the reference, or is not seen in it, such
as the downwash among drones that flew alone: what later flights show of it is a change."""
REFERENCE_STEPS = 25
"""Most steps of its fit."""
FIRM = 1e6
"""Precision of an effect that may not shift over what the reference says of it."""


@dataclasses.dataclass(frozen=True)
class Reference:
    """What the reference flights say."""

    vector: Float[np.ndarray, " params"]
    """The library's parameters that fit them."""
    precision: Float[np.ndarray, "params params"]
    """Inverse covariance of that vector, in units of chi-square."""
    enlarged: Float[np.ndarray, " 9"]
    """Noise with which the reference agrees with its fit, over the noise of its logs."""
    phi: float
    """Dispersion between its flights."""
    structure: float
    """Structure that the fit leaves."""
    scatter: float
    """Standard deviation of that between flights, beyond noise."""
    spread: Float[np.ndarray, " params"]
    """Variance of what its flights have of their own, in units of the dispersion."""
    pull: Float[np.ndarray, " params"]
    """Gradient of its flights at that vector: not zero where the vector stands at a bound."""

    @property
    def floor(self) -> Floor:
        """What changed flights are judged against."""
        return Floor(self.structure, self.scatter)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything as arrays by name."""
        return {f.name: np.asarray(getattr(self, f.name)) for f in dataclasses.fields(self)}

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> "Reference":
        """The inverse of `to_arrays`."""
        values: dict[str, Any] = {n: x if x.ndim else float(x) for n, x in arrays.items()}
        return cls(**values)

    def unfollowed(self, decision: Decision = Decision()) -> bool:
        """Whether the fit is no vehicle: some channel of its own flights is far from it."""
        return float(np.max(self.enlarged)) ** 2 > decision.reference_lost

    def shared(
        self, library: Library, decision: Decision = Decision()
    ) -> tuple[SharedParameter, ...]:
        """The vector where it differs from neutral by more than `shared_sigmas`."""
        error = np.sqrt(np.diag(np.linalg.inv(self.precision / self.phi)))
        return tuple(
            SharedParameter(
                effect=slot.effect,
                parameter=slot.parameter,
                value=float(self.vector[i]),
                unit=slot.unit,
            )
            for i, slot in enumerate(library.slots)
            if abs(self.vector[i] - slot.neutral) > decision.shared_sigmas * error[i]
        )


def fit_reference(
    likelihood: Likelihood, decision: Decision = Decision(), or_twin: bool = False
) -> Reference:
    """The library fitted to the reference flights of `likelihood`, whose noise is enlarged.

    With `or_twin`, a twin takes the place of a fit that is `unfollowed`: its steps end as soon as
    it will stay so (`_descended`).
    """
    library = likelihood.replay.library
    n_flights = len({flight for group in likelihood.groups for flight in group.flight})
    vector = _descended(likelihood, library, decision, or_twin)
    spoiled = beyond(decision.reference_distrust_sigmas, decision)
    likelihood = likelihood.settled(vector, spoiled)
    vector = _descended(likelihood, library, decision, or_twin, vector)
    normal = likelihood.normal(vector)
    per_channel = normal.kind.sum(axis=0) / (normal.dof.sum() / likelihood.n_channels)
    # A channel that these flights hardly excited would be believed too much: both horizontal
    # directions, and roll and pitch, take the larger of their two.
    per_channel = np.maximum(per_channel, per_channel[[1, 0, 2, 4, 3, 5, 7, 6, 8]])
    enlarged = np.sqrt(np.maximum(per_channel, 1.0))
    likelihood = likelihood.noisier(enlarged).settled(vector, spoiled)
    normal = likelihood.normal(vector)
    floor, prior = floor_of(library, normal), _prior(library, decision)
    spread = spread_between(normal, _shared(library), decision)
    normal = loosened(normal, spread)
    phi = dispersion(normal, n_flights)
    H, g = normal.H.sum(axis=0), normal.g.sum(axis=0)
    believed = phi * _prior(library, decision, np.diag(H) < phi * prior)
    pull, precision = g - believed * (vector - library.neutral), H + np.diag(believed)
    return Reference(vector, precision, enlarged, phi, floor.value, floor.scatter, spread, pull)


def beside(
    likelihood: Likelihood, base: Reference | None, decision: Decision = Decision()
) -> Evidence:
    """What flights hold against their reference, or, without one, against the simulator."""
    if base is None:
        return Evidence.of(likelihood, decision=decision)
    precision = pinned(likelihood.library, base.precision)
    return Evidence.of(likelihood, base.vector, precision, base.spread, base.pull, decision)


def pinned(
    library: Library, precision: Float[np.ndarray, "params params"]
) -> Float[np.ndarray, "params params"]:
    """`precision` with which neither excluded effects nor those that act like them shift.

    Those of the airframe (`EffectCard.airframe`) shift as far as the reference leaves open.
    """
    airframe = {name for name in library.effects if library.card(name).airframe}
    excluded = set(library.withheld) - airframe
    families = {family for name in excluded for family in library.card(name).families}
    alike = {name for name in airframe if families & {*library.card(name).families}}
    firm, at = precision.copy(), [i for n in sorted(excluded | alike) for i in library.indices[n]]
    firm[at, at] *= FIRM
    return firm


def _shared(library: Library) -> Bool[np.ndarray, " params"]:
    """Which parameters are fitted to the reference: none whose slope at neutral says nothing."""
    silent = {
        name for name in library.effects if library.card(name).start or name in library.onsets
    }
    kept = [library.card(s.effect).shared and s.effect not in silent for s in library.slots]
    return np.asarray(kept, bool)


def _prior(
    library: Library,
    decision: Decision = Decision(),
    unseen: Bool[np.ndarray, " params"] | bool = False,
) -> Float[np.ndarray, " params"]:
    """Prior precision of every parameter; very large where it is not shared or `unseen`."""
    cards = [library.card(slot.effect) for slot in library.slots]
    unbelieved = [card.unbelieved for card in cards]
    width = np.where(unbelieved, decision.unbelieved_share, decision.prior_share)
    width = width * (library.high - library.low)
    believed = [
        w if card.prior is None else card.prior for card, w in zip(cards, width, strict=True)
    ]
    precision = 1.0 / np.asarray(believed) ** 2
    precision[~_shared(library) | unseen] *= UNSEEN_PRECISION
    return precision


def _descended(
    likelihood: Likelihood,
    library: Library,
    decision: Decision,
    or_twin: bool,
    start: Float[np.ndarray, " params"] | None = None,
) -> Float[np.ndarray, " params"]:
    """The whole library fitted from `start`, as a shift of its neutral vector.

    A fit whose misfit is above `reference_lost` on the mean of all channels is so on one of them,
    and `unfollowed`. With `or_twin`, the steps end where that is still so after all steps that are
    allowed, were each to gain as much as the last one. As a rule gains shrink from step to step;
    a fit that only paused goes on in the second descent, without the windows that stand out.
    """
    evidence = Evidence.of(likelihood, library.neutral, np.diag(_prior(library, decision)))
    vector = library.neutral if start is None else start
    fit = evidence.made(Set(), vector, vector - library.neutral)
    # Gains count in units of the misfit, by which the noise is enlarged in the end.
    numbers = float(fit.normal.dof.sum())
    phi = max(1.0, fit.normal.chi2 / numbers)
    goal = -0.5 * decision.reference_lost * numbers / phi if or_twin else -np.inf
    return polished(dataclasses.replace(evidence, phi=phi), fit, goal, REFERENCE_STEPS).vector
