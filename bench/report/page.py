"""One HTML page that opens offline: leaderboards, figures, runs.

The page is a function of the tables. It loads nothing: scripts, styles and data are inside, and
its content security policy forbids the rest. Figures are drawn when they come into view, and a
click on a method or run opens its settings, metrics, training curve and flight.
"""

from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from bench.report.figures import CURVES_INTRO, Drawing, curve_drawings, styles, summary_drawings
from bench.report.leaderboard import (
    COLUMNS,
    HOW_TO_READ,
    MISSING,
    STANDING_HEADINGS,
    Column,
    Row,
    leaderboard_rows,
    standing_lines,
)
from bench.report.pooled_figures import pooled_drawings
from bench.report.pooled_text import (
    EXCLUDES_HALF,
    HOW_TO_READ_POOLED,
    improvement_headings,
    improvement_lines,
    pool_headings,
    pool_lines,
    pool_remarks,
    pool_title,
)
from bench.report.run_details import details, first_runs, run_lines, settings_groups, version_groups
from bench.report.top_view import TOP_VIEW_INTRO, trajectory_drawings
from bench.stats.pooled import Pool, pools
from bench.stats.statistics import Cell, Entry
from bench.store.tables import Tables
from bench.text.pages import environment, harmless_json, write_text


def write_report(tables: Tables, path: Path, title: str = "Benchmark report") -> None:
    """Writes the report as one HTML file to `path`."""
    rows, lines = leaderboard_rows(tables), run_lines(tables)
    settings, versions = settings_groups(tables.runs), version_groups(tables.runs)
    sections = [
        ("Cost and reward", "", summary_drawings(tables)),
        ("Training curves", CURVES_INTRO, curve_drawings(tables)),
        ("Flown paths", TOP_VIEW_INTRO, trajectory_drawings(tables)),
    ]
    pooled = [_pooled(tables, pool) for pool in pools(tables)]
    opened = details(tables, lines, settings, versions)
    drawn = any(drawings for *_, drawings in sections) or any(run["curve"] for run in opened)
    page = environment().get_template("report.html.j2")
    text = page.render(
        title=title,
        plotly=plotly_source() if drawn or pooled else "",
        how_to_read=[render_markdown(line, inline=True) for line in HOW_TO_READ],
        counts=_counts(tables),
        how_to_read_pooled=HOW_TO_READ_POOLED,
        pools=pooled,
        standing_headings=STANDING_HEADINGS,
        standings=standing_lines(rows),
        boards=_boards(rows, first_runs(tables, lines)),
        sections=[
            (name, intro, [(d, _figure_json(d)) for d in drawings])
            for name, intro, drawings in sections
        ],
        runs=lines,
        settings=settings,
        versions=versions,
        details=opened,
    )
    write_text(path, text)


def write_page(markdown_text: str, path: Path, title: str) -> None:
    """Writes a Markdown text as an HTML page in the style of the report."""
    page = environment().get_template("page.html.j2")
    write_text(path, page.render(title=title, body=render_markdown(markdown_text)))


def render_markdown(text: str, inline: bool = False) -> Markup:
    """Markdown as HTML; HTML in `text` is shown, never interpreted."""
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    return Markup(parser.renderInline(text) if inline else parser.render(text))


def plotly_source() -> Markup:
    """The plotting library, for a script element."""
    return Markup(get_plotlyjs().replace("</script", "<\\/script"))


def _figure_json(drawing: Drawing) -> Markup:
    return harmless_json(str(drawing.plot.to_json()))


def _pooled(tables: Tables, pool: Pool) -> dict[str, Any]:
    """One pool: its tables, figures and remarks."""
    return {
        "title": pool_title(pool),
        "tables": [
            ("Scores and ranks", pool_headings(pool), pool_lines(pool)),
            ("Who beats whom", improvement_headings(pool), improvement_lines(pool)),
        ],
        "remarks": [EXCLUDES_HALF, *pool_remarks(pool)],
        "figures": [(d, _figure_json(d)) for d in pooled_drawings(pool, styles(tables))],
    }


def _boards(rows: list[Row], opens: dict[tuple[Cell, Entry], str]) -> list[dict[str, Any]]:
    """One table per cell: its label, and lines of (text, value to sort by) with the run to open."""
    return [
        {
            "label": cell.label,
            "headings": [column.heading for column in COLUMNS],
            "lines": [
                {
                    "best": row["best"],
                    "opens": opens.get((cell, row["entry"]), ""),
                    "cells": [_sortable(column, row) for column in COLUMNS],
                }
                for row in rows
                if row["cell"] == cell
            ],
        }
        for cell in dict.fromkeys(row["cell"] for row in rows)
    ]


def _sortable(column: Column, row: Row) -> tuple[str, str]:
    order = column.order(row)
    return column.text(row), "" if order != order else str(order)


def _counts(tables: Tables) -> list[tuple[str, str]]:
    runs = tables.runs
    by_status = runs["status"].value_counts().sort_index()
    return [
        ("runs", str(len(runs))),
        ("tasks", ", ".join(sorted(runs["task"].unique())) or MISSING),
        ("team sizes", ", ".join(str(n) for n in sorted(runs["team_size"].unique())) or MISSING),
        ("seeds", str(runs["seed"].nunique())),
        ("status", ", ".join(f"{count} {name}" for name, count in by_status.items()) or MISSING),
    ]
