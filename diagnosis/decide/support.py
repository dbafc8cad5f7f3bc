"""What flights say of each effect when they are left out of the fit.

Where the simulator does not follow the flights (real ones, mostly), errors are correlated within a
flight and log evidence counts them as independent. Whole flights still are replications: an effect
helps if, without it and with the others fitted again, flights that were left out in turn are
followed less well, by more than they differ among each other (t-interval, 95 %).
"""

import numpy as np
from jaxtyping import Float
from scipy import stats

from diagnosis.decide.verdict import Floor, Verdict, judge
from diagnosis.fit.fit import Fit
from diagnosis.fit.search import Fits, polish, without
from diagnosis.fit.shrinkage import misfits
from diagnosis.result import Support


def support(fits: Fits, fit: Fit) -> tuple[Fits, list[Support]]:
    """What each effect of a set does for flights left out in turn; most helpful first.

    And the fits with those that this took further.
    """
    found = []
    for name in sorted(fit.effects):
        fits, one = _of(fits, fit, name)
        found.append(one)
    return fits, sorted(found, key=lambda one: -(one.percent or 0.0))


def judge_supported(fits: Fits, floor: Floor) -> tuple[Fits, Verdict, tuple[Support, ...]]:
    """The verdict, and what left-out flights say where the simulator does not follow flights.

    And the fits with those that this took further.
    """
    verdict, lines = judge(fits, floor), []
    if verdict.kind == "unexplained" or floor.unlike(fits.evidence.decision) > 0.0:
        fits, lines = support(fits, verdict.chosen.fit)
    return fits, verdict, tuple(lines)


def _of(fits: Fits, fit: Fit, name: str) -> tuple[Fits, Support]:
    n = len(np.unique(fit.normal.flight))
    if n < fits.evidence.decision.fewest_flights:
        few = Support(effect=name, percent=None, low=None, high=None, n=n, confirmed=None)
        return fits, few
    # A flight is left out to first order, which needs fits that have ended, the worse one too.
    fits = polish(fits, fit.effects, hopeless=np.inf)
    fit, less = fits[fit.effects], fit.effects - {name}
    fits = polish(without(fits, fit, name, hopeless=np.inf), less, hopeless=np.inf)
    ratio = np.log(misfits(fits.evidence, fit) / misfits(fits.evidence, fits[less]))
    return fits, supported(name, ratio)


def supported(effect: str, ratio: Float[np.ndarray, " flights"]) -> Support:
    """What an effect does, by the logarithm of each flight's misfit with it over that without."""
    half = stats.t.ppf(0.975, len(ratio) - 1) * np.std(ratio, ddof=1) / np.sqrt(len(ratio))
    percent = -100.0 * np.expm1(ratio.mean() + half * np.asarray([0.0, 1.0, -1.0]))
    value, low, high = (float(x) if np.isfinite(x) else None for x in percent)
    confirmed = low is not None and low > 0.0
    return Support(
        effect=effect, percent=value, low=low, high=high, n=len(ratio), confirmed=confirmed
    )
