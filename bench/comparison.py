"""Comparisons of entries cell by cell, and how their numbers are written."""

import dataclasses
import math
from collections.abc import Sequence

from bench import markdown
from bench.numbers import MISSING, mean_std, number, span
from bench.statistics import (
    Cell,
    Entry,
    Estimate,
    Values,
    difference,
    estimate,
    matched,
    seed_values,
)
from bench.tables import Tables


@dataclasses.dataclass(frozen=True)
class Wins:
    """Outcome of a comparison by cell."""

    cells: list[Cell]
    won: list[bool]
    text: str


def behind(value: float, base: float) -> float:
    """How far a value lies below a base, as a share of the base's size; NaN where that is 0."""
    return (base - value) / abs(base) if base else math.nan


def duels(values: Values, a: Entry, b: Entry) -> tuple[tuple[tuple[str, ...], ...], Wins]:
    """Lines of a table that compares `a` with `b`, and in which cells `a` has the higher mean."""
    lines, cells, won = [], [], []
    above = below = 0
    for cell, mine, theirs in pairs(values, a, b):
        apart = difference(values[cell][a], values[cell][b])
        cells.append(cell)
        won.append(mine.mean > theirs.mean)
        above += apart.excludes_zero and apart.mean > 0.0
        below += apart.excludes_zero and apart.mean < 0.0
        middle = (summary(mine), summary(theirs), number(apart.mean, 1), interval(apart))
        lines.append((markdown.escape(cell.label), *middle, verdict(apart, "above", "below")))
    text = (
        f"{sum(won)} of {len(won)} cells ({above} significantly above, {below} significantly below)"
    )
    if missing := len(values) - len(won):
        text += f"; {missing} more without a finished run of one of them"
    return tuple(lines), Wins(cells, won, text if won else MISSING)


def pairs(values: Values, a: Entry, b: Entry) -> list[tuple[Cell, Estimate, Estimate]]:
    """Estimates of both entries, for each cell in which both have a finished run.

    They are those of the seeds that are compared (`statistics.matched`).
    """
    compared = (
        (cell, *matched(found[a], found[b]))
        for cell, found in values.items()
        if a in found and b in found
    )
    return [
        (cell, estimate(mine.values()), estimate(theirs.values()))
        for cell, mine, theirs in compared
    ]


def undisturbed(tables: Tables, metric: str) -> Values:
    """Values in the undisturbed high-fidelity simulator."""
    found = seed_values(tables.results, metric)
    return {
        cell: entries for cell, entries in found.items() if cell == Cell(cell.task, cell.team_size)
    }


def shared(values: Values, entries: Sequence[Entry]) -> Values:
    """Values on the tasks that all of `entries` have at each team size at which they have any.

    Where team sizes or entries are compared by their means, tasks must not differ.
    """
    flown: dict[tuple[Entry, int], set[str]] = {}
    for cell, found in values.items():
        for entry in entries:
            if entry in found:
                flown.setdefault((entry, cell.team_size), set()).add(cell.task)
    tasks = set.intersection(*flown.values()) if flown else set()
    return {cell: found for cell, found in values.items() if cell.task in tasks}


def by_size(values: Values, entry: Entry, team_size: int) -> list[float]:
    """Values of all tasks and seeds at a team size."""
    cells = (found for cell, found in values.items() if cell.team_size == team_size)
    return [x for found in cells for x in found.get(entry, {}).values()]


def sizes_of(values: Values) -> list[int]:
    """Team sizes, ascending."""
    return sorted({cell.team_size for cell in values})


def summary(sample: Estimate) -> str:
    """Mean, standard deviation and seeds as text."""
    return f"{mean_std(sample.mean, sample.std)} (n = {sample.n})" if sample.n else MISSING


def interval(sample: Estimate) -> str:
    """The 95 % t-interval as text, `-` without one."""
    return span(sample.low, sample.high, 1)


def verdict(apart: Estimate, above: str, below: str) -> str:
    """What an interval of a difference says, as text."""
    if not apart.has_interval:
        return "one seed: no order" if apart.n else MISSING
    if not apart.excludes_zero:
        return "tied"
    return above if apart.mean > 0.0 else below


def spread(values: Sequence[float], digits: int = 0) -> str:
    """Mean, with the range in brackets where there is one."""
    if not values:
        return MISSING
    low, high = (number(f(values), digits) for f in (min, max))
    mean = number(math.fsum(values) / len(values), digits)
    return mean if low == high else f"{mean} ({low} to {high})"
