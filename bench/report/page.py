"""One HTML page that opens offline: the answer, the board, figures, runs.

The page is a function of the tables. It loads nothing: scripts, styles and data are inside, and
its content security policy forbids the rest. A click on a method or run opens its settings,
metrics, training curve and flight.
"""

import base64
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from markdown_it import MarkdownIt
from markupsafe import Markup

from bench.report.answer import answer
from bench.report.board import boards, filters
from bench.report.leaderboard import HOW_TO_READ, leaderboard_rows
from bench.report.pictures.cost import cost_panels
from bench.report.pictures.curves import CURVES_INTRO, curve_panels
from bench.report.pictures.looks import Key
from bench.report.pictures.pooled import MEANS_NOTE, pooled_panels
from bench.report.pictures.summary import SUMMARY_INTRO, summary_panels
from bench.report.pictures.svg import Panel
from bench.report.pictures.top_view import TOP_VIEW_INTRO, top_views
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
from bench.stats.pooled import Pool, pools
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import MISSING
from bench.text.pages import environment, write_text

VENDOR = Path(__file__).parent / "vendor"
"""Libraries that pages bring along, as they were published."""
TABLES = ("dataTables.min.js", "dataTables.buttons.min.js")
"""DataTables and its buttons (datatables.net), which sort, filter and export tables."""


class Section(NamedTuple):
    """Figures under one heading."""

    title: str
    intro: str
    groups: list[tuple[str, list[Panel]]]
    """Panels under a heading of their own; it may be empty."""
    legend: list[Key]


def write_report(tables: Tables, path: Path, suite: str = "", home: str = "") -> None:
    """Writes the report as one HTML file to `path`.

    Args:
        tables: What it shows.
        path: File to write.
        suite: Name in its title.
        home: Address of a page that leads here; none by default.
    """
    rows, lines = leaderboard_rows(tables), run_lines(tables)
    settings, versions = settings_groups(tables.runs), version_groups(tables.runs)
    page = environment().get_template("report.html.j2")
    text = page.render(
        title=f"{suite}: which method at which cost" if suite else "Which method at which cost",
        home=home,
        facts=facts(tables),
        answer=[render_line(line) for line in answer(tables, rows)],
        cost=cost_panels(tables),
        how_to_read=[render_line(line) for line in HOW_TO_READ],
        filters=filters(rows),
        boards=boards(rows, first_runs(tables, lines)),
        how_to_read_pooled=[render_line(line) for line in HOW_TO_READ_POOLED],
        pools=[_pooled(pool, f"pool-{i}") for i, pool in enumerate(pools(tables))],
        sections=_sections(tables),
        runs=lines,
        settings=settings,
        versions=versions,
        details=details(tables, lines, settings, versions),
        libraries=[library(name) for name in TABLES] if lines else [],
    )
    write_text(path, text)


def write_both(
    path: Path,
    text: str,
    title: str,
    pictures: Iterable[Path] = (),
    pages: Iterable[Path] = (),
) -> None:
    """Writes a Markdown text, and beside it an HTML page that is complete in itself.

    Args:
        path: Markdown file to write.
        text: Its content.
        title: Of the page.
        pictures: Files in or below the folder of `path`, which the page holds itself.
        pages: Other Markdown files with HTML beside them, which the page links instead.
    """
    write_text(path, text)
    for picture in pictures:
        name = picture.relative_to(path.parent).as_posix()
        text = text.replace(f"]({name})", f"]({data_uri(picture)})")
    for page in pages:
        text = text.replace(f"]({page.name}", f"]({page.with_suffix('.html').name}")
    write_page(text, path.with_suffix(".html"), title)


def data_uri(path: Path) -> str:
    """A PNG file as a link that needs no file."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def write_page(markdown_text: str, path: Path, title: str) -> None:
    """Writes a Markdown text as an HTML page in the style of the report."""
    page = environment().get_template("page.html.j2")
    write_text(path, page.render(title=title, body=render_markdown(markdown_text), home=""))


def render_markdown(text: str) -> Markup:
    """Markdown as HTML; HTML in `text` is shown, never interpreted.

    The first heading of each text has the `id` that `markdown.anchor` makes, so that links find it.
    """
    parser = _parser()
    tokens, seen = parser.parse(text), set[str]()
    for heading, content in itertools.pairwise(tokens):
        place = markdown.anchor(content.content)
        if heading.type == "heading_open" and place not in seen:
            heading.attrSet("id", place)
            seen.add(place)
    return Markup(parser.renderer.render(tokens, parser.options, {}))


def render_line(text: str) -> Markup:
    """A line of Markdown as HTML, without a paragraph around it."""
    return Markup(_parser().renderInline(text))


def _parser() -> MarkdownIt:
    return MarkdownIt("commonmark", {"html": False}).enable("table")


def library(name: str) -> Markup:
    """A file of `VENDOR`, for a script element."""
    return Markup((VENDOR / name).read_text(encoding="utf-8").replace("</script", "<\\/script"))


def _sections(tables: Tables) -> list[Section]:
    """The other figures; none without anything to draw."""
    curves, keys = curve_panels(tables)
    grids, summary_keys = summary_panels(tables)
    found = [
        Section("Cost and reward against team size", SUMMARY_INTRO, grids, summary_keys),
        Section("Training curves", CURVES_INTRO, [("", curves)] if curves else [], keys),
        Section("Flown paths", TOP_VIEW_INTRO, top_views(tables), []),
    ]
    return [section for section in found if section.groups]


def _pooled(pool: Pool, salt: str) -> dict[str, Any]:
    """One pool: its tables, figures and remarks."""
    panels, keys = pooled_panels(pool, salt)
    return {
        "title": pool_title(pool),
        "tables": [
            ("Scores and ranks", pool_headings(pool), pool_lines(pool)),
            ("Who beats whom", improvement_headings(pool), improvement_lines(pool)),
        ],
        "remarks": [EXCLUDES_HALF, *pool_remarks(pool)],
        "figures": Section("", MEANS_NOTE, [("", panels)], keys),
    }


def facts(tables: Tables) -> list[tuple[str, str]]:
    """When, by which commits, and how much was run: name and text."""
    runs = tables.runs
    if runs.empty:
        return []
    by_status = runs["status"].value_counts().sort_index()
    dates = sorted({str(day)[:10] for day in runs["committed"]} - {""})
    commits = runs.loc[runs["commit"].ne(""), "commit"].value_counts().index.tolist()
    return [
        ("date", _ends(dates) or MISSING),
        ("commit", ", ".join(str(commit)[:10] for commit in commits) or MISSING),
        ("runs", ", ".join(f"{count} {name}" for name, count in by_status.items())),
        ("tasks", ", ".join(sorted(runs["task"].unique()))),
        ("team sizes", ", ".join(str(n) for n in sorted(runs["team_size"].unique()))),
        ("seeds", str(runs["seed"].nunique())),
    ]


def _ends(values: Sequence[str]) -> str:
    return " to ".join(dict.fromkeys([values[0], values[-1]])) if values else ""
