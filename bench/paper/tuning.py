"""How an optimiser is chosen from trials, by one rule for all configurations: `reports/tuning.md`.

A trial is a configuration with a learning rate and a decay of the gradient. Its number is the
geometric mean over tasks of the settled loss (minus the settled reward): losses of tasks differ by
a factor of ten, and a setting that halves one counts alike wherever it does. Every configuration
has the same number of trials and takes its best.

    python -m bench.paper.tuning results/tuning reports/tuning.md
"""

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from statistics import geometric_mean
from typing import NamedTuple

from bench.stats.statistics import Entry, records
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import number, seconds, significant
from bench.text.pages import write_text


class Setting(NamedTuple):
    """What is tuned."""

    lr: float
    decay: float


class Trial(NamedTuple):
    """One configuration with one setting."""

    loss: dict[str, float]
    """Settled loss by task."""
    minutes: float
    """High-fidelity flight [fleet-minutes]."""
    seconds: float
    """Training time [s]."""

    @property
    def mean(self) -> float:
        """Geometric mean over tasks."""
        return geometric_mean(self.loss.values())


Trials = dict[Entry, dict[Setting, Trial]]
"""By configuration and setting."""


def trials(tables: Tables) -> Trials:
    """All trials of a sweep of one team size and seed."""
    settings = {row["run"]: _setting(row["settings"]) for row in records(tables.runs)}
    metrics: dict[str, dict[str, float]] = {}
    for row in records(tables.results):
        metrics.setdefault(row["run"], {})[row["metric"]] = float(row["value"])
    found: dict[Entry, dict[Setting, dict[str, dict[str, float]]]] = {}
    for row in records(tables.runs):
        if row["run"] in metrics:
            own = found.setdefault(Entry(row["method"], row["residual"]), {})
            own.setdefault(settings[row["run"]], {})[row["task"]] = metrics[row["run"]]
    return {
        entry: {
            setting: Trial(
                {task: -m["settled_reward"] for task, m in sorted(by_task.items())},
                math.fsum(m["fleet_minutes"] for m in by_task.values()),
                math.fsum(m["train_seconds"] for m in by_task.values()),
            )
            for setting, by_task in sorted(own.items())
        }
        for entry, own in sorted(found.items())
    }


def chosen(found: Trials) -> dict[Entry, Setting]:
    """What each configuration takes."""
    return {entry: min(own, key=lambda s: own[s].mean) for entry, own in found.items()}


def write_tuning(tables: Tables, path: Path) -> None:
    """Writes the trials, their cost and what was chosen as Markdown."""
    found = trials(tables)
    taken = chosen(found)
    tasks = sorted({task for own in found.values() for t in own.values() for task in t.loss})
    settings = ("configuration", "learning rate", "decay")
    headings = (*settings, *tasks, "mean", "HF fleet-minutes", "time")
    lines = [
        _line(entry, setting, trial, tasks, taken[entry] == setting)
        for entry, own in found.items()
        for setting, trial in own.items()
    ]
    parts = [
        "# How the optimiser was chosen",
        "Settled loss of every trial (lower is better) by task, with the geometric mean over "
        "tasks; three drones, one seed of tuning, on initial states that no result uses. In "
        "bold: what the configuration takes. Configurations that are not listed had no trials: "
        "`hybrid_once`, `recalibrated`, `online` and Hybrid with other residuals take the "
        "setting of `hybrid (mlp)`, `upper_reference` takes the setting of `hf_hotstart`. The "
        "columns of flight and time are sums over the tasks.",
        "`bench run tuning`, then `python -m bench.paper.tuning results/tuning reports/tuning.md`.",
        markdown.table(headings, lines),
    ]
    write_text(path, "\n\n".join(parts) + "\n")


def _line(
    entry: Entry, setting: Setting, trial: Trial, tasks: list[str], taken: bool
) -> tuple[str, ...]:
    mean = significant(trial.mean, 3)
    return (
        markdown.escape(entry.label),
        f"{setting.lr:g}",
        f"{setting.decay:g}",
        *(number(trial.loss.get(task, math.nan), 2) for task in tasks),
        f"**{mean}**" if taken else mean,
        significant(trial.minutes),
        seconds(trial.seconds),
    )


def _setting(text: str) -> Setting:
    trainer: Mapping[str, float] = json.loads(text)["method"]["trainer"]
    return Setting(float(trainer["lr"]), float(trainer["decay"]))


if __name__ == "__main__":
    write_tuning(Tables.load(Path(sys.argv[1])), Path(sys.argv[2]))
