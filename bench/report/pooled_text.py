"""A pool as headings and lines of text, for any document."""

from collections.abc import Sequence

from bench.stats.bootstrap import Interval
from bench.stats.pooled import Pool
from bench.stats.scores import STEADY
from bench.stats.statistics import REALITY
from bench.text.numbers import MISSING, measured, number

HOW_TO_READ_POOLED = (
    "The score is the settled reward between that of a team that stays at its spawn (0) and that "
    "of the upper reference, a hot start with four times the epochs (1). IQM: mean of the middle "
    "half of all runs, cells weighing alike, with the 95 % percentile-bootstrap interval, which "
    "holds the truth less often than that: with five seeds in about 85 % of cases.",
    "*Behind the first*: how much lower the mean score is, over the cells that both flew, with the "
    "95 % interval. Seeds are its units, since all cells share them. `bench compare` gives the "
    "same number. A rank is an interval and follows the means: whoever is shown to be above one "
    "method, by these differences with Holm's correction over all pairs, is ranked before all of "
    "lower mean, even before one whose seeds scatter too widely to be separated from anybody. "
    "Methods that share a letter are not separated, which does not make them as good.",
    "n: runs in the numbers (cells x seeds); in each cell they are the seeds that all methods of "
    "the table have, if two or more are. The last column counts runs that failed or diverged in "
    "any cell of this world; the diverged ones are in the numbers.",
)
"""What a reader must know."""
EXCLUDES_HALF = "*: the 95 % percentile-bootstrap interval excludes 0.5."
"""What an asterisk means."""


def pool_title(pool: Pool) -> str:
    """What is pooled, as text."""
    world = pool.cells[0].world
    where = "" if world == REALITY else f", flown in {world}"
    return f"Pooled over {len(pool.cells)} cells{where}"


def pool_headings(pool: Pool) -> list[str]:
    """Headings of `pool_lines`."""
    shares = [f"runs above {number(t, 3)}" for t in pool.thresholds]
    return [
        "rank",
        "method",
        "ties",
        "mean score",
        "behind the first",
        "IQM score",
        *shares,
        "n",
        "failed or diverged",
    ]


def pool_lines(pool: Pool) -> list[list[str]]:
    """A line for each entry, best first."""
    return [
        [
            _rank(*row.rank),
            row.entry.label,
            row.groups,
            number(row.mean, 4),
            measured(row.behind.mean, row.behind.low, row.behind.high) if row.behind else MISSING,
            measured(*row.iqm),
            *(_share(share) for share in row.shares),
            f"{row.n} ({len(pool.cells)} x {_rank(*row.seeds)})",
            str(row.lost),
        ]
        for row in pool.rows
    ]


def improvement_headings(pool: Pool) -> list[str]:
    """Headings of `improvement_lines`."""
    return ["probability that a run of", *(f"beats {row.entry.label}" for row in pool.rows)]


def improvement_lines(pool: Pool) -> list[list[str]]:
    """A line for each entry: how probably one of its runs has the higher score in a cell."""
    return [
        [row.entry.label, *map(_probability, line)]
        for row, line in zip(pool.rows, pool.improvement, strict=True)
    ]


def pool_remarks(pool: Pool) -> list[str]:
    """What is not in the pool and why, a sentence each."""
    remarks = [f"Not pooled: {cell.label}: {reason}." for cell, reason in pool.without]
    if pool.steadied:
        remarks.append(
            f"The upper reference diverged, and 1 is what it reaches with {STEADY}: "
            f"{'; '.join(cell.label for cell in pool.steadied)}."
        )
    return remarks + [f"Not pooled: {e.label}: {reason}." for e, reason in pool.left_out]


def _rank(low: int, high: int) -> str:
    return str(low) if low == high else f"{low} to {high}"


def _share(share: Interval) -> str:
    return f"{_percent([share.value])} ({_percent([share.low, share.high])})"


def _percent(values: Sequence[float]) -> str:
    return " to ".join(number(100.0 * value, 0) for value in values) + " %"


def _probability(found: Interval | None) -> str:
    """The probability, with an asterisk if its interval excludes one half."""
    if found is None:
        return MISSING
    return number(found.value, 2) + ("*" if found.excludes(0.5) else "")
