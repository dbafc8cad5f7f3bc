"""`bench leaderboard`: the board of a folder of tables."""

from pathlib import Path

from bench.cli.checks import check_tables


def leaderboard(directory: Path, /, *, out: Path | None = None) -> int:
    """Rebuild leaderboard.md from the tables in a folder, and show it.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/quick.
    out
        Folder to write to; default: reports/NAME for results/NAME, else DIRECTORY.
    """
    check_tables(directory)
    from rich.console import Console

    from bench.report.terminal import rebuild_leaderboard
    from bench.store.tables import Tables
    from bench.text.pages import documents_of

    rebuild_leaderboard(Tables.load(directory), out or documents_of(directory), Console())
    return 0
