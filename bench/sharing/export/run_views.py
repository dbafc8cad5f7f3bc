"""What tools that track experiments want to know of a run: settings, metrics, a curve."""

import dataclasses
import json
from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from bench.plan.settings import flatten
from bench.stats.statistics import records
from bench.store.tables import Tables

CURVES = ("reward", "smooth_reward", "crashes", "grad_norm")
"""Columns of the table `curves` that are plotted against the epoch."""
WORLD = ("simulator", "trained_effects", "deployed_effects", "calibration_flights")
"""Columns of the table `results` that say where a run trained and was deployed."""

Value = str | int | float | bool
"""What every such tool takes as a setting."""


@dataclasses.dataclass(frozen=True)
class RunView:
    """One run."""

    name: str
    """Name of the run."""
    status: str
    """How it ended."""
    about: Mapping[str, Value]
    """What it is, where it comes from, its settings and the versions of what it used."""
    metrics: Mapping[str, float]
    """Final metrics; those without a finite value are left out."""
    curve: pd.DataFrame
    """A row an epoch, with the columns of `CURVES`; empty where the tables have no curves."""

    @property
    def failed(self) -> bool:
        """Whether it left no policy."""
        return self.status == "failed"

    def points(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Each epoch with its finite values."""
        columns = [self.curve[column] for column in CURVES]
        for epoch, *values in zip(self.curve["epoch"], *columns, strict=True):
            named = dict(zip(CURVES, values, strict=True))
            yield int(epoch), {f"training/{k}": float(v) for k, v in named.items() if v - v == 0.0}


def run_views(tables: Tables) -> Iterator[RunView]:
    """Every run of the tables, failed ones too, sorted by name."""
    curves: Any = tables.curves.groupby("run").groups
    results: Any = tables.results.groupby("run").groups
    for row in records(tables.runs.sort_values("run")):
        name = row["run"]
        own = tables.results.loc[results.get(name, [])]
        metrics = zip(own["metric"], own["value"], strict=True)
        yield RunView(
            name=name,
            status=row["status"],
            about=_about(row, own),
            metrics={metric: float(value) for metric, value in metrics if value - value == 0.0},
            curve=tables.curves.loc[curves.get(name, [])],
        )


def _about(row: Mapping[str, object], results: pd.DataFrame) -> dict[str, Value]:
    """What is known of a run but for its metrics, without nested tables."""
    texts = ("settings", "versions")
    found = {k: v for k, v in row.items() if k not in (*texts, "run")}
    if len(results):
        first = records(results.head(1))[0]
        found |= {column: first[column] for column in WORLD}
    for text in texts:
        found |= flatten(json.loads(str(row[text])), f"{text}.")
    return {k: v if isinstance(v, Value) else json.dumps(v) for k, v in found.items()}
