"""The board of a page: one table of all cells, and one of other settings, for DataTables.

A column in which no row has anything is left out.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bench.report.leaderboard import MAIN, Column, filled, split
from bench.stats.leaderboard_rows import Row
from bench.stats.statistics import Cell, Entry, default_of

PLACE = (
    Column("task", lambda row: row["cell"].task, lambda row: row["cell"].task, left=True),
    Column("N", lambda row: str(row["cell"].team_size), lambda row: row["cell"].team_size),
    Column("flown in", lambda row: row["cell"].world, lambda row: row["cell"].world, left=True),
)
"""Where a row competes, before the columns of the leaderboard."""
FILTERS = ("task", "N", "flown in", "method")
"""Columns that can be filtered by."""


def boards(rows: Sequence[Row], opens: Mapping[tuple[Cell, Entry], str]) -> list[dict[str, Any]]:
    """Tables ready for the page: caption, columns, lines with the run that each opens."""
    worlds = {row["cell"].world for row in rows}
    place = [c for c in PLACE if c.heading != "flown in" or len(worlds) > 1]
    captions = ("Board", "Other settings, compared with their default")
    return [
        {
            "caption": captions[own[0]["default"] is not None],
            "columns": [
                {"heading": c.heading, "left": c.left, "main": c in place or c.heading in MAIN}
                for c in shown
            ],
            "lines": [_line(row, shown, opens) for row in own],
        }
        for columns, own in split(rows)
        for shown in [_ordered(place, filled(columns, own))]
    ]


def filters(rows: Sequence[Row]) -> list[tuple[str, list[str]]]:
    """What can be filtered by, with what there is; nothing by which all rows are the same."""
    text: dict[str, Callable[[Row], str]] = {c.heading: c.text for c in PLACE}
    text["method"] = lambda row: default_of(row["entry"]).label
    found = []
    for heading in FILTERS:
        key = (lambda x: (len(x), x)) if heading == "N" else None
        options = sorted({text[heading](row) for row in rows}, key=key)
        if len(options) > 1:
            found.append((heading, options))
    return found


def _ordered(place: Sequence[Column], columns: Sequence[Column]) -> list[Column]:
    """The method first, which stays in sight, then where it competes."""
    method = [column for column in columns if column.heading == "method"]
    return [*method, *place, *(column for column in columns if column not in method)]


def _line(
    row: Row, columns: Sequence[Column], opens: Mapping[tuple[Cell, Entry], str]
) -> dict[str, Any]:
    return {
        "best": row["best"],
        "opens": opens.get((row["cell"], row["entry"]), ""),
        "method": default_of(row["entry"]).label,
        "cells": [(column.text(row), _order(column, row)) for column in columns],
    }


def _order(column: Column, row: Row) -> str:
    """What a cell is sorted by; empty where there is nothing."""
    order = column.order(row)
    return "" if order != order else str(order)
