"""Flights replayed in one way, with what came of it."""

import dataclasses

import numpy as np
from jaxtyping import Float

from diagnosis.decide.reference import Reference
from diagnosis.decide.support import Support
from diagnosis.decide.verdict import FOLLOWED, Verdict
from diagnosis.decision import DECISION
from diagnosis.fit import shrinkage
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.search import Problem
from diagnosis.logs.inputs import Inputs


@dataclasses.dataclass(frozen=True)
class Study:
    """Flights replayed in one way, with what came of it."""

    inputs: Inputs
    """The flights as they are driven, those that hold nothing to compare left out."""
    compared: Inputs | None
    """The reference flights, likewise."""
    base: Reference | None
    """What the reference flights say."""
    problem: Problem
    """Fits of candidate sets."""
    verdict: Verdict
    """Which set."""
    support: tuple[Support, ...]
    """What flights left out of the fit say where the simulator does not follow flights."""
    every: Likelihood
    """All flights."""
    drift: shrinkage.Drift
    """Held-out flights before and after."""
    fit_ids: list[int]
    """Flights that were fitted."""
    held: list[int]
    """Flights that were scored; all of them, one left out in turn, where they are few."""
    noise: Float[np.ndarray, " 9"]
    """Noise of the logs, before a reference enlarged it."""

    def attitude_lost(self) -> bool:
        """Whether nothing explains the attitude, so that it spoils what thrust and forces say.

        Beside reference flights whose own attitude nothing explains, no change is clear either.
        """
        if self.inputs.prescribed:
            return False
        if self.base is not None and np.max(self.base.enlarged[6:]) ** 2 > DECISION.attitude_lost:
            return True
        if self.verdict.kind != "unexplained":
            return False
        normal = self.verdict.chosen.fit.normal
        chi2 = normal.kind.sum(axis=0)[6:] / (normal.dof.sum() / self.every.n_channels)
        enlarged = (self.every.sigma / self.noise)[6:] ** 2
        return bool(np.max(chi2 * enlarged) > DECISION.attitude_lost)

    def convinces(self) -> bool:
        """Whether forces, judged under the measured attitude, have a gap with a clear cause.

        The noise of the measured attitude enters the forces, which a small effect could explain.
        """
        floor = self.base.floor if self.base else FOLLOWED
        found = self.verdict.found.exceeds(DECISION.slight_structure, floor)
        share = self.verdict.unexplained_share
        return found and self.verdict.kind == "effect" and share < DECISION.forces_explained
