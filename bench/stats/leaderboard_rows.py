"""The rows of a leaderboard: an entry (method, residual, variant) in a cell (task, team, world).

Its numbers are means over all seeds that left a policy, diverged ones too; those and the failed
ones are named beside it. The order is by the settled reward. Each axis beside it has a rank of its
own, by the same rule. The upper reference stands among the rows and has no rank, nor have settings
other than the default: they are compared with their own default.
"""

from collections.abc import Iterable, Mapping
from typing import TypedDict

from bench.stats.ranking import Rank, ranks
from bench.stats.scores import PRIMARY, UPPER
from bench.stats.statistics import (
    Cell,
    Endings,
    Entry,
    Estimate,
    default_of,
    difference,
    endings,
    endings_text,
    estimate,
    seed_values,
    without_world,
)
from bench.store.tables import Tables

METRICS = (
    "reward",
    "settling_time",
    "position_error",
    "crashes",
    "fleet_minutes",
    "training_crashes",
    "lf_collisions",
    "epochs",
    "train_seconds",
)
"""Metrics shown beside the reward, as means over seeds."""

AXES = {
    "crashes": "crashes per episode",
    "training_crashes": "HF training crashes",
    "fleet_minutes": "HF fleet-minutes",
}
"""What entries are ranked by beside the reward, lower is better, and what it is called.

Training time is not: a method's seeds often run on one machine, beside whatever else runs there.
"""


OF_TRAINING = ("training_crashes", "fleet_minutes")
"""Axes on which a row that only deploys another run's policy has no rank: it trains nothing."""


class Row(TypedDict):
    """An entry in a cell; NaN where there is no number."""

    cell: Cell
    entry: Entry
    method: str
    """Label, e.g. `hybrid (mlp)`."""
    rank: Rank | None
    """None where no order is claimed."""
    best: bool
    """Whether its rank may be the first."""
    default: Entry | None
    """The same with default settings, which a variant is compared with; None where it is that."""
    beside_default: Estimate | None
    """Settled reward less that of `default`; None without such a row."""
    reward_mean: float
    reward_std: float
    reward_low: float
    reward_high: float
    n: int
    """Seeds in the means."""
    metrics: dict[str, float]
    """Means of `METRICS`."""
    axis_ranks: dict[str, Rank | None]
    """Rank on each of `AXES`; None where no order is claimed."""
    runs: str
    """Runs by status, with the seeds of those that are not `ok`."""


def leaderboard_rows(tables: Tables) -> list[Row]:
    """Rows by cell; within one, higher mean reward first, entries without a number last."""
    rewards = seed_values(tables.results, PRIMARY)
    metrics = {name: seed_values(tables.results, name) for name in METRICS}
    ended = endings(tables)
    rows: list[Row] = []
    for cell in sorted({*rewards, *ended}):
        samples, how = rewards.get(cell, {}), ended.get(cell, {})
        own = {name: values.get(cell, {}) for name, values in metrics.items()}
        rank = ranks(_competing(samples))
        axes = _axis_ranks(own)
        found = []
        for entry in {*samples, *how}:
            row = _row(cell, entry, samples, how.get(entry, {}))
            row["rank"] = rank.get(entry)
            row["best"] = row["rank"] is not None and row["rank"].first == 1
            row["axis_ranks"] = {axis: rank_on.get(entry) for axis, rank_on in axes.items()}
            row["metrics"] = {
                name: estimate(values.get(entry, {}).values()).mean for name, values in own.items()
            }
            found.append(row)
        rows += sorted(found, key=lambda row: (row["n"] == 0, -_finite(row), row["method"]))
    return rows


def best_rows(rows: Iterable[Row]) -> dict[Cell, Row]:
    """The first row of each cell with a number, of methods with their default settings."""
    found: dict[Cell, Row] = {}
    for row in rows:
        if row["n"] and row["default"] is None and row["entry"].method != UPPER:
            found.setdefault(row["cell"], row)
    return found


def _axis_ranks(
    metrics: Mapping[str, Mapping[Entry, Mapping[int, float]]],
) -> dict[str, dict[Entry, Rank]]:
    """Ranks by axis."""
    values = dict(metrics)
    for axis in OF_TRAINING:
        values[axis] = {e: own for e, own in values[axis].items() if not _deployed(e)}
    return {
        axis: ranks(
            {e: {s: -x for s, x in own.items()} for e, own in _competing(values[axis]).items()}
        )
        for axis in AXES
    }


def _deployed(entry: Entry) -> bool:
    """Whether rows of the entry train nothing, and deploy another run's policy in a world."""
    return without_world(entry.variant)[1]


def _competing(values: Mapping[Entry, Mapping[int, float]]) -> dict[Entry, Mapping[int, float]]:
    """Values of the entries that have a rank."""
    return {e: own for e, own in values.items() if e.method != UPPER and default_of(e) == e}


def _row(
    cell: Cell, entry: Entry, samples: Mapping[Entry, Mapping[int, float]], ended: Endings
) -> Row:
    """A row without what rests on the other rows of its cell."""
    sample, default = samples.get(entry, {}), default_of(entry)
    reward = estimate(sample.values())
    return Row(
        cell=cell,
        entry=entry,
        method=entry.label,
        rank=None,
        best=False,
        default=None if default == entry else default,
        beside_default=(
            difference(sample, samples[default])
            if default != entry and default in samples and sample
            else None
        ),
        reward_mean=reward.mean,
        reward_std=reward.std,
        reward_low=reward.low,
        reward_high=reward.high,
        n=reward.n,
        metrics={},
        axis_ranks={},
        runs=endings_text(ended, set(sample)),
    )


def _finite(row: Row) -> float:
    return row["reward_mean"] if row["n"] else 0.0
