"""What a site is made of: the suites, documents, diagnoses and replays of two folders."""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from bench.plan.suite import BUILT_IN, built_in
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
    files = {file.parent.name: file for file in results.glob("*/runs.parquet")}
    for _, file in sorted(files.items(), key=lambda x: (x[0] not in order, x[0] != "paper", x[0])):
        try:
            tables = Tables.load(file.parent)
        except TableError as error:
            warn(f"Left out: {error}")
            continue
        found.append(Suite(file.parent.name, tables, _description(file.parent.name)))
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


def _description(name: str) -> str:
    path = BUILT_IN / f"{name}.toml"
    if not path.is_file():
        return ""
    return str(tomllib.loads(path.read_text(encoding="utf-8")).get("description", ""))


def _free(place: str, taken: Sequence[str]) -> str:
    """That place, or one with a number where another page has it."""
    places = (place, *(f"{place}-{number}" for number in range(2, len(taken) + 2)))
    return next(free for free in places if free not in taken)


def _title(path: Path, text: str) -> str:
    """The first heading."""
    for line in text.splitlines():
        if line.startswith("# "):
            return line.removeprefix("# ").replace("`", "").strip()
    return path.stem
