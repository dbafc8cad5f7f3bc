"""What a rule is by which a claim is judged, and what rules share.

A rule is asked once for the metric that counts first and once for the whole return. It says what
our tables have, and supported, refuted or undecided (`bench/stats/verdicts.py`); what decides
stands in `text`, and the cells in a table.
"""

import abc
import dataclasses
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import ClassVar

from bench.stats.statistics import estimate
from bench.stats.verdicts import Verdict
from bench.store.tables import Tables
from bench.text.numbers import MISSING, mean_std, significant


@dataclasses.dataclass(frozen=True)
class Finding:
    """What our tables say of a claim."""

    ours: str
    """In words and numbers."""
    verdict: Verdict
    headings: tuple[str, ...] = ()
    """Of the detail table."""
    lines: tuple[tuple[str, ...], ...] = ()
    """The detail table, Markdown in its cells."""
    pooled: Verdict = Verdict.UNTESTED
    """The verdict on the mean over all cells, where there is a test of it."""


UNTESTED = Finding(MISSING, Verdict.UNTESTED)
"""Where the tables hold nothing on a claim."""


class AbstractRule(abc.ABC):
    """How a claim is judged."""

    text: str
    """When it counts as supported."""

    one_refutes: ClassVar[bool] = True
    """Whether what was run can refute it, whatever the rest will be."""

    @abc.abstractmethod
    def judge(self, tables: Tables, metric: str) -> Finding:
        """The finding by a metric, where the rule is about returns at all."""


def counts_text(verdicts: Iterable[Verdict]) -> str:
    """Such as "supported in 15, undecided in 3 of 18"."""
    found = Counter(verdicts)
    parts = [f"{v.value} in {found[v]}" for v in Verdict if found[v]]
    return f"{', '.join(parts)} of {found.total()}" if parts else ""


def range_text(values: Collection[float], digits: int = 3) -> str:
    """Smallest and largest value as text; one number where they are the same."""
    found = [significant(f(values), digits) for f in (min, max)]
    return found[0] if found[0] == found[1] else f"{found[0]} to {found[1]}"


def summary(values: Iterable[float], digits: int = 1) -> str:
    """Mean and standard deviation over seeds, and how many these are, as text."""
    found = estimate(values)
    return f"{mean_std(found.mean, found.std, digits)} (n = {found.n})"


def lost_share(best: Mapping[int, float], worse: Mapping[int, float]) -> float:
    """By which share of its loss the second loses more than the first; NaN of no loss."""
    base = estimate(best.values()).mean
    return relative(base - estimate(worse.values()).mean, base)


def relative(apart: float, base: float) -> float:
    """A difference as a share of what it is a difference to; NaN where that is 0."""
    return apart / abs(base) if base else math.nan
