"""Entries over all their cells: how often best, on the reward and on every other axis."""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

from bench.stats.leaderboard_rows import AXES, Row
from bench.stats.statistics import Entry
from bench.text.numbers import MISSING, number

STANDING_HEADINGS = ("method", "best or tied", "mean rank", "cells ranked", "failed or diverged")
"""Headings of `standing_lines`."""
AXIS_HEADINGS = ("method", "reward", *AXES.values())
"""Headings of `axis_lines`."""


class Standing(NamedTuple):
    """An entry over all its cells."""

    method: str
    cells: int
    """Cells in which it competes."""
    ranked: int
    """Those in which an order is claimed."""
    best: int
    """Those in which it is best or tied with the best."""
    mean_rank: float
    """Mean over the ranked cells; NaN without any."""
    lost: int
    """Runs that failed or diverged."""

    @property
    def best_text(self) -> str:
        """In how many of the ranked cells it is best, as text."""
        return f"{self.best} of {self.ranked}" if self.ranked else MISSING


def standings(
    rows: Iterable[Row], rank_of: Callable[[Row], int | None] = lambda row: row["rank"]
) -> list[Standing]:
    """Entries over all cells, most often best first."""
    by_entry: dict[Entry, list[Row]] = {}
    for row in rows:
        by_entry.setdefault(row["entry"], []).append(row)
    found = []
    for entry, own in by_entry.items():
        placed = [rank for row in own if (rank := rank_of(row)) is not None]
        found.append(
            Standing(
                method=entry.label,
                cells=len(own),
                ranked=len(placed),
                best=placed.count(1),
                mean_rank=sum(placed) / len(placed) if placed else math.nan,
                lost=sum(row["lost"] for row in own),
            )
        )
    return sorted(
        found,
        key=lambda s: (-s.best, math.inf if math.isnan(s.mean_rank) else s.mean_rank, s.method),
    )


def standing_lines(rows: list[Row]) -> list[list[str]]:
    """The overall table as text."""
    return [
        [
            s.method,
            s.best_text,
            number(s.mean_rank, 2),
            f"{s.ranked} of {s.cells}",
            str(s.lost),
        ]
        for s in standings(rows)
    ]


def axis_lines(rows: list[Row]) -> list[list[str]]:
    """In how many cells each entry is best or tied, by axis, as text."""
    by_axis = [
        {
            s.method: s.best_text
            for s in standings(rows, lambda row, axis=axis: row["axis_ranks"][axis])
        }
        for axis in AXES
    ]
    return [[s.method, s.best_text, *(axis[s.method] for axis in by_axis)] for s in standings(rows)]
