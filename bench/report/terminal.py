"""Leaderboards and reports written into a folder, and leaderboards shown on a terminal."""

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.report.leaderboard import MAIN, filled, leaderboard_rows, split, write_leaderboard
from bench.report.page import write_report
from bench.store.tables import Tables
from bench.text.say import say

WIDE = 150
"""Width of a terminal that has room for all columns that a page shows first [characters]."""
NARROW = {
    "rank": "rank",
    "method": "method",
    "settled reward (n)": "settled reward (n)",
    "crashes per episode": "crashes",
    "HF fleet-minutes": "HF min",
    "runs": "runs",
}
"""Columns that a narrower terminal shows, with the headings there."""


def rebuild_leaderboard(tables: Tables, directory: Path, console: Console) -> None:
    """Writes leaderboard.md into a folder and shows the leaderboard on `console`."""
    path = directory / "leaderboard.md"
    write_leaderboard(tables, path)
    show(tables, console)
    say(console, f"Leaderboard: {path}")


def rebuild_report(tables: Tables, directory: Path, console: Console) -> None:
    """Writes report.html into a folder."""
    path = directory / "report.html"
    write_report(tables, path, directory.absolute().name)
    say(console, f"Report: {path}")


def show(tables: Tables, console: Console) -> None:
    """Prints the leaderboard, a table a cell; on a narrow terminal without some columns."""
    for columns, rows in split(leaderboard_rows(tables)):
        heads = {h: h for h in (*MAIN, "runs")} if console.width >= WIDE else NARROW
        shown = [c for c in filled(columns, rows) if c.heading in heads]
        for cell in dict.fromkeys(row["cell"] for row in rows):
            table = Table(
                title=Text(cell.label, "bold"),
                title_justify="left",
                box=SIMPLE_HEAD,
                padding=(0, 1, 0, 0),
                show_edge=False,
            )
            for column in shown:
                words = [*heads[column.heading].split()]
                whole = column.heading == "settled reward (n)"
                if column.heading == "method":
                    words += [row["entry"].method for row in rows]
                    # Names that cannot be folded anyway must not be the column that is narrowed.
                    whole = max(len(column.text(row)) for row in rows) <= max(map(len, words))
                table.add_column(
                    heads[column.heading],
                    overflow="fold",
                    justify="left" if column.left else "right",
                    no_wrap=whole,
                    min_width=max(map(len, words)) + (column.heading == "method"),
                )
            for row in rows:
                if row["cell"] == cell:
                    style = "bold" if row["best"] else ""
                    table.add_row(*(Text(column.text(row), style) for column in shown))
            console.print(table)
