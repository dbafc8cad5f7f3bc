"""`bench compare`: whether one method is better than another."""

from pathlib import Path

from bench.cli.checks import check_tables


def compare(a: str, b: str, /, *, results: Path | None = None) -> int:
    """Say whether A is better than B, in words and by the exit status.

    0: A is better. 3: A is worse. 4: no difference can be shown. 5: A and B cannot be compared.

    Parameters
    ----------
    a
        METHOD of --results, such as hybrid-mlp; FOLDER:METHOD; or FOLDER, for all its methods.
    b
        What to compare it with, written likewise.
    results
        Folder with results.parquet and its companions, such as results/paper.
    """
    if results is not None:
        check_tables(results)
    from rich.console import Console

    from bench.stats.compare import load_side, report

    return report(load_side(a, results), load_side(b, results), Console())
