"""What it costs to be as good as training from scratch in the high-fidelity simulator.

Here a return R of a whole episode counts as 1 - R / (return at the spawn), because training curves
are of whole episodes. The target of a cell is the mean of `REFERENCE` there, less `TOLERANCE`. A
run reaches it if its deployed policy does. A run that trained in the high-fidelity simulator is
billed up to the first epoch from which on its training return, averaged over `SMOOTHING` epochs,
had been there; every other run is billed in full, because nobody knows its worth before it is
deployed.

    expected cost = cost of all runs / number of runs that reach the target

is what one success costs if one tries again until it comes: Hansen et al. (2010), "expected running
time" of the COCO benchmarks. Runs that failed have no known cost and add none.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bench.stats.statistics import COUNTED, Cell, Entry, cell_of, entry_of, records
from bench.store.tables import Tables

REFERENCE = Entry("hf_scratch")
"""The method whose mean score is the target: the paper's baseline in one simulator alone."""
TOLERANCE = 0.01
"""How far below it the target lies, as a share of the return at the spawn; a choice."""
SMOOTHING = 10
"""Epochs over which a training return is averaged."""


class ToTarget(NamedTuple):
    """The costs of an entry in a cell."""

    minutes: dict[int, float]
    """High-fidelity fleet-minutes until the target, by seed, of runs that reach it."""
    seconds: dict[int, float]
    """Training time until the target [s], likewise."""
    expected_minutes: float
    """Fleet-minutes for one success; infinite without any."""
    expected_seconds: float
    """Training time for one success [s]."""


def costs_to_target(tables: Tables) -> dict[Cell, dict[Entry, ToTarget]]:
    """Costs by cell and entry, for cells in which the reference has a score."""
    runs = _runs(tables)
    found: dict[Cell, dict[Entry, ToTarget]] = {}
    for cell, own in runs.items():
        theirs = own.get(REFERENCE, [])
        counted = [r["score"] for r in theirs if r["status"] in COUNTED]
        counted = [score for score in counted if math.isfinite(score)]
        if not counted:
            continue
        target = float(np.mean(counted)) - TOLERANCE
        found[cell] = {entry: _to_target(rows, target) for entry, rows in own.items()}
    return found


def _to_target(runs: list[dict[str, Any]], target: float) -> ToTarget:
    minutes, seconds, spent = {}, {}, np.zeros(2)
    for run in runs:
        full = np.asarray([run["fleet_minutes"], run["train_seconds"]])
        if run["status"] in COUNTED and run["score"] >= target:
            cost = full * _share(run, target)
            minutes[run["seed"]], seconds[run["seed"]] = map(float, cost)
        else:
            cost = full
        spent += cost
    expected = spent / len(minutes) if minutes else np.full(2, math.inf)
    return ToTarget(minutes, seconds, *map(float, expected))


def _share(run: Mapping[str, Any], target: float) -> float:
    """Share of its epochs that a run needs to reach the target."""
    curve = run["curve"]
    if run["calibration_flights"] > 0 or run["fleet_minutes"] <= 0.0 or len(curve) < SMOOTHING:
        return 1.0
    smooth = np.convolve(1.0 - curve / run["zero"], np.full(SMOOTHING, 1.0 / SMOOTHING), "valid")
    there = np.flatnonzero(smooth >= target)
    return (there[0] + SMOOTHING) / len(curve) if there.size else 1.0


def _runs(tables: Tables) -> dict[Cell, dict[Entry, list[dict[str, Any]]]]:
    """Every run whose cost is known, by cell and entry."""
    rewards = tables.results.loc[tables.results["metric"].eq("reward")]
    cost = tables.results.loc[tables.results["metric"].isin(["fleet_minutes", "train_seconds"])]
    costs = cost.drop_duplicates(subset=["run", "metric"]).pivot(
        index="run", columns="metric", values="value"
    )
    costs = costs.reindex(columns=["fleet_minutes", "train_seconds"]).fillna(0.0)
    zero, curves = tables.by_run("spawn_reward"), _curves(tables.curves)
    found: dict[Cell, dict[Entry, list[dict[str, Any]]]] = {}
    for row in records(rewards):
        if row["run"] not in costs.index or row["run"] not in zero:
            continue
        known = {
            "seed": int(row["seed"]),
            "status": row["status"],
            "score": 1.0 - float(row["value"]) / zero[row["run"]],
            "calibration_flights": int(row["calibration_flights"]),
            "zero": zero[row["run"]],
            "curve": curves.get(row["run"], np.zeros(0)),
            **costs.loc[row["run"]].to_dict(),
        }
        found.setdefault(cell_of(row), {}).setdefault(entry_of(row), []).append(known)
    return found


def _curves(curves: pd.DataFrame) -> dict[str, np.ndarray]:
    """Training return by epoch, by run."""
    ordered = curves.sort_values(["run", "epoch"], kind="stable")
    groups = ordered.groupby("run", sort=False)["reward"]
    return {str(run): values.to_numpy(dtype=float) for run, values in groups}
