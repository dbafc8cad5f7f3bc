"""`bench export`: rows and learning curves in the formats of other tools."""

from pathlib import Path

from bench.cli.checks import check_tables
from bench.sharing.export.formats import FORMATS, Name, check_available
from bench.sharing.export.formats import export as export_tables
from bench.store.new_folder import check_free


def export(directory: Path, /, *, to: Name, out: Path) -> int:
    """Write rows and learning curves in the format of another tool.

    The tools' own libraries are extras, such as fidelity-bench[mlflow]; marl-eval and huggingface
    need none. Nothing is uploaded.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/quick.
    to
        The format: event files of TensorBoard, a database of MLflow, offline runs of Weights &
        Biases, MARL-eval's JSON, a Croissant description, or a data set of the Hugging Face Hub.
    out
        New folder to write to.
    """
    check_tables(directory)
    check_free(out)
    check_available(to)
    from rich.console import Console

    from bench.store.tables import Tables
    from bench.text.say import say

    console = Console()
    tables, title = Tables.load(directory), directory.resolve().name
    for text in export_tables(tables, title, to, out):
        say(console, f"Left out: {text}")
    if not len(tables.curves):
        say(console, f"{directory} keeps no learning curves; only final values were exported.")
    say(console, f"Exported: {out}. {FORMATS[to].opens.format(out)}")
    return 0
