"""The folder of a submission: rows, where they come from, and what a reader sees first.

submission.json     method, its package and source, the program, checksums of the tables
results.parquet     rows of the method, as `bench run` left them
runs.parquet
curves.parquet      where the tables have them
README.md           the rows in words, and how to check them
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

from bench.plan.expansion import packages
from bench.plan.provenance import processor
from bench.sharing.submission.planned_row import other_key, planned
from bench.stats.statistics import Entry, estimate, home_of, records, seed_values
from bench.store.new_folder import new_folder
from bench.store.record import checksum, to_json
from bench.store.tables import IDENTITY, SCHEMAS, Tables
from bench.text.errors import UsageError
from bench.text.markdown import escape, table
from bench.text.numbers import mean_std, significant
from simulators import registry

SCHEMA = 1
"""Version of submission.json."""
RECORD = "submission.json"
"""Name of the file that describes the rest."""
TABLES = ("results", "runs", "curves")
"""Tables that a submission carries; trajectories are large and follow from the policy."""


def submit(tables: Tables, method: str, out: Path) -> int:
    """Writes the rows of a method into a new folder; returns their number.

    Raises:
        UsageError: There are none, or this installation would not train them as they were.
    """
    own = of_method(tables, method)
    rows = records(own.runs)
    if not rows:
        known = ", ".join(sorted({*tables.runs["method"]}))
        raise UsageError(f"The tables hold no row of '{method}'. They have: {known}.")
    sources: dict[str, str] = {}
    simulators, home = simulator_of(own), home_of(own)
    for row in rows:
        _, run = planned(row, simulators.get(row["run"], home))
        if text := other_key(row, run):
            raise UsageError(f"{text} Nothing was written.")
        if run.program != row["program"]:
            raise UsageError(
                f"The source code has changed since {row['run']} was trained. Train the rows again "
                "with `bench run --replace`, so that they can be checked."
            )
        sources |= run.sources
    with new_folder(out) as part:
        own.save(part)
        for name in SCHEMAS:
            if name not in TABLES or not len(getattr(own, name)):
                (part / f"{name}.parquet").unlink()
        (part / RECORD).write_bytes(to_json(_record(method, own, sources, part)))
        (part / "README.md").write_text(_readme(method, own), encoding="utf-8")
    return len(rows)


def of_method(tables: Tables, method: str) -> Tables:
    """The rows of one method; no trajectories."""
    own = tables.of_runs([run for run, of in tables.column("method").items() if of == method])
    return dataclasses.replace(own, trajectories=own.trajectories.iloc[:0])


def simulator_of(tables: Tables) -> dict[str, str]:
    """Where each run that left a policy was deployed."""
    return dict(zip(tables.results["run"], tables.results["simulator"], strict=True))


def load(folder: Path) -> tuple[dict[str, Any], Tables]:
    """What a submission says and its tables, checked against each other.

    Raises:
        UsageError: Something is missing, was changed, or contradicts itself.
    """
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        files, method = dict(record["files"]), str(record["method"])
        record["package"] = str(record["package"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"{folder / RECORD} does not describe a submission ({error}). Give a folder that "
            "`bench submit` wrote."
        ) from error
    if record.get("schema") != SCHEMA:
        raise UsageError(
            f"{folder / RECORD}: `schema` must be {SCHEMA}, got {record.get('schema')}."
        )
    there = {path.name for path in folder.glob("*.parquet")}
    if there != {*files}:
        raise UsageError(f"{folder} must hold {', '.join(sorted(files))}, got {', '.join(there)}.")
    for name, expected in files.items():
        if checksum((folder / name).read_bytes()) != expected:
            raise UsageError(f"{folder / name} has changed since it was submitted.")
    tables = Tables.load(folder)
    _check_rows(tables, method, folder)
    return record, tables


def _check_rows(tables: Tables, method: str, folder: Path) -> None:
    """Refuses rows that contradict themselves, and metrics that contradict their rows."""
    evaluated = {*tables.results["run"]}
    for row in records(tables.runs):
        name, wrong = row["run"], ""
        if row["method"] != method:
            wrong = f"is of '{row['method']}', not of '{method}'"
        elif not name.endswith(row["key"][:10]):
            wrong = f"does not have the name that its key {row['key']} gives it"
        elif (row["status"] != "failed") != (name in evaluated):
            wrong = f"ended as '{row['status']}', which its metrics contradict"
        if wrong:
            raise UsageError(f"{folder}: the row {name} {wrong}.")
    runs, said = {row["run"]: row for row in records(tables.runs)}, set()
    for line in records(tables.results):
        row, wrong = runs.get(line["run"]), ""
        if row is None:
            wrong = "belongs to no row"
        elif any(line[column] != row[column] for column in IDENTITY):
            wrong = "is said of another cell or seed than its row"
        elif (line["run"], line["metric"]) in said:
            wrong = "is there twice"
        said.add((line["run"], line["metric"]))
        if wrong:
            raise UsageError(f"{folder}: the metric {line['metric']} of {line['run']} {wrong}.")


def _record(method: str, own: Tables, sources: dict[str, str], folder: Path) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "method": method,
        "package": registry.distribution("method", method),
        "class": "{0.__module__}:{0.__qualname__}".format(registry.load("method", method)),
        "source": sources[f"method {method}"],
        "sources": dict(sorted(sources.items())),
        "runs": {row["run"]: row["key"] for row in records(own.runs)},
        "commits": sorted({*own.runs["commit"]}),
        "programs": sorted({*own.runs["program"]}),
        "packages": packages(),
        "machine": processor(),
        "files": {path.name: checksum(path.read_bytes()) for path in folder.glob("*.parquet")},
    }


def _readme(method: str, own: Tables) -> str:
    """The rows for a reader of the pull request."""
    minutes = seed_values(own.results, "fleet_minutes")
    rows = []
    for cell, entries in seed_values(own.results, "settled_reward").items():
        for entry, by_seed in entries.items():
            found, bill = estimate(by_seed.values()), estimate(minutes[cell][entry].values())
            names = [escape(Entry(*entry).label), escape(cell.label)]
            rows.append(
                [*names, str(found.n), mean_std(found.mean, found.std), significant(bill.mean)]
            )
    headings = ("method", "cell", "seeds", "settled reward", "HF fleet-minutes")
    failed = [*own.runs["status"]].count("failed")
    package = registry.distribution("method", method)
    parts = [
        f"# {escape(method)}",
        f"Rows of the method `{method}` of the package {escape(package)}, as `bench run` measured "
        "them. Settled reward is the mean over seeds ± standard deviation; 0 is perfect.",
        table(headings, rows, (0, 1)),
        f"{failed} of {len(own.runs)} runs failed.",
        "`bench verify FOLDER` checks this folder and trains one of its seeds again; the package "
        "must be installed.",
    ]
    return "\n\n".join(parts) + "\n"
