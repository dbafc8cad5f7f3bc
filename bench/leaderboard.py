"""Who does how well, cell by cell and overall, as rows and as Markdown.

A row is an entry (method, residual, variant) in a cell (task, team size, world). Its numbers are
means over the seeds that ended `ok` or `budget`; failed and diverged runs are named beside it.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypedDict

import pandas as pd

from bench import markdown
from bench.statistics import (
    COUNTED,
    Cell,
    Entry,
    cell_of,
    entry_of,
    estimate,
    ranks,
    records,
    seed_values,
)
from bench.tables import Tables

METRICS = (
    "position_error",
    "crashes",
    "fleet_minutes",
    "training_crashes",
    "lf_collisions",
    "epochs",
    "train_seconds",
)
"""Metrics shown beside the reward, as means over seeds."""

MISSING = "-"
"""Shown where there is no number."""

HOW_TO_READ = (
    "Rewards are episode returns in the high-fidelity simulator, higher is better: mean ± "
    "standard deviation over the training seeds (n of them), then the 95 % t-interval of the mean.",
    "Methods share a rank where the 95 % t-interval of their difference (paired by seed where the "
    "seeds match, else Welch's; not corrected for the number of comparisons) contains 0, so a "
    "method that varies much between seeds can share a rank with better means. With one seed there "
    "is no interval and no order is claimed.",
    "Failed and diverged runs are in no mean; the last column counts and names them. `budget`: a "
    "high-fidelity run that its epoch budget ended; it counts.",
    "A crash is the onset of a contact, per agent: another drone closer than 0.30 m, or the floor. "
    "Contacts are flags in this simulator: drones never push each other.",
)
"""What a reader must know, in Markdown."""


class Row(TypedDict):
    """An entry in a cell; NaN where there is no number."""

    cell: Cell
    entry: Entry
    task: str
    team_size: int
    method: str
    """Label, e.g. `hybrid (mlp)`."""
    rank: int | None
    """None where no order is claimed."""
    best: bool
    """Best of its cell, or tied with the best."""
    reward_mean: float
    reward_std: float
    reward_low: float
    reward_high: float
    n: int
    """Seeds in the means."""
    metrics: dict[str, float]
    """Means of `METRICS`."""
    lost: int
    """Runs that failed or diverged."""
    runs: str
    """Runs by status, with the seeds of those that are not `ok`."""


class Column(NamedTuple):
    """How a row is shown."""

    heading: str
    text: Callable[[Row], str]
    order: Callable[[Row], float | str]
    """Value to sort by."""


class Standing(NamedTuple):
    """An entry over all its cells."""

    method: str
    cells: int
    """Cells in which it competes."""
    ranked: int
    """Those in which an order is claimed."""
    best: int
    """Those in which it is best or tied with the best."""
    mean_rank: float
    """Mean over the ranked cells; NaN without any."""
    lost: int
    """Runs that failed or diverged."""


def leaderboard_rows(tables: Tables) -> list[Row]:
    """Rows by cell; within one, higher mean reward first, entries without a number last."""
    rewards = seed_values(tables.results, "reward")
    metrics = {name: seed_values(tables.results, name) for name in METRICS}
    statuses = _statuses(tables)
    rows = []
    for cell in sorted({*rewards, *statuses}):
        samples = rewards.get(cell, {})
        rank = ranks(samples)
        found = []
        for entry in {*samples, *statuses.get(cell, {})}:
            means = {
                name: estimate(values.get(cell, {}).get(entry, {}).values()).mean
                for name, values in metrics.items()
            }
            ended = statuses.get(cell, {}).get(entry, {})
            found.append(_row(cell, entry, samples.get(entry, {}), rank.get(entry), means, ended))
        rows += sorted(found, key=lambda row: (row["n"] == 0, -_finite(row), row["method"]))
    return rows


def standings(rows: list[Row]) -> list[Standing]:
    """Entries over all cells, most often best first."""
    by_entry: dict[Entry, list[Row]] = {}
    for row in rows:
        by_entry.setdefault(row["entry"], []).append(row)
    found = []
    for entry, own in by_entry.items():
        placed = [row["rank"] for row in own if row["rank"] is not None]
        found.append(
            Standing(
                entry.label,
                len(own),
                len(placed),
                sum(row["best"] for row in own),
                sum(placed) / len(placed) if placed else math.nan,
                sum(row["lost"] for row in own),
            )
        )
    return sorted(
        found,
        key=lambda s: (-s.best, math.inf if math.isnan(s.mean_rank) else s.mean_rank, s.method),
    )


def write_leaderboard(tables: Tables, path: Path) -> None:
    """Writes the leaderboard as Markdown to `path`."""
    rows = leaderboard_rows(tables)
    parts = ["# Leaderboard", "\n".join(f"- {line}" for line in HOW_TO_READ)]
    if not rows:
        parts.append("There are no runs in these tables.")
    else:
        standing = [[markdown.escape(text) for text in line] for line in standing_lines(rows)]
        parts += ["## Overall", markdown.table(STANDING_HEADINGS, standing)]
    for cell in dict.fromkeys(row["cell"] for row in rows):
        own = [row for row in rows if row["cell"] == cell]
        body = [[markdown.escape(column.text(row)) for column in COLUMNS] for row in own]
        headings = [column.heading for column in COLUMNS]
        left = (1, len(headings) - 1)
        parts += [f"## {markdown.escape(cell.label)}", markdown.table(headings, body, left)]
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


STANDING_HEADINGS = ("method", "best or tied", "mean rank", "cells ranked", "runs lost")
"""Headings of `standing_lines`."""


def standing_lines(rows: list[Row]) -> list[list[str]]:
    """The overall table as text."""
    return [
        [
            s.method,
            f"{s.best} of {s.ranked}" if s.ranked else MISSING,
            number(s.mean_rank, 2),
            f"{s.ranked} of {s.cells}",
            str(s.lost),
        ]
        for s in standings(rows)
    ]


def number(value: float, digits: int) -> str:
    """A number as text, `-` for NaN."""
    if not math.isfinite(value):
        return MISSING
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def mean_std(mean: float, std: float, digits: int = 1) -> str:
    """`mean ± std` as text, without the second part where there is no second seed."""
    return number(mean, digits) + (f" ± {number(std, digits)}" if math.isfinite(std) else "")


def seconds(value: float) -> str:
    """A duration as text, in seconds, minutes or hours."""
    if not math.isfinite(value):
        return MISSING
    if value < 120.0:
        return f"{value:.0f} s"
    return f"{value / 60.0:.1f} min" if value < 7200.0 else f"{value / 3600.0:.1f} h"


def _row(
    cell: Cell,
    entry: Entry,
    sample: dict[int, float],
    rank: int | None,
    means: dict[str, float],
    ended: dict[str, list[int]],
) -> Row:
    reward = estimate(sample.values())
    return Row(
        cell=cell,
        entry=entry,
        task=cell.task,
        team_size=cell.team_size,
        method=entry.label,
        rank=rank,
        best=rank == 1,
        reward_mean=reward.mean,
        reward_std=reward.std,
        reward_low=reward.low,
        reward_high=reward.high,
        n=reward.n,
        metrics=means,
        lost=sum(len(seeds) for status, seeds in ended.items() if status not in COUNTED),
        runs=_ended_text(ended, set(sample)),
    )


def _statuses(tables: Tables) -> dict[Cell, dict[Entry, dict[str, list[int]]]]:
    """Seeds by cell, entry and status, of every run.

    A run that failed before its evaluation names no world: it is listed in all worlds of its task
    and team size.
    """
    flown = tables.results.drop_duplicates(["run", "simulator", "deployed_effects"])
    places: dict[str, list[tuple[Cell, Entry]]] = {}
    worlds: dict[tuple[str, int], set[Cell]] = {}
    for row in records(flown):
        cell = cell_of(row)
        places.setdefault(row["run"], []).append((cell, entry_of(row)))
        worlds.setdefault((cell.task, cell.team_size), set()).add(cell)
    found: dict[Cell, dict[Entry, dict[str, list[int]]]] = {}
    for row in records(_every_run(tables)):
        task, team_size = str(row["task"]), int(row["team_size"])
        anywhere = worlds.get((task, team_size), {Cell(task, team_size)})
        for cell, entry in places.get(row["run"], [(cell, entry_of(row)) for cell in anywhere]):
            ended = found.setdefault(cell, {}).setdefault(entry, {})
            ended.setdefault(row["status"], []).append(int(row["seed"]))
    return found


def _every_run(tables: Tables) -> pd.DataFrame:
    columns = ["run", "method", "residual", "variant", "task", "team_size", "seed", "status"]
    both = pd.concat([tables.runs, tables.results], ignore_index=True)
    return both.drop_duplicates("run").filter(columns)


def _ended_text(ended: dict[str, list[int]], counted: set[int]) -> str:
    parts = []
    for status in sorted(ended, key=lambda s: (s != "ok", s)):
        seeds = sorted(ended[status])
        named = f" (seed {', '.join(map(str, seeds))})" if status != "ok" else ""
        parts.append(f"{len(seeds)} {status}{named}")
        if status in COUNTED and (silent := [seed for seed in seeds if seed not in counted]):
            parts.append(f"no reward from seed {', '.join(map(str, silent))}")
    return ", ".join(parts)


def _finite(row: Row) -> float:
    return row["reward_mean"] if row["n"] else 0.0


def _interval(row: Row) -> str:
    if row["n"] < 2:
        return MISSING
    return f"{number(row['reward_low'], 1)} to {number(row['reward_high'], 1)}"


def _metric(heading: str, name: str, digits: int) -> Column:
    return Column(
        heading,
        lambda row: number(row["metrics"][name], digits),
        lambda row: row["metrics"][name],
    )


COLUMNS = (
    Column(
        "rank",
        lambda row: MISSING if row["rank"] is None else str(row["rank"]),
        lambda row: math.nan if row["rank"] is None else row["rank"],
    ),
    Column("method", lambda row: row["method"], lambda row: row["method"]),
    Column(
        "reward (n)",
        lambda row: (
            f"{mean_std(row['reward_mean'], row['reward_std'])} (n = {row['n']})"
            if row["n"]
            else MISSING
        ),
        lambda row: row["reward_mean"],
    ),
    Column("95 % t-interval", _interval, lambda row: row["reward_low"]),
    _metric("position error [m]", "position_error", 3),
    _metric("crashes per episode", "crashes", 2),
    _metric("HF fleet-minutes", "fleet_minutes", 0),
    _metric("HF training crashes", "training_crashes", 0),
    _metric("LF training collisions", "lf_collisions", 0),
    _metric("epochs", "epochs", 0),
    Column(
        "training time",
        lambda row: seconds(row["metrics"]["train_seconds"]),
        lambda row: row["metrics"]["train_seconds"],
    ),
    Column("runs", lambda row: row["runs"], lambda row: row["runs"]),
)
"""Columns of a leaderboard, in order."""
