"""How the runs of every entry ended, cell by cell: what no mean may hide."""

from collections.abc import Collection, Mapping

import pandas as pd

from bench.stats.statistics import (
    COUNTED,
    FAILURES,
    Cell,
    Entry,
    cell_of,
    cells_meant,
    entry_of,
    records,
)
from bench.store.tables import Tables

Endings = Mapping[str, list[int]]
"""Status -> seeds of the runs that ended so."""


def places(
    tables: Tables,
) -> tuple[dict[str, list[tuple[Cell, Entry]]], dict[tuple[str, int], set[Cell]]]:
    """Where each run was evaluated, and all worlds of each task and team size."""
    flown = tables.results.drop_duplicates(["run", "simulator", "deployed_effects"])
    found: dict[str, list[tuple[Cell, Entry]]] = {}
    worlds: dict[tuple[str, int], set[Cell]] = {}
    for row in records(flown):
        cell = cell_of(row)
        found.setdefault(row["run"], []).append((cell, entry_of(row)))
        worlds.setdefault((cell.task, cell.team_size), set()).add(cell)
    return found, worlds


def endings(tables: Tables) -> dict[Cell, dict[Entry, dict[str, list[int]]]]:
    """Seeds by cell, entry and status, of every run.

    A run that failed before its evaluation is listed where it was meant to be evaluated.
    """
    flown, worlds = places(tables)
    found: dict[Cell, dict[Entry, dict[str, list[int]]]] = {}
    for row in records(_every_run(tables)):
        entry, size = entry_of(row), (str(row["task"]), int(row["team_size"]))
        meant = cells_meant(*size, entry.variant, worlds.get(size, set()))
        for cell, entry in flown.get(row["run"], [(cell, entry) for cell in meant]):
            ended = found.setdefault(cell, {}).setdefault(entry, {})
            ended.setdefault(row["status"], []).append(int(row["seed"]))
    return found


def lost(ended: Endings) -> int:
    """Number of runs that failed or diverged."""
    return sum(len(seeds) for status, seeds in ended.items() if status in FAILURES)


def endings_text(ended: Endings, counted: Collection[int]) -> str:
    """Runs by status, with the seeds of those that are not `ok`.

    Args:
        ended: How the runs of an entry in a cell ended.
        counted: Seeds that are in the mean.
    """
    parts = []
    for status in sorted(ended, key=lambda s: (s != "ok", s)):
        seeds = sorted(ended[status])
        named = f" (seed {', '.join(map(str, seeds))})" if status != "ok" else ""
        parts.append(f"{len(seeds)} {status}{named}")
        if status in COUNTED and (silent := [seed for seed in seeds if seed not in counted]):
            parts.append(f"no reward from seed {', '.join(map(str, silent))}")
    return ", ".join(parts)


def _every_run(tables: Tables) -> pd.DataFrame:
    columns = ["run", "method", "residual", "variant", "task", "team_size", "seed", "status"]
    both = pd.concat([tables.runs, tables.results], ignore_index=True)
    return both.drop_duplicates("run").filter(columns)
