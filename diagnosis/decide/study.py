"""Flights replayed in one way, with what came of it."""

import dataclasses

import numpy as np

from diagnosis.decide.attribution import attribute
from diagnosis.decide.prepared import Prepared, Progress, Question, prepare, silent
from diagnosis.decide.reference import beside
from diagnosis.decide.support import judge_supported
from diagnosis.decide.verdict import FOLLOWED, Verdict
from diagnosis.fit import shrinkage
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.outliers import beyond
from diagnosis.fit.search import Fits
from diagnosis.result import Support


@dataclasses.dataclass(frozen=True)
class Study:
    """Flights replayed in one way, with what came of it."""

    prepared: Prepared
    """The flights, the simulator and the reference."""
    fits: Fits
    """Fits of candidate sets."""
    verdict: Verdict
    """Which set."""
    support: tuple[Support, ...]
    """What flights left out of the fit say where the simulator does not follow flights."""
    every: Likelihood
    """All flights, settled at the chosen set."""
    drift: shrinkage.Drift
    """Held-out flights before and after."""

    def attitude_lost(self) -> bool:
        """Whether nothing explains the attitude, so that it spoils what thrust and forces say.

        Beside reference flights whose own attitude nothing explains, no change is clear either.
        """
        base, decision = self.prepared.base, self.prepared.decision
        if self.prepared.inputs.prescribed:
            return False
        if base is not None and np.max(base.enlarged[6:]) ** 2 > decision.attitude_lost:
            return True
        if self.verdict.kind != "unexplained":
            return False
        normal = self.verdict.chosen.fit.normal
        chi2 = normal.kind.sum(axis=0)[6:] / (normal.dof.sum() / self.every.n_channels)
        enlarged = (self.every.sigma / self.prepared.noise)[6:] ** 2
        return bool(np.max(chi2 * enlarged) > decision.attitude_lost)

    def convinces(self) -> bool:
        """Whether forces, judged under the measured attitude, have a gap with a clear cause.

        The noise of the measured attitude enters the forces, which a small effect could explain.
        """
        base, decision = self.prepared.base, self.prepared.decision
        floor = base.floor if base else FOLLOWED
        found = self.verdict.found.exceeds(decision.slight_structure, floor, decision)
        share = self.verdict.unexplained_share
        return found and self.verdict.kind == "effect" and share < decision.forces_explained


def study(question: Question, prepared: Prepared, progress: Progress = silent) -> Study:
    """What came of the flights of a question, `prepared`, replayed in the way that says most.

    Where nothing explains the attitude, that is the measured one, if it makes a cause clear.

    Raises:
        LogError: As `prepare`.
    """
    found = conclude(prepared, progress)
    if not found.attitude_lost():
        return found
    progress("again, with the measured attitude", 0.05)
    other = conclude(prepare(question, prescribe=True, progress=progress), progress)
    return other if other.convinces() else found


def conclude(prepared: Prepared, progress: Progress = silent) -> Study:
    """The fits of prepared flights, the verdict on them, and how far the gap shrinks."""
    base, fit_ids, in_turn = prepared.base, prepared.fit_ids, prepared.in_turn
    evidence = beside(
        prepared.every if in_turn else prepared.part(fit_ids), base, prepared.decision
    )
    fits = attribute(evidence, len(fit_ids), base.phi if base else 1.0, progress)
    fits, verdict, support = judge_supported(fits, base.floor if base else FOLLOWED)
    progress("scoring held-out flights", 0.9)
    fit = verdict.chosen.fit
    every = scored = fits.evidence.likelihood
    if not in_turn:
        spoiled = beyond(prepared.decision.distrust_sigmas, prepared.decision)
        every = prepared.every.settled(fit.total, spoiled)
        scored = prepared.part(prepared.held).settled(fit.total, spoiled)
    n_flights = len(prepared.inputs.flights)
    drift = shrinkage.score(fits.evidence, fit, scored, n_flights, in_turn)
    return Study(prepared, fits, verdict, support, every, drift)
