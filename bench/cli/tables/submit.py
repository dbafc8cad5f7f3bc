"""`bench submit`: the rows of a method as a folder that a pull request can carry."""

from pathlib import Path

from bench.cli.checks import check_names, check_tables
from bench.store.new_folder import check_free


def submit(directory: Path, /, *, method: str, out: Path) -> int:
    """Write the rows of your method, with where they come from, as a folder for a pull request.

    The folder holds the rows, their keys, commits and programs, the package of the method and a
    hash of its source. Rows are refused if this installation would no longer train them as they
    were: other versions, settings or source code.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/mine.
    method
        Registered name of the method.
    out
        New folder to write to, such as submissions/my_method.
    """
    check_tables(directory)
    check_names("method", [method])
    check_free(out)
    from rich.console import Console

    from bench.sharing.submission.folder import submit as submit_rows
    from bench.store.tables import Tables
    from bench.text.say import say

    count = submit_rows(Tables.load(directory), method, out)
    say(Console(), f"Submission: {out}, {count} rows. `bench verify {out}` checks it.")
    return 0
