"""`bench claims`: the paper's claims beside a folder of tables."""

from pathlib import Path
from typing import Annotated

import cyclopts

from bench.cli.checks import check_files, check_tables

NOTES = "Markdown file to append, such as reports/paper_notes.md."
"""Help of `--notes`: a docstring has no parameter of that name, only a section."""


def claims(
    directory: Path,
    /,
    *,
    out: Path | None = None,
    notes: Annotated[Path | None, cyclopts.Parameter(help=NOTES)] = None,
) -> int:
    """Judge the paper's claims by the tables in a folder; write Markdown and HTML.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/paper.
    out
        Markdown file to write; default: reports/NAME.md for results/NAME, else claims.md in
        DIRECTORY.
    """
    check_tables(directory)
    check_files([notes] if notes else [])
    from bench.paper.page import write_claims
    from bench.store.tables import Tables
    from bench.text.pages import documents_of

    documents = documents_of(directory)
    default = directory / "claims.md" if documents == directory else documents.with_suffix(".md")
    path = out or default
    write_claims(Tables.load(directory), path, notes)
    print(f"Claims: {path}")  # noqa: T201
    return 0
