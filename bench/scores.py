"""Scores: returns of all cells on one scale, so that they can be pooled.

    score = 1 - return / (return of a team that stays at its spawn)

0 is as good as never taking off, 1 a return of 0, which no team reaches. The returns at the spawn
are frozen in `spawn_returns.toml`, by task, its version, its settings and team size. Where
one of these is not in the file there is no score, and whoever pools says so.
"""

import functools
import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.statistics import Cell, Entry, cell_of, entry_of, records
from bench.tables import Tables

FROZEN = Path(__file__).parent / "spawn_returns.toml"
"""The frozen returns."""
NOT_IN_RETURN = ("n_drones", "n_neighbors", "observe_attitude")
"""Settings of a task that no return at the spawn depends on, or that the team size stands for."""


def spawn_return(
    task: str, team_size: int, version: str | None = None, settings: Mapping[str, Any] | None = None
) -> float | None:
    """The frozen return of a team that stays at its spawn; None if there is none.

    Args:
        task: Registered name.
        team_size: Number of drones.
        version: Declared version of the task; None: any.
        settings: Settings of the task; what is not among them is taken to be as by default.
    """
    entry = _frozen().get(task)
    if entry is None or (version is not None and version != entry["version"]):
        return None
    given = settings or {}
    if any(given.get(name, value) != value for name, value in entry["settings"].items()):
        return None
    return entry["returns"].get(str(team_size))


def zero_returns(tables: Tables) -> dict[str, float]:
    """The return with score 0 of every run of `results`; NaN where there is none."""
    about = {row["run"]: row for row in records(tables.runs)}
    runs = tables.results.drop_duplicates(subset="run")
    return {row["run"]: _zero(row, about.get(row["run"], {})) for row in records(runs)}


def scored(tables: Tables) -> pd.DataFrame:
    """The rewards of `results` as scores; rows that have none are left out."""
    rewards = tables.results.loc[tables.results["metric"].eq("reward")]
    zeros = zero_returns(tables)
    zero = np.asarray([zeros[run] for run in rewards["run"]], dtype=float)
    score = 1.0 - np.asarray(rewards["value"], dtype=float) / zero
    return rewards.assign(metric="score", value=score).loc[np.isfinite(zero)]


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


def _zero(result: Mapping[str, Any], run: Mapping[str, Any]) -> float:
    """The frozen return that belongs to a row of `results` and its row of `runs`."""
    task = result["task"]
    versions, settings = (_json(run.get(name, "")) for name in ("versions", "settings"))
    version, given = versions.get(f"task {task}"), settings.get("task")
    found = spawn_return(task, int(result["team_size"]), version, given)
    return math.nan if found is None else found


def _json(text: str) -> dict[str, Any]:
    """A record as a dictionary; empty if it is none."""
    try:
        found = json.loads(text)
    except (TypeError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


@functools.cache
def _frozen() -> dict[str, Any]:
    return tomllib.loads(FROZEN.read_text(encoding="utf-8"))
