"""Checks a submission: its files, its rows, and one seed that is trained again."""

import math
import secrets
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.execution.sweep import sweep
from bench.sharing.submission.agreement import Agreement, agreement, worst
from bench.sharing.submission.folder import load, simulator_of
from bench.sharing.submission.planned_row import other_key, planned
from bench.stats.statistics import cell_of, entry_of, home_of, records, seed_values
from bench.store.tables import Tables
from bench.text.errors import UsageError
from bench.text.numbers import significant
from bench.text.say import say

STATUSES = {"match": 0, "differs": 3, "cannot tell": 4}
"""Exit status of each outcome; 1 and 130 are those of a training that failed or was interrupted."""
COMPARED = {"settled_reward": "spawn_settled_reward", "fleet_minutes": ""}
"""Metrics that must agree, what a policy is worth and what it cost, each with the metric that says
what a team gets that does nothing; empty for none."""

Row = Mapping[str, Any]


def verify(
    folder: Path,
    console: Console,
    *,
    task: str = "",
    team_size: int | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    out: Path | None = None,
) -> int:
    """Exit status: 0 the row matches, 3 it differs, 4 nothing can be told, 1 the training failed.

    Options as in `bench verify`.

    Raises:
        UsageError: The folder is no sound submission, or has no such row.
    """
    record, tables = load(folder)
    counted = f"{len(tables.runs)} rows of '{record['method']}', from {record['package']}"
    say(console, f"Files and rows are sound: {counted}.")
    row = _chosen(tables, task, team_size, seed, out)
    if out is not None:
        _check_place(out, folder, row)
    simulators, home = simulator_of(tables), home_of(tables)
    strange = [x["run"] for x in records(tables.runs) if _other(x, simulators.get(x["run"], home))]
    if strange:
        say(console, f"Other runs in this installation, and so not checked: {len(strange)} rows.")
    plan, run = planned(row, simulators[row["run"]])
    if text := other_key(row, run):
        say(console, f"Cannot tell: {text} Nothing was trained.")
        return STATUSES["cannot tell"]
    if run.program != row["program"]:
        say(console, "The source code here is not that of the row; its versions are the same.")
    say(console, f"Training again: {run.label}, {len(plan.runs)} training(s).")
    with tempfile.TemporaryDirectory(prefix="bench-verify-") as temporary:
        place = out or Path(temporary)
        if status := sweep(plan, place, place, jobs):
            if out is None:
                say(console, "What it wrote is removed; --out FOLDER keeps it.")
            return status
        again = Tables.load(place).metrics(run.name)
    if out is None:
        say(console, "What was trained is removed again; --out FOLDER keeps it.")
    outcome = _say_comparison(tables, row, again, console)
    say(console, f"{row['run']}: {outcome}.")
    return STATUSES[outcome]


def _say_comparison(tables: Tables, row: Row, again: Mapping[str, float], console: Console) -> str:
    """Says of each metric whether the row was reproduced; the worst outcome."""
    found = []
    for metric, idle in COMPARED.items():
        one = _compared(tables, row, metric, again[metric], again.get(idle, math.nan))
        found.append(one)
        values = (significant(again[metric], 4), significant(tables.metrics(row["run"])[metric], 4))
        said = "{} here, {} submitted".format(*values)
        say(console, f"{metric}: {said}: {one.outcome}, {one.reason}.")
    return worst(found)


def _compared(tables: Tables, row: Row, metric: str, again: float, idle: float) -> Agreement:
    """A metric of the row that was trained again, against the seeds of its cell."""
    results = records(tables.results.loc[tables.results["run"].eq(row["run"])].head(1))
    by_seed = seed_values(tables.results, metric)[cell_of(results[0])].get(entry_of(row), {})
    if row["seed"] not in by_seed:
        return Agreement("cannot tell", "the row holds no number that could be compared")
    return agreement(again, by_seed[row["seed"]], list(by_seed.values()), idle)


def _other(row: Row, simulator: str) -> str:
    return other_key(row, planned(row, simulator)[1])


def _check_place(out: Path, folder: Path, row: Row) -> None:
    """Raises UsageError if a folder holds the row itself, which would be compared with itself."""
    own = out.resolve() == folder.resolve()
    if not own and (out / "runs.parquet").is_file():
        rows = records(Tables.load(out).runs)
        own = any((x["run"], x["committed"]) == (row["run"], row["committed"]) for x in rows)
    if own:
        raise UsageError(f"{out} holds the submitted row itself. Give --out another folder.")


def _chosen(
    tables: Tables, task: str, team_size: int | None, seed: int | None, out: Path | None
) -> Row:
    """The row to train again: of the smallest team that is meant, one at random.

    Nothing that was submitted says which. A row that a folder `out` was begun with is kept to.
    """
    meant = [
        row
        for row in records(tables.runs)
        if row["status"] != "failed"
        and task in ("", row["task"])
        and team_size in (None, row["team_size"])
        and seed in (None, row["seed"])
    ]
    if not meant:
        have = "; ".join(
            f"{row['task']}, N = {row['team_size']}, seed {row['seed']}"
            for row in records(tables.runs)
            if row["status"] != "failed"
        )
        raise UsageError(f"No row that left a policy is meant. The submission has: {have}.")
    begun = {path.name for path in (out / "runs").glob("*")} if out is not None else set()
    smallest = min(row["team_size"] for row in meant)
    among = [row for row in meant if row["team_size"] == smallest]
    return secrets.choice([row for row in meant if row["run"] in begun] or among)
