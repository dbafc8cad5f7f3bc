"""What flights say of each effect when they are left out of the fit.

Where the simulator does not follow the flights (real ones, mostly), errors are correlated within a
flight and log evidence counts them as independent. Whole flights still are replications: an effect
helps if, without it and with the others fitted again, flights that were left out in turn are
followed less well, by more than they differ among each other (t-interval, 95 %).
"""

import dataclasses

import numpy as np
from scipy import stats

from diagnosis.fit import Fit
from diagnosis.search import Problem
from diagnosis.shrinkage import FEW, misfits


@dataclasses.dataclass(frozen=True)
class Support:
    """By how much an effect lowers the misfit (chi-square) of flights left out in turn."""

    effect: str
    """Name."""
    percent: float | None
    """100 (1 - with / without), geometric mean over flights; None with fewer than three."""
    low: float | None
    """Lower end of its interval."""
    high: float | None
    """Upper end."""
    n: int
    """Flights."""

    @property
    def clear(self) -> bool:
        """Whether the effect helps beyond what flights differ."""
        return self.low is not None and self.low > 0.0


def support(problem: Problem, fit: Fit) -> list[Support]:
    """What each effect of a set does for flights left out in turn; most helpful first."""
    found = [_of(problem, fit, name) for name in sorted(fit.effects)]
    return sorted(found, key=lambda one: -(one.percent or 0.0))


def _of(problem: Problem, fit: Fit, name: str) -> Support:
    n = len(np.unique(fit.normal.flight))
    if n < FEW:
        return Support(name, None, None, None, n)
    without = problem.without(fit, name, hopeless=np.inf)
    ratio = np.log(misfits(problem, fit) / misfits(problem, without))
    half = stats.t.ppf(0.975, n - 1) * np.std(ratio, ddof=1) / np.sqrt(n)
    percent = -100.0 * np.expm1(ratio.mean() + half * np.asarray([0.0, 1.0, -1.0]))
    return Support(name, float(percent[0]), float(percent[1]), float(percent[2]), n)
