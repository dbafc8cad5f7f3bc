"""Figures of the blind report as PNG files."""

import json
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import seaborn
from matplotlib.axes import Axes

from bench.paper.figures import STYLE, saved
from bench.report.pictures.looks import COLORS
from bench.stats.statistics import records
from blind.report import limits_section as limits
from blind.report import next_flight_section as next_flight
from blind.report.sections import COVERAGE, INTERVALS, OUR_COLOR, asked
from blind.report.tables import OURS, Tables

AIMS = (
    "Scores with 95 % Clopper-Pearson intervals, on decidable cases (share of intervals: on all "
    "true effects that were named); the black bar is the aim, two bars its ends. Beside it three "
    "simple baselines: residual correlation, sparse regression (STLSQ) and a fit of everything"
)
CONFUSION = (
    "Single effects: what was true (rows), and what was answered (columns), in cases. Answers with "
    "more than one effect stand under the most probable one"
)
RELIABILITY = "How often effects that were named with a probability were true; the size is cases"
ERRORS = "Relative parameter error of right answers against the size of the effect"


def write_pictures(tables: Tables, directory: Path) -> list[tuple[Path, str]]:
    """Writes what there is to draw; paths with what they show."""
    reality = tables.run["reality"]
    drawings: list[tuple[str, str, Callable[[Tables, Path], bool]]] = [
        ("aims", AIMS, _aims),
        ("confusion", CONFUSION, _confusion),
        ("reliability", RELIABILITY, _reliability),
        ("errors", ERRORS, _errors),
        ("limits", limits.CAPTION, limits.draw),
        ("next_flight", next_flight.CAPTION, next_flight.draw),
    ]
    directory.mkdir(parents=True, exist_ok=True)
    found = []
    for name, caption, draw in drawings:
        path = directory / f"{reality}_{name}.png"
        with plt.rc_context(STYLE):
            if draw(tables, path):
                found.append((path, caption))
    return found


def _aims(tables: Tables, path: Path) -> bool:
    """Scores with an aim, ours beside the baselines'."""
    table = tables.proportions
    shown = table.loc[table["aim"].notna() & (table["n"] > 0)]
    shown = shown.loc[
        (shown["cases"] == "decidable") | (shown["score"] == "truth inside 95 % intervals")
    ]
    if shown.empty:
        return False
    scores = list(dict.fromkeys(shown["score"]))
    everybody = list(dict.fromkeys(table["who"]))
    figure, axes = plt.subplots(figsize=(8.0, 0.7 * len(scores) + 1.2), layout="constrained")
    for i, who in enumerate(everybody):
        mine = shown.loc[shown["who"] == who]
        mine = mine.loc[[asked(score, who) for score in mine["score"]]]
        y = np.asarray([scores.index(s) for s in mine["score"]]) + 0.16 * (i - len(everybody) / 2)
        ends = np.abs(mine[["low", "high"]].to_numpy().T - mine["value"].to_numpy())
        axes.errorbar(
            mine["value"],
            y,
            xerr=ends,
            fmt="o" if who == OURS else "s",
            ms=5,
            capsize=2,
            color=OUR_COLOR if who == OURS else COLORS[i % len(COLORS)],
            label=who,
        )
    for i, name in enumerate(scores):
        aim = float(shown.loc[shown["score"] == name, "aim"].iloc[0])
        for end in COVERAGE if name == INTERVALS else (aim,):
            axes.plot([end, end], [i - 0.42, i + 0.32], color="black", lw=2)
    axes.set(yticks=range(len(scores)), yticklabels=scores, xlim=(-0.02, 1.02), xlabel="share")
    axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=len(everybody), fontsize=8, frameon=False)
    return saved(figure, path)


def _confusion(tables: Tables, path: Path) -> bool:
    singles = [row for row in records(tables.cases) if row["kind"] == "single"]
    if not singles:
        return False
    truth = np.asarray([row["truth"] for row in singles], dtype=object)
    first = [_first(row["answer"], row["probabilities"]) for row in singles]
    table = pd.crosstab(truth, np.asarray(first, dtype=object))
    effects = sorted(set(table.index) | {c for c in table.columns if c not in _OTHER})
    columns = [*effects, *(other for other in _OTHER if other in table.columns)]
    table = table.reindex(index=sorted(table.index), columns=columns, fill_value=0)
    size = (0.38 * len(columns) + 2.6, 0.34 * len(table) + 1.9)
    figure, axes = plt.subplots(figsize=size, layout="constrained")
    seaborn.heatmap(
        table,
        annot=table.astype(str).where(table > 0, ""),
        fmt="",
        cmap="Blues",
        cbar=False,
        square=False,
        linewidths=0.5,
        linecolor="#e5e9ee",
        ax=axes,
    )
    axes.set(xlabel="answer", ylabel="truth")
    axes.tick_params(axis="x", rotation=60)
    plt.setp(axes.get_xticklabels(), horizontalalignment="right")
    return saved(figure, path)


_OTHER = ("none", "unexplained", "failed")


def _first(answer: str, probabilities: str) -> str:
    """The effect that is named first, or the verdict."""
    stated = json.loads(probabilities)
    return max(stated, key=lambda name: stated[name] or 0.0) if stated else answer


def _reliability(tables: Tables, path: Path) -> bool:
    table = tables.reliability
    if table.empty:
        return False
    figure, axes = plt.subplots(figsize=(4.2, 4.0), layout="constrained")
    axes.plot([0, 1], [0, 1], color="#9aa5b1", lw=1, ls="--")
    ends = np.abs(table[["low", "high"]].to_numpy().T - table["value"].to_numpy())
    axes.errorbar(
        table["stated"], table["value"], yerr=ends, fmt="none", capsize=3, color=OUR_COLOR
    )
    axes.scatter(table["stated"], table["value"], s=20 + 2 * table["n"], color=OUR_COLOR)
    for _, row in table.iterrows():
        axes.annotate(f"  {row['n']:.0f}", (row["stated"], row["value"]), fontsize=8)
    axes.set(xlabel="stated probability", ylabel="share that was true", xlim=(0, 1.08))
    axes.set_ylim(-0.02, 1.05)
    return saved(figure, path)


def _errors(tables: Tables, path: Path) -> bool:
    table = tables.parameters
    shown = table.loc[
        table["relative"].astype(bool) & ~table["size"].str.contains("+", regex=False)
    ]
    if shown.empty:
        return False
    effects = sorted(shown["effect"].unique())
    figure, axes = plt.subplots(figsize=(8.0, 3.8), layout="constrained")
    percent = 100.0 * np.maximum(shown["error"].to_numpy(float), 1e-4)
    _strip(shown.assign(percent=percent), effects, axes)
    axes.axhline(3.0, color="black", lw=1, ls=":")
    axes.set(yscale="log", xlabel="", ylabel="error [% of the size]")
    axes.tick_params(axis="x", rotation=60)
    plt.setp(axes.get_xticklabels(), horizontalalignment="right")
    return saved(figure, path)


def _strip(shown: pd.DataFrame, effects: list[str], axes: Axes) -> None:
    seaborn.stripplot(
        shown,
        x="effect",
        y="percent",
        hue="size",
        order=effects,
        hue_order=["small", "medium", "large"],
        dodge=True,
        jitter=False,  # it would be another picture each time
        size=4,
        palette=list(COLORS[:3]),
        ax=axes,
    )
    axes.legend(title="", fontsize=8)
