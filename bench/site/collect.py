"""What a site is made of: the suites, documents, diagnoses and replays of two folders."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from bench.plan.suite import built_in, load_suite
from bench.store.tables import TableError, Tables
from diagnosis.result import Diagnosis

NOTES = "_notes"
"""How the names of texts end that are part of another document."""
Warn = Callable[[str], None]
"""Takes a sentence on what was left out."""


class Suite(NamedTuple):
    """A folder of tables."""

    name: str
    tables: Tables
    description: str
    """What the suite of this name asks; empty for one that is not built in."""


class Document(NamedTuple):
    """A Markdown file."""

    path: Path
    text: str
    title: str
    place: str
    """Its page, below `documents/` and without ending."""


class Found(NamedTuple):
    """A diagnosis."""

    diagnosis: Diagnosis
    place: str
    """Its page, below `diagnoses/` and without ending."""


def suites(results: Path, warn: Warn) -> list[Suite]:
    """Tables of every folder of `results` that holds some, built-in suites first.

    Those that cannot be read are named.
    """
    found, order = [], built_in()
    names = {file.parent.name for file in results.glob("*/runs.parquet")}
    for name in sorted(names, key=lambda name: (name not in order, name != "paper", name)):
        try:
            tables = Tables.load(results / name)
        except TableError as error:
            warn(f"Left out: {error}")
            continue
        description = load_suite(name).description if name in order else ""
        found.append(Suite(name, tables, description))
    return found


def documents(results: Path, reports: Path, warn: Warn) -> list[Document]:
    """Markdown files of both folders, but for notes and boards, which are parts of other pages.

    Those that cannot be read are named.
    """
    found: list[Document] = []
    for root in (reports, results):
        for path in sorted(root.rglob("*.md")):
            if path.stem.endswith(NOTES) or path.name in ("leaderboard.md", "diagnosis.md"):
                continue
            try:
                text = path.read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError) as error:
                warn(f"Left out: {path} cannot be read: {error}")
                continue
            below = path.relative_to(root).with_suffix("")
            place = _free("-".join(below.parts), [document.place for document in found])
            found.append(Document(path, text, _title(path, text), place))
    return found


def diagnoses(results: Path, reports: Path, warn: Warn) -> list[Found]:
    """Every diagnosis.json of both folders; those that cannot be read are named."""
    found: list[Found] = []
    for root in (reports, results):
        for path in sorted(root.rglob("diagnosis.json")):
            try:
                diagnosis = Diagnosis.load(path)
            except ValueError as error:
                warn(f"Left out: {error}")
                continue
            place = "-".join(path.parent.relative_to(root).parts) or "here"
            found.append(Found(diagnosis, _free(place, [one.place for one in found])))
    return found


def replays(reports: Path) -> list[Path]:
    """Pages that `bench replay` wrote."""
    return sorted(reports.glob("*/replays/*.html"))


def _free(place: str, taken: Sequence[str]) -> str:
    """That place, or one with a number where another page has it."""
    places = (place, *(f"{place}-{number}" for number in range(2, len(taken) + 2)))
    return next(free for free in places if free not in taken)


def _title(path: Path, text: str) -> str:
    """The first heading."""
    found = re.search("^# (.*)", text, re.MULTILINE)
    return found[1].replace("`", "").strip() if found else path.stem
