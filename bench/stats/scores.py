"""Scores: settled rewards of all cells on one scale, so that they can be pooled.

    score = (settled reward - zero) / (upper - zero)

Zero is a team that stays at its spawn, over the same initial states; every run carries that
number. Upper is what `upper_reference` reaches in the same cell: hot start with four times the
epochs. Where that diverged, the same training with a gradient that decays by one percent a step
(`STEADY`) stands for it. Where a cell has no upper reference, or both diverged, there is no score,
and whoever pools says so. A score above 1 is better than that reference.
"""

import json
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from bench.stats.statistics import (
    Cell,
    Entry,
    Values,
    cell_of,
    entry_of,
    home_of,
    records,
    seed_values,
)
from bench.store.tables import Tables

_T = TypeVar("_T")

UPPER = "upper_reference"
"""The method that defines a score of 1; it competes with nobody."""
STEADY = "trainer.decay=0.99"
"""Variant of the upper reference. Where the default diverged, this variant says what a score of 1
is; `reports/paper_why.md` says why it does not diverge."""
NOT_IN_RETURN = ("n_drones", "n_neighbors", "observe_attitude")
"""Settings of a task that say what a policy sees, not what it is paid for, and the team size."""
PRIMARY = "settled_reward"
"""What is compared first: the return from 2 s on."""


def upper_returns(tables: Tables) -> dict[Cell, float]:
    """Settled reward with score 1, by cell: the mean over seeds of the upper reference.

    Where a training of it diverged, its steady variant counts. Cells in which that is missing or
    diverged, too, are left out: such a reference is above nobody.
    """
    default, steady = _references(tables, ""), _references(tables, STEADY)
    counted = {c: steady.get(c, v) if np.isnan(v) else v for c, v in default.items()}
    return {cell: value for cell, value in counted.items() if np.isfinite(value)}


def steadied_references(tables: Tables) -> set[Cell]:
    """Cells whose upper reference diverged, where its steady variant says what a score of 1 is."""
    fell = {cell for cell, value in _references(tables, "").items() if np.isnan(value)}
    return fell & set(upper_returns(tables))


def fallen_references(tables: Tables) -> set[Cell]:
    """Cells whose upper reference diverged, so that there is no score in them."""
    return set(_references(tables, "")) - set(upper_returns(tables))


def _references(tables: Tables, variant: str) -> dict[Cell, float]:
    """Settled reward of a variant of the upper reference, by cell; NaN where one diverged."""
    rows = tables.results
    rows = rows.loc[rows["metric"].eq(PRIMARY) & rows["method"].eq(UPPER)]
    found: dict[Cell, list[float]] = {}
    for row in records(rows.loc[rows["variant"].eq(variant)]):
        value = np.nan if row["status"] == "diverged" else float(row["value"])
        found.setdefault(cell_of(row), []).append(value)
    return {cell: float(np.mean(own)) for cell, own in found.items()}


def scored(tables: Tables) -> pd.DataFrame:
    """The settled rewards of `results` as scores, without the reference and what has no score."""
    rows = tables.results
    rows = rows.loc[rows["metric"].eq(PRIMARY) & rows["method"].ne(UPPER)]
    zeros, uppers = tables.by_run("spawn_settled_reward"), upper_returns(tables)
    upper = np.asarray([uppers.get(cell_of(row), np.nan) for row in records(rows)], float)
    zero = np.asarray([zeros.get(run, np.nan) for run in rows["run"]], float)
    score = (np.asarray(rows["value"], float) - zero) / (upper - zero)
    return rows.assign(metric="score", value=score).loc[np.isfinite(score)]


def recovered(tables: Tables) -> Values:
    """1 less the settled reward over that at the spawn, by cell, entry and seed."""
    rows = tables.results
    rows = rows.loc[rows["metric"].eq(PRIMARY) & rows["method"].ne(UPPER)]
    zeros = tables.by_run("spawn_settled_reward")
    zero = np.asarray([zeros.get(run, np.nan) for run in rows["run"]], float)
    kept = rows.assign(metric="score", value=1.0 - np.asarray(rows["value"], float) / zero)
    return seed_values(kept, "score")


def at_home(values: Mapping[Cell, _T], tables: Tables) -> dict[Cell, _T]:
    """What there is of the undisturbed high-fidelity simulator."""
    home = home_of(tables)
    return {
        cell: own
        for cell, own in values.items()
        if cell.simulator == home and not cell.deployed_effects
    }


def undisturbed(tables: Tables, metric: str) -> Values:
    """Values in the undisturbed high-fidelity simulator, without the upper reference."""
    return {
        cell: {entry: seeds for entry, seeds in own.items() if entry.method != UPPER}
        for cell, own in at_home(seed_values(tables.results, metric), tables).items()
    }


def flown_settings(tables: Tables, cell: Cell, entry: Entry | None = None) -> dict[str, set[str]]:
    """What decides the returns of a cell beside the policy: name -> values of its runs, as text.

    The versions of the task and of the simulator flown in, and the settings of the task; runs whose
    records do not say are left out. `entry` None: of all entries.
    """
    about = {row["run"]: row for row in records(tables.runs)}
    flown = tables.results.drop_duplicates(subset=["run", "simulator", "deployed_effects"])
    found: dict[str, set[str]] = {}
    for row in records(flown):
        if cell_of(row) != cell or (entry is not None and entry_of(row) != entry):
            continue
        run = about.get(row["run"], {})
        versions, settings = (_json(run.get(name, "")) for name in ("versions", "settings"))
        for plugin in (f"task {cell.task}", f"simulator {cell.simulator}"):
            if plugin in versions:
                found.setdefault(f"version of {plugin}", set()).add(str(versions[plugin]))
        for name, value in (settings.get("task") or {}).items():
            if name not in NOT_IN_RETURN:
                found.setdefault(f"the task's `{name}`", set()).add(json.dumps(value))
    return found


def _json(text: str) -> dict[str, Any]:
    """A record as a dictionary; empty if it is none."""
    try:
        found = json.loads(text)
    except (TypeError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
