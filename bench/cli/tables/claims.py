"""`bench claims`: the paper's claims beside the tables of one or several suites."""

import functools
from pathlib import Path
from typing import Annotated

import cyclopts

from bench.cli.checks import check_files, check_tables


def claims(
    directories: Annotated[list[Path], cyclopts.Parameter(negative=())],
    /,
    *,
    out: Path | None = None,
    notes: Path | None = None,
) -> int:
    """Judge the paper's claims by the tables of suites; write answers and what they rest on.

    Parameters
    ----------
    directories
        Folders with results.parquet and its companions, such as results/paper results/off_spec.
        Of a run in several, the row of the first counts.
    out
        Markdown file to write; default: reports/NAME.md if the first folder is results/NAME, else
        claims.md in it. The tables of all cells are written beside it, as NAME_cells.md.
    notes
        Markdown file that says why, such as reports/paper_notes.md: it becomes the page
        NAME_why.md, and the answers list its headings.
    """
    check_tables(*directories)
    check_files([notes] if notes else [])
    from bench.paper.page import write_claims
    from bench.store.tables import Tables
    from bench.text.pages import documents_of

    first = directories[0]
    documents = documents_of(first)
    default = first / "claims.md" if documents == first else documents.with_suffix(".md")
    path = out or default
    tables = functools.reduce(Tables.merged, map(Tables.load, directories))
    names = ("Claims", "Cell by cell", "Why")
    for name, written in zip(names, write_claims(tables, path, notes), strict=False):
        print(f"{name}: {written}")  # noqa: T201
    return 0
