"""From evidence to fits: the likelihood is settled, the dispersion estimated, sets are searched."""

import dataclasses

from diagnosis.decide.prepared import Progress, silent
from diagnosis.fit.equations import dispersion
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.outliers import beyond, upsets
from diagnosis.fit.search import Fits, polish_best, refit, search, search_firmly


def attribute(
    evidence: Evidence, n_flights: int, floor: float = 1.0, progress: Progress = silent
) -> Fits:
    """Fits of all sets near the top, of so many flights, with the dispersion settled.

    The dispersion is at least `floor`. What was left out is settled once more where an upset shows
    only at the fit without others.
    """
    progress("screening all effects", 0.1)
    decision = evidence.decision
    settled = evidence.likelihood.settled(evidence.base)
    start = Fits.of(dataclasses.replace(evidence, likelihood=settled))
    start = start.weighed(max(floor, dispersion(start.nominal.normal, n_flights)))
    firm = search_firmly(start.evidence)
    best, fits = firm.best, dataclasses.replace(firm, evidence=start.evidence)
    for share in (0.5, 0.7):
        progress("weighing windows that stand out", share)
        fits = fits.settled(best.total, beyond(decision.distrust_sigmas, decision))
        fits = refit(fits, best.effects, fits.nominal)
        fits = fits.weighed(max(floor, dispersion(fits[best.effects].normal, n_flights)))
        progress("comparing sets of effects", share + 0.1)
        fits = polish_best(search(fits))
        best = fits.best
        fits = fits.weighed(max(floor, dispersion(best.normal, n_flights)))
        if not upsets(best.normal, best.normal.dof > 0, decision).any():
            break
    return fits
