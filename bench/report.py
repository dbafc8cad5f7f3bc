"""One HTML page that opens offline: leaderboards, figures, runs.

The page is a function of the tables. It loads nothing: scripts, styles and data are inside, and
its content security policy forbids the rest. Figures are drawn when they come into view.
"""

import functools
import json
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from markdown_it import MarkdownIt
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from bench.figures import CURVES_INTRO, Drawing, curve_drawings, summary_drawings
from bench.leaderboard import (
    COLUMNS,
    HOW_TO_READ,
    MISSING,
    STANDING_HEADINGS,
    Column,
    Row,
    leaderboard_rows,
    number,
    standing_lines,
)
from bench.statistics import COUNTED, entry_of, records
from bench.tables import Tables
from bench.top_view import TOP_VIEW_INTRO, trajectory_drawings


def write_report(tables: Tables, path: Path, title: str = "Benchmark report") -> None:
    """Writes the report as one HTML file to `path`."""
    rows = leaderboard_rows(tables)
    sections = [
        ("Cost and reward", "", summary_drawings(tables)),
        ("Training curves", CURVES_INTRO, curve_drawings(tables)),
        ("Flown paths", TOP_VIEW_INTRO, trajectory_drawings(tables)),
    ]
    page = _environment().get_template("report.html.j2")
    text = page.render(
        title=title,
        plotly=Markup(_script_safe(get_plotlyjs()))
        if any(drawings for *_, drawings in sections)
        else "",
        how_to_read=[render_markdown(line, inline=True) for line in HOW_TO_READ],
        counts=_counts(tables),
        standing_headings=STANDING_HEADINGS,
        standings=standing_lines(rows),
        boards=_boards(rows),
        sections=sections,
        runs=_runs(tables),
        settings=_settings(tables.runs),
        versions=_versions(tables.runs),
    )
    _write(path, text)


def write_page(markdown_text: str, path: Path, title: str) -> None:
    """Writes a Markdown text as an HTML page in the style of the report."""
    page = _environment().get_template("page.html.j2")
    _write(path, page.render(title=title, body=render_markdown(markdown_text)))


def render_markdown(text: str, inline: bool = False) -> Markup:
    """Markdown as HTML; HTML in `text` is shown, never interpreted."""
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    return Markup(parser.renderInline(text) if inline else parser.render(text))


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure_json"] = _figure_json
    return environment


def _write(path: Path, text: str) -> None:
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _figure_json(drawing: Drawing) -> Markup:
    return Markup(str(drawing.plot.to_json()).replace("<", "\\u003c"))


def _script_safe(source: str) -> str:
    return source.replace("</script", "<\\/script")


def _boards(rows: list[Row]) -> list[dict[str, Any]]:
    """One table per cell: its label, and lines of (text, value to sort by)."""
    return [
        {
            "label": cell.label,
            "headings": [column.heading for column in COLUMNS],
            "lines": [
                {"best": row["best"], "cells": [_sortable(column, row) for column in COLUMNS]}
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


def _runs(tables: Tables) -> list[dict[str, Any]]:
    """Every run, those that were lost first."""
    rewards = tables.results[tables.results["metric"] == "reward"]
    reward = dict(zip(rewards["run"], rewards["value"], strict=True))
    found = [
        {
            "run": row["run"],
            "method": entry_of(row).label,
            "task": row["task"],
            "team_size": row["team_size"],
            "seed": row["seed"],
            "status": row["status"],
            "lost": row["status"] not in COUNTED,
            "cause": row["cause"],
            "reward": number(reward.get(row["run"], float("nan")), 1),
        }
        for row in records(tables.runs)
    ]
    keys = ("task", "team_size", "method", "seed")
    return sorted(found, key=lambda run: (not run["lost"], *(run[key] for key in keys)))


def _settings(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """What ran with which settings; seeds that share them stand together."""
    seeds: dict[tuple[str, int, str, str], list[int]] = {}
    for row in records(runs):
        key = (row["task"], row["team_size"], entry_of(row).label, row["settings"])
        seeds.setdefault(key, []).append(row["seed"])
    return [
        {
            "method": method,
            "task": task,
            "team_size": team_size,
            "seeds": ", ".join(map(str, sorted(own))),
            "settings": _pretty(text),
        }
        for (task, team_size, method, text), own in sorted(seeds.items())
    ]


def _versions(runs: pd.DataFrame) -> list[tuple[int, str]]:
    """The distinct sets of versions, with the number of runs that had each."""
    return [(int(n), _pretty(str(text))) for text, n in runs["versions"].value_counts().items()]


def _pretty(text: str) -> str:
    """Indented JSON; a record that is no JSON is shown as it is."""
    try:
        return json.dumps(json.loads(text), indent=1, ensure_ascii=False)
    except json.JSONDecodeError:
        return text
