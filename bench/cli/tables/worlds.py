"""`bench worlds`: methods against worlds, from the tables of one or several suites."""

from pathlib import Path
from typing import Annotated

import cyclopts

from bench.cli.checks import check_tables
from bench.text.errors import UsageError


def worlds(
    directories: Annotated[list[Path], cyclopts.Parameter(negative=())],
    /,
    *,
    out: Path | None = None,
    notes: Path | None = None,
) -> int:
    """Write the page of worlds: which methods hold up where, and which claims hold there.

    Parameters
    ----------
    directories
        Folders with results.parquet and its companions, such as results/paper results/field.
    out
        Markdown file to write, with HTML beside it; default: reports/worlds.md.
    notes
        Markdown file to append, such as reports/worlds_notes.md.
    """
    check_tables(*directories)
    path = out or Path("reports") / "worlds.md"
    if path.suffix == ".html":
        raise UsageError(f"Markdown is written to {path} and HTML beside it: name the former.")
    from bench.paper.worlds_page import write_worlds_page
    from bench.store.tables import Tables

    write_worlds_page([Tables.load(directory) for directory in directories], path, notes)
    print(f"Worlds: {path}")  # noqa: T201
    return 0
