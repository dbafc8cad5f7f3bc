"""Everything that a page shows of single runs: settings, metrics, training curve, flight."""

import json
from typing import Any

import numpy as np
import pandas as pd

from bench.report.flown import playable_all
from bench.report.pictures.curves import by_run
from bench.stats.statistics import FAILURES, Cell, Entry, entry_of, flown_in, records
from bench.store.tables import Tables
from bench.text.numbers import significant

MAX_POINTS = 100
"""Points of one run's training curve."""

Group = tuple[str, int, Entry]
"""Task, team size and entry: what runs that differ in their seed alone share."""


def run_lines(tables: Tables) -> list[dict[str, Any]]:
    """Every run as a line of a table, those that were lost first; `id` is its place in the page."""
    reward = tables.by_run("reward")
    found = [
        {
            "run": row["run"],
            "entry": entry_of(row),
            "method": entry_of(row).label,
            "task": row["task"],
            "team_size": int(row["team_size"]),
            "seed": int(row["seed"]),
            "status": row["status"],
            "lost": row["status"] in FAILURES,
            "cause": row["cause"],
            "reward": significant(reward.get(row["run"], float("nan")), 3),
        }
        for row in records(tables.runs)
    ]
    keys = ("task", "team_size", "method", "seed")
    found.sort(key=lambda run: (not run["lost"], *(run[key] for key in keys)))
    return [{"id": f"run-{i}", **run} for i, run in enumerate(found)]


def settings_groups(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """What ran with which settings; seeds that share them stand together."""
    groups: dict[tuple[str, int, str, str], list[dict[str, Any]]] = {}
    for row in records(runs):
        key = (row["task"], row["team_size"], entry_of(row).label, row["settings"])
        groups.setdefault(key, []).append(row)
    return [
        {
            "id": f"settings-{i}",
            "method": method,
            "task": task,
            "team_size": team_size,
            "seeds": ", ".join(str(seed) for seed in sorted(row["seed"] for row in own)),
            "settings": pretty(text),
            "runs": [row["run"] for row in own],
        }
        for i, ((task, team_size, method, text), own) in enumerate(sorted(groups.items()))
    ]


def version_groups(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """The distinct sets of versions, most frequent first, with the runs that had each."""
    groups: dict[str, list[str]] = {}
    for row in records(runs):
        groups.setdefault(str(row["versions"]), []).append(row["run"])
    ordered = sorted(groups.items(), key=lambda item: (-len(item[1]), item[0]))
    return [
        {"id": f"versions-{i}", "versions": pretty(text), "runs": own}
        for i, (text, own) in enumerate(ordered)
    ]


def details(
    tables: Tables,
    lines: list[dict[str, Any]],
    settings: list[dict[str, Any]],
    versions: list[dict[str, Any]],
) -> list[dict[str, Any]]:
    """What the page shows when a run is opened, in the order of `lines`, ready for JSON."""
    place = {line["run"]: i for i, line in enumerate(lines)}
    settings_of = {run: group["id"] for group in settings for run in group["runs"]}
    versions_of = {run: group["id"] for group in versions for run in group["runs"]}
    flights = playable_all({r: f for r, f in by_run(tables.trajectories).items() if r in place})
    curves = {r: curve(f) for r, f in by_run(tables.curves).items() if r in place}
    metrics = run_metrics(tables.results)
    siblings: dict[Group, list[int]] = {}
    for i, line in enumerate(lines):
        siblings.setdefault(_group(line), []).append(i)
    return [
        {
            **{key: line[key] for key in ("run", "method", "task", "team_size", "seed", "status")},
            "cause": line["cause"],
            "metrics": metrics.get(line["run"], []),
            "settings": settings_of[line["run"]],
            "versions": versions_of[line["run"]],
            "curve": curves.get(line["run"]),
            "flight": flights.get(line["run"]),
            "seeds": sorted(siblings[_group(line)], key=lambda i: lines[i]["seed"]),
        }
        for line in lines
    ]


def first_runs(tables: Tables, lines: list[dict[str, Any]]) -> dict[tuple[Cell, Entry], str]:
    """Id of the run that a row of the leaderboard opens: the first seed of its entry there."""
    flown = flown_in(tables)
    found: dict[tuple[Cell, Entry], str] = {}
    for line in sorted(lines, key=lambda line: (line["lost"], line["seed"])):
        for key in flown[line["run"]]:
            found.setdefault(key, line["id"])
    return found


def run_metrics(results: pd.DataFrame) -> dict[str, list[list[str]]]:
    """Name, value as text and unit of every metric, by run."""
    found: dict[str, list[list[str]]] = {}
    columns = (results[name].tolist() for name in ("run", "metric", "value", "unit"))
    for run, metric, value, unit in zip(*columns, strict=True):
        text = f"{value:.5g}" if np.isfinite(value) else "-"
        found.setdefault(run, []).append([metric, text, "" if unit == "1" else unit])
    return found


def curve(frame: pd.DataFrame) -> dict[str, Any] | None:
    """Epochs and training returns, averaged over bins; None if nothing finite was recorded."""
    frame = frame.sort_values("epoch")
    reward = frame["reward"].to_numpy(float)
    if not np.isfinite(reward).any():
        return None
    epoch = frame["epoch"].to_numpy(float)
    bins = min(MAX_POINTS, len(reward))
    pairs = zip(np.array_split(epoch, bins), np.array_split(reward, bins), strict=True)
    means = [(x.mean(), y.mean()) for x, y in pairs]
    return {
        "epoch": [round(float(x), 1) for x, _ in means],
        "epochs": len(epoch),
        "reward": [float(f"{y:.5g}") if np.isfinite(y) else None for _, y in means],
    }


def pretty(text: str) -> str:
    """Indented JSON; a record that is no JSON is shown as it is."""
    try:
        return json.dumps(json.loads(text), indent=1, ensure_ascii=False)
    except json.JSONDecodeError:
        return text


def _group(line: dict[str, Any]) -> Group:
    return line["task"], line["team_size"], line["entry"]
