r"""Supported, refuted or undecided: what paired differences over seeds say of a statement.

    one cell      d_s = a_s - b_s over the seeds s that both have; t = mean(d) / (std(d) / sqrt(n))
    many cells    mean over cells of the cells' mean differences, each weighing alike, t = mean / e.
                  The unit is the seed, which cells share: one seed draws the first weights and the
                  calibration flights of all of them. With w_c = 1 / (C sqrt(n_c (n_c - 1))),
                      u_s = sum_c w_c (d_cs - mean(d_c)),   e^2 = sum_s u_s^2
                  Where all cells have the same n seeds, this is the one-sample test of the seeds'
                  means over cells, with n - 1 degrees of freedom; where no two cells share a seed,
                  Satterthwaite's. Between the two his formula is applied to
                      M_ss' = sum_c w_c std(d_c) (1[s = s'] - 1 / n_c),   s and s' in c:
                  tr(M'M)^2 / tr((M'M)^2), as if a seed were equally good or bad in all its cells.
    cell by cell  Holm's correction: the k-th smallest of m p-values is multiplied by m - k + 1

A difference above 0 beyond its interval supports "a is above b", one below 0 refutes it, all else
leaves it undecided: a tie is no win. A statement on every cell is supported if all its cells
support it, refuted if one refutes it.

Sources: Student (1908); Satterthwaite (1946); Holm (1979); Bell and McCaffrey (2002), "Bias
reduction in standard errors for linear regression with multi-stage samples" (clusters; degrees of
freedom).
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
    """Mean over cells of `a` minus `b`, with seeds as units, whatever number of cells they are in.

    As in one cell, samples without two common seeds are compared unpaired. Cells in which one of
    both has a single seed are left out.
    """
    cells = [own for a, b in pairs if (own := _samples(a, b))]
    if not cells:
        return Estimate(math.nan, math.nan, 0, math.nan, math.nan)
    seeds = sorted({seed for own in cells for sample in own for seed in sample})
    mean, pull, spread = 0.0, np.zeros(len(seeds)), np.zeros((len(seeds), len(seeds)))
    for sign, sample in ((sign, s) for own in cells for sign, s in zip((1, -1), own, strict=False)):
        x, at, n = np.asarray([*sample.values()]), np.searchsorted(seeds, [*sample]), len(sample)
        mean += sign * float(x.mean()) / len(cells)
        weight = sign / len(cells) / math.sqrt(n * (n - 1))
        pull[at] += weight * (x - x.mean())
        spread[np.ix_(at, at)] += weight * x.std(ddof=1) * (np.eye(n) - 1.0 / n)
    error = float(np.linalg.norm(pull))
    if error == 0.0:
        return Estimate(mean, math.nan, len(seeds), mean, mean)
    square = spread.T @ spread
    freedom = float(np.trace(square) ** 2 / np.sum(square**2))
    half = float(stats.t.ppf(0.5 + LEVEL / 2.0, freedom)) * error
    return Estimate(mean, math.nan, len(seeds), mean - half, mean + half, freedom)


def _samples(a: Mapping[int, float], b: Mapping[int, float]) -> Sequence[Mapping[int, float]]:
    """The differences of common seeds, or both samples; nothing if one has a single seed."""
    first, second = matched(a, b)
    paired = set(first) == set(second)
    found = [{seed: first[seed] - second[seed] for seed in first}] if paired else [first, second]
    return found if all(len(sample) >= 2 for sample in found) else []


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
