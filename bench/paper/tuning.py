"""How an optimiser is chosen from trials, by one rule for all configurations: `reports/tuning.md`.

A trial is a configuration with a learning rate and a decay of the gradient. Its number is the
geometric mean over tasks of the settled loss (minus the settled reward): losses of tasks differ by
a factor of ten, and a setting that halves one counts alike wherever it does. Every configuration
has the same number of trials and takes its best.

    python -m bench.paper.tuning results/tuning reports/tuning.md
"""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from bench.stats.statistics import Entry
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import number, seconds, significant
from bench.text.pages import write_text

TRIAL = ["method", "residual", "lr", "decay"]
"""Columns that tell one trial from another."""


def write_tuning(tables: Tables, path: Path) -> None:
    """Writes the trials, their cost and what was chosen as Markdown."""
    trials = _trials(tables)
    loss = -trials.pivot(index=TRIAL, columns="task", values="settled_reward")
    means = np.exp(np.log(loss).mean(axis=1))
    taken = set(means.groupby(["method", "residual"]).idxmin())
    columns = ["fleet_minutes", "train_seconds"]
    cost = trials.pivot_table(index=TRIAL, values=columns, aggfunc="sum").to_numpy()
    settings = ("configuration", "learning rate", "decay")
    headings = (*settings, *loss, "mean", "HF fleet-minutes", "time")
    lines = []
    rows = zip(loss.index, loss.to_numpy(), means, cost, strict=True)
    for trial, losses, mean, (flown, taking) in rows:
        method, residual, lr, decay = trial
        shown = significant(mean, 3)
        lines.append(
            (
                markdown.escape(Entry(method, residual).label),
                f"{lr:g}",
                f"{decay:g}",
                *(number(value, 2) for value in losses),
                f"**{shown}**" if trial in taken else shown,
                significant(flown),
                seconds(taking),
            )
        )
    parts = [
        "# How the optimiser was chosen",
        "Settled loss of every trial (lower is better) by task, with the geometric mean over "
        "tasks; three drones, one seed of tuning, on initial states that no result uses. In "
        "bold: what the configuration takes. Configurations that are not listed had no trials: "
        "`hybrid_once`, `recalibrated`, `online` and Hybrid with other residuals take the "
        "setting of `hybrid (mlp)`, `upper_reference` takes the setting of `hf_hotstart`. The "
        "columns of flight and time are sums over the tasks.",
        _ends(taken, trials),
        "`bench run tuning`, then `python -m bench.paper.tuning results/tuning reports/tuning.md`.",
        markdown.table(headings, lines),
    ]
    write_text(path, "\n\n".join(parts) + "\n")


def _ends(taken: set[tuple[str, str, float, float]], trials: pd.DataFrame) -> str:
    """How many configurations take an end of what was tried: better settings may lie beyond."""
    largest, smallest = trials["lr"].max(), trials["decay"].min()
    fast = sum(lr == largest for _, _, lr, _ in taken)
    short = sum(decay == smallest for *_, decay in taken)
    return (
        f"{fast} of {len(taken)} configurations take the largest learning rate that was tried "
        f"({largest:g}), {short} the smallest decay ({smallest:g}). Beyond these nothing was "
        "tried, so that better settings may exist."
    )


def _trials(tables: Tables) -> pd.DataFrame:
    """Runs that have results, with the setting of their optimiser and their metrics as columns."""
    runs = tables.runs.set_index("run")
    trainers = runs["settings"].map(lambda text: json.loads(text)["method"]["trainer"])
    for key in ("lr", "decay"):
        runs[key] = [float(trainer[key]) for trainer in trainers]
    metrics = tables.results.pivot(index="run", columns="metric", values="value")
    return runs.join(metrics, how="inner")


if __name__ == "__main__":
    write_tuning(Tables.load(Path(sys.argv[1])), Path(sys.argv[2]))
