"""Entries over all their cells: how often best, on the reward and on every other axis."""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

from bench.stats.leaderboard_rows import AXES, Row
from bench.stats.ranking import Rank
from bench.stats.scores import UPPER
from bench.stats.statistics import Entry
from bench.text.numbers import MISSING, number, significant

STANDING_HEADINGS = (
    "method",
    "best mean",
    "not separated from the best",
    "there at most behind by",
    "mean place",
    "cells ranked",
    "failed or diverged",
)
"""Headings of `standing_lines`."""
AXIS_HEADINGS = ("method", "reward", *AXES.values())
"""Headings of `axis_lines`."""
HOW_TO_READ_STANDINGS = (
    "*Best mean*: the cells in which its mean is the best. *Not separated from the best*: the "
    "other cells in which the 95 % interval of the difference contains 0, which says that nothing"
    " was shown and not that both are as good. *There at most behind by*: the upper end of that "
    "interval, the largest of these cells, in scores (0: a team that stays at its spawn; 1: the "
    "upper reference). *Mean place*: of its means, over the cells ranked."
)
"""What the columns mean."""


class Standing(NamedTuple):
    """An entry over all its cells."""

    method: str
    cells: int
    """Cells in which it competes."""
    ranked: int
    """Those in which an order is claimed."""
    best: int
    """Those in which its mean is the best."""
    tied: int
    """Those in which another mean is better, and the two are not separated."""
    may_be_first: int
    """Those in which its rank may be the first."""
    behind: float
    """Largest score by which it may lie behind where it is tied; NaN without any or a score."""
    place: float
    """Mean place of its mean; NaN without a ranked cell."""
    lost: int
    """Runs that failed or diverged."""

    def of_ranked(self, count: int) -> str:
        """A number of the ranked cells, as text."""
        return f"{count} of {self.ranked}" if self.ranked else MISSING


def standings(
    rows: Iterable[Row], rank_of: Callable[[Row], Rank | None] = lambda row: row["rank"]
) -> list[Standing]:
    """Entries that compete, over all cells, most often best first."""
    by_entry: dict[Entry, list[Row]] = {}
    for row in rows:
        if row["default"] is None and row["entry"].method != UPPER:
            by_entry.setdefault(row["entry"], []).append(row)
    found = [_standing(entry, own, rank_of) for entry, own in by_entry.items()]
    return sorted(
        found, key=lambda s: (-s.best, math.inf if math.isnan(s.place) else s.place, s.method)
    )


def _standing(entry: Entry, own: list[Row], rank_of: Callable[[Row], Rank | None]) -> Standing:
    ranks = [(rank, row) for row in own if (rank := rank_of(row)) is not None]
    tied = [(rank, row) for rank, row in ranks if rank.behind is not None and not rank.separated]
    behind = [rank.behind.high / row["scale"] for rank, row in tied if rank.behind is not None]
    return Standing(
        method=entry.label,
        cells=len(own),
        ranked=len(ranks),
        best=sum(rank.place == 1 for rank, _ in ranks),
        tied=len(tied),
        may_be_first=sum(rank.first == 1 for rank, _ in ranks),
        behind=max(behind, default=math.nan),
        place=sum(rank.place for rank, _ in ranks) / len(ranks) if ranks else math.nan,
        lost=sum(row["lost"] for row in own),
    )


def standing_lines(rows: list[Row]) -> list[list[str]]:
    """The overall table as text."""
    return [
        [
            s.method,
            s.of_ranked(s.best),
            s.of_ranked(s.tied),
            significant(s.behind),
            number(s.place, 1),
            f"{s.ranked} of {s.cells}",
            str(s.lost),
        ]
        for s in standings(rows)
    ]


def axis_lines(rows: list[Row]) -> list[list[str]]:
    """In how many cells the rank of each entry may be the first, by axis, as text."""
    by_axis = [
        {
            s.method: s.of_ranked(s.may_be_first)
            for s in standings(rows, lambda row, axis=axis: row["axis_ranks"].get(axis))
        }
        for axis in AXES
    ]
    return [
        [s.method, s.of_ranked(s.may_be_first), *(axis[s.method] for axis in by_axis)]
        for s in standings(rows)
    ]
