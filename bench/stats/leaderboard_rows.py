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
    reward: Estimate
    """Settled reward; its `n` is the number of seeds in all means."""
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
            sample, default, place = samples.get(entry, {}), default_of(entry), rank.get(entry)
            base = samples.get(default) if sample and default != entry else None
            row = Row(
                cell=cell,
                entry=entry,
                method=entry.label,
                rank=place,
                best=place is not None and place.first == 1,
                default=None if default == entry else default,
                beside_default=difference(sample, base) if base else None,
                reward=estimate(sample.values()),
                metrics={n: estimate(v.get(entry, {}).values()).mean for n, v in own.items()},
                axis_ranks={axis: rank_on.get(entry) for axis, rank_on in axes.items()},
                runs=endings_text(how.get(entry, {}), set(sample)),
            )
            found.append(row)
        rows += sorted(found, key=_order)
    return rows


def best_rows(rows: Iterable[Row]) -> dict[Cell, Row]:
    """The first row of each cell with a number, of methods with their default settings."""
    found: dict[Cell, Row] = {}
    for row in rows:
        if row["reward"].n and row["default"] is None and row["entry"].method != UPPER:
            found.setdefault(row["cell"], row)
    return found


def _axis_ranks(
    metrics: Mapping[str, Mapping[Entry, Mapping[int, float]]],
) -> dict[str, dict[Entry, Rank]]:
    """Ranks by axis."""
    values = dict(metrics)
    for axis in OF_TRAINING:
        flown = values[axis].items()
        values[axis] = {e: own for e, own in flown if not without_world(e.variant)[1]}
    return {
        axis: ranks(
            {e: {s: -x for s, x in own.items()} for e, own in _competing(values[axis]).items()}
        )
        for axis in AXES
    }


def _competing(values: Mapping[Entry, Mapping[int, float]]) -> dict[Entry, Mapping[int, float]]:
    """Values of the entries that have a rank."""
    return {e: own for e, own in values.items() if e.method != UPPER and default_of(e) == e}


def _order(row: Row) -> tuple[bool, float, str]:
    none = row["reward"].n == 0
    return none, 0.0 if none else -row["reward"].mean, row["method"]
