"""The JSON file of MARL-eval: environment, task, algorithm, run, step, metric.

Source of the structure: README of marl-eval (InstaDeep); Gorsane et al. (2022), arXiv:2209.10485.
It takes data only where every algorithm ran every task of an environment with as many runs. So an
environment is a reality and a team size here, and an entry that lacks a run in it is left out and
named. Our policies are evaluated once, at the end: there is one step, whose count is the flight in
high fidelity that the training needed, in control steps of the fleet.
"""

import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from bench.stats.statistics import Cell, Entry, cell_of, entry_of, records
from bench.store.record import to_json
from bench.store.tables import Tables
from simulators.vehicle import CONTROL_DT

METRICS = (
    "settled_reward",
    "reward",
    "crashes",
    "crash_step_rate",
    "position_error",
    "fleet_minutes",
)
"""Metrics that go into the file; each is one number, a mean over the evaluation's episodes."""

Runs = dict[int, dict[str, float]]
"""Metrics of the runs of an entry in a cell, by seed."""


def write(tables: Tables, title: str, folder: Path, place: Path) -> list[str]:
    """Fills `folder` with raw_data.json."""
    del title, place
    environments: dict[str, dict[Entry, dict[str, Runs]]] = {}
    rows = tables.results.loc[tables.results["metric"].isin(METRICS)]
    bad = {row["run"]: row["metric"] for row in records(rows) if not math.isfinite(row["value"])}
    for row in records(rows.loc[~rows["run"].isin(bad)]):
        cell, entry = cell_of(row), entry_of(row)
        tasks = environments.setdefault(_environment(cell), {}).setdefault(entry, {})
        tasks.setdefault(cell.task, {}).setdefault(row["seed"], {})[row["metric"]] = row["value"]
    content: dict[str, dict] = {}
    left_out = [f"{run}, whose {metric} is not finite." for run, metric in bad.items()]
    for name, entries in sorted(environments.items()):
        content[name], partial, further = _complete(entries)
        left_out += [f"{entry.label} lacks runs of {name}." for entry in partial]
        left_out += [f"{entry.label} has further seeds of {name}." for entry in further]
    (folder / "raw_data.json").write_bytes(to_json(content))
    return left_out


def _environment(cell: Cell) -> str:
    world = " with ".join(filter(None, [cell.simulator, cell.deployed_effects]))
    return f"{world}, N = {cell.team_size}"


def _complete(
    entries: Mapping[Entry, Mapping[str, Runs]],
) -> tuple[dict, list[Entry], list[Entry]]:
    """Algorithms by task that have the runs of most entries; entries with fewer, and with more."""
    tasks = sorted({task for by_task in entries.values() for task in by_task})
    counts = Counter(frozenset(runs) for by_task in entries.values() for runs in by_task.values())
    # Of equally frequent sets of seeds the larger one, then the one that begins earlier.
    seeds = min(counts, key=lambda seeds: (-counts[seeds], -len(seeds), sorted(seeds)))
    whole = {
        entry: by_task
        for entry, by_task in sorted(entries.items())
        if all(seeds <= set(by_task.get(task, ())) for task in tasks)
    }
    made = {
        task: {
            entry.label: {
                f"seed_{seed}": _steps(by_task[task][seed]) for seed in sorted(map(int, seeds))
            }
            for entry, by_task in whole.items()
        }
        for task in tasks
    }
    partial = [entry for entry in sorted(entries) if entry not in whole]
    further = [e for e, by_task in whole.items() if any(seeds < set(r) for r in by_task.values())]
    return made, partial, further


def _steps(metrics: Mapping[str, float]) -> dict[str, object]:
    """A run: its one evaluation, which is its absolute metric, too."""
    lists = {name: [float(metrics[name])] for name in METRICS if name in metrics}
    steps = round(metrics["fleet_minutes"] * 60.0 / CONTROL_DT)
    return {"step_1": {"step_count": steps, **lists}, "absolute_metrics": lists}
