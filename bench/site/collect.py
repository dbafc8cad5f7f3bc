"""What a site is made of: the suites, documents, diagnoses and replays of two folders."""

import tomllib
from collections.abc import Callable
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


def documents(results: Path, reports: Path) -> list[Document]:
    """Markdown files of both folders, but for notes and boards, which are parts of other pages."""
    found = []
    for root in (reports, results):
        for path in sorted(root.rglob("*.md")):
            below = path.relative_to(root).with_suffix("")
            if path.stem.endswith(NOTES) or path.name in ("leaderboard.md", "diagnosis.md"):
                continue
            found.append(Document(path, _title(path), "-".join(below.parts)))
    return found


def diagnoses(results: Path, reports: Path, warn: Warn) -> list[Found]:
    """Every diagnosis.json of both folders; those that cannot be read are named."""
    found = []
    for root in (reports, results):
        for path in sorted(root.rglob("diagnosis.json")):
            try:
                diagnosis = Diagnosis.load(path)
            except ValueError as error:
                warn(f"Left out: {error}")
                continue
            found.append(Found(diagnosis, "-".join(path.parent.relative_to(root).parts) or "here"))
    return found


def replays(reports: Path) -> list[Path]:
    """Pages that `bench replay` wrote."""
    return sorted(reports.glob("*/replays/*.html"))


def _description(name: str) -> str:
    path = BUILT_IN / f"{name}.toml"
    if not path.is_file():
        return ""
    return str(tomllib.loads(path.read_text(encoding="utf-8")).get("description", ""))


def _title(path: Path) -> str:
    """The first heading."""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("# "):
            return line.removeprefix("# ").replace("`", "").strip()
    return path.stem
