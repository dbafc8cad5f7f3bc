r"""Supported, refuted or undecided: what paired differences over seeds say of a statement.

    one cell      d_s = a_s - b_s over the seeds s that both have; t = mean(d) / (std(d) / sqrt(n))
    many cells    mean over cells of the cells' mean differences, each weighing alike;
                  variance = sum_c v_c / C^2 with v_c = var(d) / n in cell c; Student's t with
                  Satterthwaite's degrees of freedom, (sum v_c)^2 / sum v_c^2 / (n_c - 1)
    cell by cell  Holm's correction: the k-th smallest of m p-values is multiplied by m - k + 1

A difference above 0 beyond its interval supports "a is above b", one below 0 refutes it, all else
leaves it undecided: a tie is no win. A statement on every cell is supported if all its cells
support it, refuted if one refutes it.

Sources: Student (1908); Satterthwaite (1946); Holm (1979).
"""

import enum
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy import stats

from bench.stats.statistics import LEVEL, Estimate, matched


class Verdict(enum.Enum):
    """What the tables say of a statement."""

    SUPPORTED = "supported"
    REFUTED = "refuted"
    UNDECIDED = "undecided"
    UNTESTED = "not tested"


Pair = tuple[Mapping[int, float], Mapping[int, float]]
"""Two samples of one cell, values by seed."""


def over_cells(pairs: Iterable[Pair]) -> Estimate:
    """Mean over cells of `a` minus `b`; cells without two common seeds are left out."""
    common = [matched(a, b) for a, b in pairs]
    apart = [np.asarray([a[s] - b[s] for s in a]) for a, b in common if set(a) == set(b)]
    apart = [d for d in apart if d.size >= 2]
    if not apart:
        return Estimate(math.nan, math.nan, 0, math.nan, math.nan)
    mean = float(np.mean([d.mean() for d in apart]))
    variances = np.asarray([d.var(ddof=1) / d.size for d in apart])
    freedoms = np.asarray([d.size - 1 for d in apart])
    n = sum(d.size for d in apart)
    if variances.sum() == 0.0:
        return Estimate(mean, math.nan, n, mean, mean)
    error = float(np.sqrt(variances.sum())) / len(apart)
    freedom = float(variances.sum() ** 2 / np.sum(variances**2 / freedoms))
    half = float(stats.t.ppf(0.5 + LEVEL / 2.0, freedom)) * error
    return Estimate(mean, math.nan, n, mean - half, mean + half, freedom)


def holm(p_values: Sequence[float]) -> list[float]:
    """Corrected p-values, in the order given; NaN stays NaN and counts for nothing."""
    known = [i for i, p in enumerate(p_values) if not math.isnan(p)]
    corrected, largest = list(p_values), 0.0
    for rank, i in enumerate(sorted(known, key=lambda i: p_values[i])):
        largest = max(largest, min(1.0, (len(known) - rank) * p_values[i]))
        corrected[i] = largest
    return corrected


def by_cell(apart: Sequence[Estimate]) -> list[Verdict]:
    """Verdicts on "the first is above the second" in each cell, after Holm's correction."""
    return [above(one, p) for one, p in zip(apart, holm([one.p for one in apart]), strict=True)]


def above(apart: Estimate, p: float) -> Verdict:
    """The verdict on "the first is above the second", by a p-value that may be corrected."""
    if math.isnan(p):
        return Verdict.UNTESTED
    if p >= 1.0 - LEVEL:
        return Verdict.UNDECIDED
    return Verdict.SUPPORTED if apart.mean > 0.0 else Verdict.REFUTED


def every(verdicts: Iterable[Verdict]) -> Verdict:
    """The verdict on a statement about all cells; an untested cell supports nothing."""
    found = {*verdicts}
    if found <= {Verdict.UNTESTED}:
        return Verdict.UNTESTED
    if Verdict.REFUTED in found:
        return Verdict.REFUTED
    return Verdict.SUPPORTED if found == {Verdict.SUPPORTED} else Verdict.UNDECIDED


def below(bound: float, low: float, high: float) -> Verdict:
    """The verdict on "the number is at most `bound`", by its interval."""
    if math.isnan(low) or math.isnan(high):
        return Verdict.UNTESTED
    if high <= bound:
        return Verdict.SUPPORTED
    return Verdict.REFUTED if low > bound else Verdict.UNDECIDED
