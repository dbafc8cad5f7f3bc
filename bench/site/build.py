"""Writes the site: an index, and one click from each number to the run behind it.

Every page is complete by itself and links to the others by relative paths, so the site opens from
a file and from a server alike.
"""

import html
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlencode

from markupsafe import Markup
from rich.console import Console

from bench.diagnosis_report import tables as diagnosis_tables
from bench.diagnosis_report.page import diagnosis_page
from bench.diagnosis_report.sentences import verdict
from bench.report.answer import answer
from bench.report.leaderboard import COLUMNS, leaderboard_rows
from bench.report.page import data_uri, facts, render_line, render_markdown, write_report
from bench.report.run_details import first_runs, run_lines
from bench.site.collect import Document, Suite, diagnoses, documents, replays, suites
from bench.stats.leaderboard_rows import best_rows
from bench.text.errors import UsageError
from bench.text.pages import environment, write_text
from bench.text.say import say

PAGES = {"worlds": "worlds_trained", "transfer": "worlds", "paper_rotorpy": "rotorpy"}
"""Suites whose page in reports/ (`make reports`) has another name."""
REWARD = next(column for column in COLUMNS if column.heading == "settled reward (n)")
"""The number that the index shows of a cell."""


def build_site(results: Path, reports: Path, out: Path, console: Console) -> Path:
    """The index of the site that was written to the folder `out`.

    Raises:
        UsageError: There is nothing to show, or `out` is one of the two folders.
    """
    if out.resolve() in (results.resolve(), reports.resolve()):
        raise UsageError(f"The site needs a folder of its own, got {out}.")
    warn = lambda text: say(console, f"Warning: {text}")  # noqa: E731
    found, texts = suites(results, warn), documents(results, reports, warn)
    diagnosed = diagnoses(results, reports, warn)
    if not (found or texts or diagnosed):
        raise UsageError(
            f"Neither {results} nor {reports} holds tables, documents or diagnoses. Name their "
            "folders with --results and --reports."
        )
    pages = {document.path.resolve(): document.place for document in texts}
    for document in texts:
        _write_document(document, pages, out)
    for one in diagnosed:
        write_text(out / "diagnoses" / f"{one.place}.html", diagnosis_page(one.diagnosis))
    copied = []
    for path in replays(reports):
        place = Path("replays") / path.parents[1].name / path.name
        (out / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, out / place)
        copied.append((path.stem, str(place)))
    own = {_page_of(suite) for suite in found}
    index = environment().get_template("site.html.j2")
    text = index.render(
        title="What was measured",
        suites=[_suite(suite, texts, out) for suite in found],
        documents=[document for document in texts if document.place not in own],
        diagnoses=[
            (diagnosis_tables.title(one.diagnosis), verdict(one.diagnosis), one.place)
            for one in diagnosed
        ],
        replays=copied,
    )
    write_text(out / "index.html", text)
    return out / "index.html"


def _suite(suite: Suite, texts: list[Document], out: Path) -> dict[str, Any]:
    """Writes the report of a suite; what the index says of it."""
    place = f"suites/{suite.name}.html"
    write_report(suite.tables, out / place, suite.name, home="../index.html")
    rows = leaderboard_rows(suite.tables)
    opens = first_runs(suite.tables, run_lines(suite.tables))
    return {
        "name": suite.name,
        "description": suite.description,
        "report": place,
        "claims": next((d for d in texts if d.place == _page_of(suite)), None),
        "facts": facts(suite.tables),
        "answer": [render_line(line) for line in answer(suite.tables, rows)],
        "cells": [
            {
                "cell": cell.label,
                "board": f"{place}#{urlencode({'task': cell.task, 'N': cell.team_size})}",
                "method": row["method"],
                "reward": REWARD.text(row),
                "run": f"{place}#{opens[cell, row['entry']]}",
            }
            for cell, row in best_rows(rows).items()
        ],
    }


def _page_of(suite: Suite) -> str:
    """The place of the document that is about a suite."""
    return PAGES.get(suite.name, suite.name)


def _written(address: str) -> str:
    """A file's name as it is, from an address in HTML."""
    return unquote(html.unescape(address))


def _write_document(document: Document, pages: Mapping[Path, str], out: Path) -> None:
    """A Markdown file as a page, with its pictures inside."""
    body = str(render_markdown(document.text))

    def picture(match: re.Match[str]) -> str:
        path = document.path.parent / _written(match[1])
        return f'src="{data_uri(path)}"' if path.is_file() else match[0]

    def link(match: re.Match[str]) -> str:
        """To another page of the site; whatever is not part of it is no link any more."""
        if re.match(r"[a-z]+:|#", match[1]):
            return match[0]
        name, _, part = match[1].partition("#")
        place = pages.get((document.path.parent / _written(name)).resolve())
        return f'href="{place}.html{"#" if part else ""}{part}"' if place else ""

    body = re.sub(r'(?<=<img )src="([^"]+)"', picture, body)
    body = re.sub(r'(?<=<a )href="([^"]+)"', link, body)
    page = environment().get_template("page.html.j2")
    text = page.render(title=document.title, body=Markup(body), home="../index.html")
    write_text(out / "documents" / f"{document.place}.html", text)
