"""Figures of the claims as picture files, for pages that cannot run a script."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import seaborn
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.paper.rule import relative
from bench.paper.values import HYBRID, LF, NAMES, name_of, name_of_method, off_spec, sizes, varied
from bench.report.pictures.looks import MARKERS, look_of, ordered
from bench.stats.choices import BUDGET_VARIANT
from bench.stats.scores import PRIMARY, undisturbed
from bench.stats.statistics import (
    difference,
    estimate,
    matched,
    on_top,
)
from bench.store.tables import Tables

SUMMARY = (
    "Settled reward and share of training steps in contact against team size. There is one column "
    "for each task. Points are means over seeds, bars reach from the worst to the best seed. "
    "Contacts are of methods that train in high fidelity; methods that were run in less than a "
    "quarter of the cells are left out"
)
"""What the figure of the grid shows."""
WORLDS = (
    "Settled reward (further right is better, logarithmic) on drones that are off their "
    "specification: a row for each world (sizes in SI units, masses as shares), a column for each "
    "task, a dot for each seed. *Recalibrated*, *grey box* and *hot start* flew "
    "the changed drone before"
)
"""What the figure of the off-spec drones shows."""
FLIGHTS = (
    "How much more Hybrid loses with few calibration flights than with the whole pool, with one "
    "panel for each team size. Points are means over seeds with one standard deviation. 0 flights: "
    "the LF baseline. Dashed lines: 10 and 15 %, within which the paper's claims are. The axis is "
    "logarithmic beyond 10 %"
)
"""What the figure of the budgets shows."""
SETTINGS = (
    "By how much a single setting raises or lowers the settled reward, in percent of what the "
    "default setting has; right is better. Bars are 95 % t-intervals of the difference, "
    "paired by seed; the axis is logarithmic beyond 10 %"
)
"""What the figure of the settings shows."""
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
"""Settings of a figure in a file."""
CONTACT = "training_crash_step_rate"
"""Share of training steps in contact; drawn of methods that train in high fidelity."""
ROWS = {
    PRIMARY: "settled reward",
    CONTACT: "training steps\nin contact [%]",
}
"""Metrics from top to bottom, and their axis labels."""
LINEAR = 0.5
"""Returns nearer to 0 are drawn on a linear scale, others on a logarithmic one: they go from -0.6,
where the best settle, to -600 of a training that diverged."""


def write_summary(tables: Tables, path: Path) -> bool:
    """Writes a PNG: settled reward (logarithmic) and contacts against team size, a column a task.

    Means over seeds, bars from the worst to the best; default settings. Nothing is written, and
    False returned, where there is nothing to draw.
    """
    rows: list[dict[str, Any]] = [
        {"metric": metric, "task": plain(cell.task), "team_size": cell.team_size, "entry": entry}
        | {"value": value if metric != CONTACT else 100.0 * value}
        for metric in ROWS
        for cell, own in undisturbed(tables, metric).items()
        for entry, seeds in own.items()
        if not entry.variant
        for value in seeds.values()
    ]
    settings = on_top(row["entry"] for row in rows)
    shown = pd.DataFrame(row for row in rows if row["entry"] not in settings)
    if shown.empty:
        return False
    everybody = ordered(shown["entry"])
    cells = {(row["entry"], row["task"], row["team_size"]) for row in rows}
    flown = Counter(entry for entry, *_ in cells)
    most = max(flown[entry] for entry in everybody)
    shown = shown.loc[[4 * flown[entry] >= most for entry in shown["entry"]]]
    # Contact of methods that have any: the others never train in high fidelity.
    crashed = shown["metric"].eq(CONTACT)
    any_contact = shown.loc[crashed & shown["value"].gt(0.0), "entry"].unique()
    shown = shown.loc[~crashed | shown["entry"].isin(any_contact)]
    entries = ordered(shown["entry"])
    names = {entry: plain(name_of(entry)) for entry in entries}
    shown = shown.assign(method=shown["entry"].map(names))
    with plt.rc_context(STYLE):
        grid = seaborn.relplot(
            shown,
            kind="line",
            x="team_size",
            y="value",
            hue="method",
            hue_order=list(names.values()),
            palette={name: look_of(e, everybody)[0] for e, name in names.items()},
            style="method",
            style_order=list(names.values()),
            markers={name: look_of(e, everybody)[1] for e, name in names.items()},
            dashes=False,
            errorbar=_ends,
            err_style="bars",
            row="metric",
            row_order=list(ROWS),
            col="task",
            height=2.8,
            aspect=0.95,
            facet_kws={"sharey": False, "margin_titles": False},
        )
        grid.set_titles("{col_name}")
        grid.set(xticks=sorted(shown["team_size"].unique()))
        for label, axes in zip(ROWS.values(), grid.axes, strict=True):
            axes[0].set_ylabel(label)
        for panel in grid.axes[0]:
            panel.set_yscale("symlog", linthresh=LINEAR)
            panel.set_yticks([-1000, -100, -10, -1])
            panel.set_ylim(*reward_span(panel))
            panel.yaxis.set_major_formatter("{x:g}")
        for panel in grid.axes[1:].flat:
            panel.set_title("")
        grid.set_axis_labels("team size N", None)
        _save(grid, path)
    return True


def reward_span(panel: Axes) -> tuple[float, float]:
    """From below the worst to above the best of what a panel shows, on a scale as of `LINEAR`."""
    low, high = panel.dataLim.y0, panel.dataLim.y1
    return 1.5 * min(low, -1.0), max(0.6 * high, high)


def _ends(values: pd.Series) -> tuple[float, float]:
    """The smallest and the largest value, with the mean between them in spite of rounding."""
    mean = float(values.mean())
    return min(float(values.min()), mean), max(float(values.max()), mean)


def write_worlds(tables: Tables, path: Path) -> bool:
    """Writes a PNG: what is deployed on an off-spec drone, a dot a seed, a row a world.

    Nothing is written, and False returned, where nothing was recalibrated.
    """
    values, returned = off_spec(tables, PRIMARY), ROWS[PRIMARY]
    rows, rewards = [], dict[str, list[float]]()
    for cell, found in sorted(values.items()):
        world = plain(_AT_REST.sub("", cell.deployed_effects))
        where = {"task": plain(cell.task), "team": f"N = {cell.team_size}", "world": world}
        for entry, seeds in found.items():
            name = plain(NAMES[entry])
            rows += [where | {"what": name, returned: value} for value in seeds.values()]
            rewards.setdefault(name, []).extend(seeds.values())
    if not rows:
        return False
    with plt.rc_context(STYLE):
        grid = seaborn.catplot(
            pd.DataFrame(rows),
            kind="strip",
            x=returned,
            y="what",
            order=sorted(rewards, key=lambda name: -estimate(rewards[str(name)]).mean),
            hue="team",
            hue_order=[f"N = {size}" for size in sizes(values)],
            palette="viridis",
            dodge=True,
            jitter=False,
            size=5,
            row="world",
            col="task",
            height=2.2,
            aspect=2.0,
        )
        grid.set_titles("{col_name}, {row_name}")
        grid.set_axis_labels(f"{returned} (right is better)", "")
        for panel in grid.axes.flat:
            panel.set_xscale("symlog", linthresh=LINEAR)
            panel.set_xlim(
                1.5 * min(map(min, rewards.values())), max(0.0, *map(max, rewards.values()))
            )
            panel.set_xticks([-100, -10, -1, 0])
            panel.xaxis.set_major_formatter("{x:g}")
            panel.grid(axis="both", color="0.92")
        _save(grid, path)
    return True


def write_flights(tables: Tables, path: Path) -> bool:
    """Writes a PNG: how much more Hybrid loses with few flights than with the whole pool.

    Nothing is written, and False returned, where the number of flights was not varied.
    """
    rows = []
    for cell, own in undisturbed(tables, PRIMARY).items():
        few = {e: FEW.fullmatch(e.variant) for e in own if e._replace(variant="") == HYBRID}
        flights = {e: int(match[1]) for e, match in few.items() if match}
        if not flights or HYBRID not in own:
            continue
        flights |= {LF: 0} if LF in own else {}
        for entry, n in flights.items():
            few_seeds, whole = matched(own[entry], own[HYBRID])
            base = estimate(whole.values()).mean
            rows += [
                {"task": plain(cell.task), "N": cell.team_size, "calibration flights": n}
                | {"loses more [%]": 100.0 * relative(base - value, base)}
                for value in few_seeds.values()
            ]
    if not rows:
        return False
    flights, loss = "calibration flights", "loses more [%]"
    with plt.rc_context(STYLE):
        grid = seaborn.relplot(
            pd.DataFrame(rows),
            kind="line",
            x=flights,
            y=loss,
            hue="task",
            style="task",
            col="N",
            markers=True,
            dashes=False,
            errorbar="sd",
            err_style="bars",
            height=2.3,
            aspect=1.4,
        )
        grid.set_titles("N = {col_name}")
        grid.set(xscale="symlog", xlim=(-0.3, 2.0 * max(1, *(row[flights] for row in rows))))
        for panel in grid.axes.flat:
            panel.set_yscale("symlog", linthresh=10.0)
            panel.set_yticks([-10, 0, 10, 100, 1000, 10000])
            panel.yaxis.set_major_formatter("{x:g}")
            panel.set_ylim(-20.0, 2.0 * max(10.0, *(row[loss] for row in rows)))
            for claimed in (10.0, 15.0):
                panel.axhline(claimed, color="0.6", linewidth=0.8, linestyle="--")
        _save(grid, path)
    return True


def write_settings(tables: Tables, path: Path) -> bool:
    """Writes a PNG: what each setting changes beside its default, a row a setting, a point a cell.

    A task has a colour, a team size a mark. Budgets of flight have a figure of their own. Nothing
    is written, and False returned, where no setting was varied in two seeds or more.
    """
    shown = [
        (one, difference(one.other, one.base), abs(estimate(one.base.values()).mean))
        for one in varied(tables)
        if min(len(one.other), len(one.base)) > 1
        and not BUDGET_VARIANT.fullmatch(one.entry.variant)
    ]
    entries = sorted({one.entry for one, _, _ in shown})
    cells = sorted({(one.cell.task, one.cell.team_size) for one, _, _ in shown})
    if not entries:
        return False
    tasks, team_sizes = (sorted(set(column)) for column in zip(*cells, strict=True))
    colors = seaborn.color_palette("colorblind", len(tasks))
    series, looks = {}, []
    for k, (task, n) in enumerate(cells):
        looks.append((colors[tasks.index(task)], MARKERS[team_sizes.index(n) % len(MARKERS)]))
        own = [x for x in shown if (x[0].cell.task, x[0].cell.team_size) == (task, n)]
        beside = 0.5 * (k + 0.5) / len(cells) - 0.25
        series[f"{task}, N = {n}"] = [
            (entries.index(one.entry) + beside, *(100.0 / base * x for x in ends))
            for one, apart, base in own
            for ends in [(apart.mean, apart.low, apart.high)]
        ]
    names = [f"{name_of_method(e)}, {e.variant}" for e in entries]
    figure, axes = _intervals(names, series, looks)
    axes.axvline(0.0, color="0.4", linewidth=0.8)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.set_xticks([-1000, -100, -10, 0, 10, 100])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("settled reward beside the default [%] (right is better)")
    return saved(figure, path, tight=True)


def write_gaps(
    names: Sequence[str], gaps: Mapping[str, Sequence[tuple[float, float, float]]], path: Path
) -> None:
    """Writes a PNG: 1 minus the score of each method in each world, a line a method.

    Args:
        names: The methods, from top to bottom.
        gaps: Mean with the ends of its interval by world, as long as `names`; NaN where unknown.
        path: Of the picture.
    """
    series = {
        # An interval that reaches a score of 1 would have no end on a logarithmic axis.
        world: [
            (i + 0.6 * (k + 0.5) / len(gaps) - 0.3, mean, max(low, 0.1 * mean), high)
            for i, (mean, low, high) in enumerate(values)
        ]
        for k, (world, values) in enumerate(gaps.items())
    }
    colors = seaborn.color_palette("colorblind", len(series))
    looks = [(color, MARKERS[i % len(MARKERS)]) for i, color in enumerate(colors)]
    figure, axes = _intervals(names, series, looks)
    axes.set(xscale="log", xlabel="1 minus the score, mean over the cells (left is better)")
    saved(figure, path, tight=True)


def _intervals(
    names: Sequence[str],
    series: Mapping[str, Sequence[tuple[float, float, float, float]]],
    looks: Sequence[tuple[tuple[float, float, float], str]],
) -> tuple[Figure, Axes]:
    """A line a name, a colour and mark a series: of each point the line, mean, low and high end.

    An end that is no number is not drawn.
    """
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(6.0, 0.8 + 0.4 * len(names)))
        for (label, points), (color, mark) in zip(series.items(), looks, strict=True):
            at, mean, low, high = np.asarray(points, float).T
            axes.errorbar(
                mean, at, xerr=np.nan_to_num([mean - low, high - mean]), fmt=mark,
                color=color, label=plain(label), markersize=5, elinewidth=1.2,
            )  # fmt: skip
        axes.set(yticks=range(len(names)), yticklabels=[plain(name) for name in names])
        axes.invert_yaxis()
        axes.grid(axis="both", color="0.92")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure, axes


_AT_REST = re.compile(r", \w+=0(?=[,)])")
"""Parameters that are 0; the title of a panel leaves them out."""
FEW = re.compile(r"flights=(\d+)")
"""Variant of a Hybrid of which nothing differs but the number of flights."""


def saved(figure: Figure, path: Path, *, tight: bool = False) -> bool:
    """True, after the figure was written, without margins if it is to be tight, and closed."""
    figure.savefig(path, dpi=110, bbox_inches="tight" if tight else None)
    plt.close(figure)
    return True


def _save(grid: seaborn.FacetGrid, path: Path) -> None:
    """Writes the picture, whose legend needs no title."""
    if grid.legend is not None:
        grid.legend.set_title("")
    saved(grid.figure, path, tight=True)


def plain(name: str) -> str:
    """A name that matplotlib does not read as mathematics."""
    return name.replace("$", r"\$")
