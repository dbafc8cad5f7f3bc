"""A sweep from beginning to end: execute what is missing, then tables and documents."""

import os
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.execute import execute
from bench.leaderboard import COLUMNS, leaderboard_rows, write_leaderboard
from bench.plan import Plan, Run
from bench.progress import Display
from bench.report import write_report
from bench.store import Store
from bench.tables import Tables

WIDE = 150
"""Width of a terminal that has room for the whole leaderboard [characters]."""
NARROW = {
    "method": "method",
    "reward (n)": "reward (n)",
    "position error [m]": "error [m]",
    "crashes per episode": "crashes",
    "HF fleet-minutes": "HF fleet min",
    "HF training crashes": "HF train crashes",
    "runs": "runs",
}
"""Columns that a narrower terminal shows, with the headings there."""


def sweep(plan: Plan, tables_dir: Path, documents_dir: Path, jobs: int | None) -> int:
    """Exit status: 0, 1 if anything failed or was left out, 130 after Ctrl-C.

    Args:
        plan: What should be there in the end.
        tables_dir: Folder of the tables and of `runs/`.
        documents_dir: Folder of the leaderboard and the report.
        jobs: Number of worker processes; None: one per core.
    """
    console, errors = Console(), Console(stderr=True)
    store = Store(tables_dir)
    with store.lock(lambda: _say(errors, f"Waiting: another run is working in {tables_dir}.")):
        store.tidy()
        sound = store.sound(lambda text: _say(errors, f"Warning: {text}"))
        done = [r for r in plan.runs if sound.get(r.name, {}).get("status", "failed") != "failed"]
        missing = [run for run in plan.runs if run not in done]
        for text in (*_stale(done, sound), *(f"Left out: {line}" for line in plan.broken)):
            _say(errors, f"Warning: {text}")
        jobs = min(jobs or _cores(), max(1, len(missing)))
        _say(console, _announcement(len(done), len(missing), jobs))
        display = Display(missing, console)
        try:
            with display:
                status = execute(missing, store, jobs, display, [run.name for run in done])
        except KeyboardInterrupt:
            kept = len(done) + display.kept
            _say(
                errors,
                f"Interrupted: {kept} of {len(plan.runs)} runs are finished and kept. Give the "
                "same command again to go on.",
            )
            return 130
        tables = store.tables(
            store.sound(lambda text: _say(errors, f"Warning: {text}")),
            {run.name for run in plan.runs},
        )
        tables.save(tables_dir)
    rebuild_report(tables, documents_dir, console)
    rebuild_leaderboard(tables, documents_dir, console)
    _say(console, f"Tables: {tables_dir}")
    failed = [run for run in missing if status[run.name] == "failed"]
    if failed:
        causes = tables.runs.set_index("run")["cause"]
        first = f"{failed[0].label}: {causes.get(failed[0].name, '')}"
        _say(errors, f"{len(failed)} of {len(plan.runs)} runs failed; the first: {first}")
    return 1 if failed or plan.broken else 0


def rebuild_leaderboard(tables: Tables, directory: Path, console: Console) -> None:
    """Writes leaderboard.md into a folder and shows the leaderboard on `console`."""
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / "leaderboard.md"
    write_leaderboard(tables, path)
    show(tables, console)
    _say(console, f"Leaderboard: {path}")


def rebuild_report(tables: Tables, directory: Path, console: Console) -> None:
    """Writes report.html into a folder."""
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / "report.html"
    write_report(tables, path)
    _say(console, f"Report: {path}")


def show(tables: Tables, console: Console) -> None:
    """Prints the leaderboard, a table a cell; on a narrow terminal without some columns."""
    rows = leaderboard_rows(tables)
    heads = {c.heading: c.heading for c in COLUMNS} if console.width >= WIDE else NARROW
    columns = [column for column in COLUMNS if column.heading in heads]
    for cell in dict.fromkeys(row["cell"] for row in rows):
        table = Table(
            title=Text(cell.label, "bold"),
            title_justify="left",
            box=SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
            show_edge=False,
        )
        for column in columns:
            words = [*heads[column.heading].split()]
            if column.heading == "method":
                words += [row["entry"].method for row in rows]
            table.add_column(
                heads[column.heading],
                overflow="fold",
                justify="left" if column.heading in ("method", "runs") else "right",
                no_wrap=column.heading == "reward (n)",
                min_width=max(map(len, words)) + (column.heading == "method"),
            )
        for row in rows:
            if row["cell"] == cell:
                style = "bold" if row["best"] else ""
                table.add_row(*(Text(column.text(row), style) for column in columns))
        console.print(table)


def _stale(done: list[Run], sound: dict[str, dict]) -> list[str]:
    """A line for each plug-in whose source, not version, changed since a run was stored."""
    changed: dict[str, int] = {}
    for run in done:
        for plugin, source in run.sources.items():
            if sound[run.name]["sources"].get(plugin, source) != source:
                changed[plugin] = changed.get(plugin, 0) + 1
    return [
        f"the source of {plugin} has changed but its version has not; {count} stored runs are "
        "used as they are. Change its `version` to run them again."
        for plugin, count in sorted(changed.items())
    ]


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS


def _announcement(n_done: int, n_missing: int, jobs: int) -> str:
    to_do = f"{n_missing}, on {jobs} worker{'s' * (jobs > 1)}" if n_missing else "nothing"
    return f"Runs finished already: {n_done} of {n_done + n_missing}. To do: {to_do}."


def _say(console: Console, text: str) -> None:
    """Prints one line as it is."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)
