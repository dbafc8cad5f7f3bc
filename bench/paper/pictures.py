"""Pictures beside the claims: how policies are trained, what that costs, and what teams fly.

    python -m bench.paper.pictures OUT results/paper

keeps of the trajectories in OUT, a folder that `bench run` wrote to, those that the top views show.
"""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from bench.paper.figures import LINEAR, STYLE, plain, reward_span, saved
from bench.paper.values import GREY_BOX, HYBRID, NAMES, name_of
from bench.report.pictures.cost import Mark, draw_marks, up_to
from bench.report.pictures.looks import look_of, ordered
from bench.stats.choices import at_budgets
from bench.stats.scores import PRIMARY, undisturbed
from bench.stats.statistics import FEWEST_SEEDS, Entry, entry_of, estimate, records
from bench.store.tables import FEW_TRAJECTORIES, Tables

COST = (
    "Settled reward against high-fidelity flight, a panel for each task and team size; up and to "
    "the left is better. Points are medians over seeds, bars reach from the worst to the best "
    "seed. Both axes are logarithmic, except near 0. Small markers are other budgets of the same "
    "method: fewer or more calibration flights, or trainings that were cut off. Methods that were "
    "run in half of the panels or fewer are left out"
)
"""What the figure of the cost shows."""
PIPELINE = (
    "How a policy is trained without flying it in high fidelity: Hybrid, the paper's pipeline, "
    "above, and grey box below"
)
"""What the drawing of the pipeline shows."""
VIEWS = (
    "One evaluation episode of five drones from above, a column a task: circles where drones "
    "start, stars where they end, older positions fainter"
)
"""What the top views show."""
TEAM_SIZE = 5
"""Number of drones of the top views, as in the paper."""
LOW, HIGH, BOTH = "#dbe9f6", "#fde3cf", "#e3e3e3"
"""Colours of boxes: in low fidelity, in high fidelity, in neither."""
BOXES = {
    "lf": (0.0, 1.0, "LF policy\nBPTT in the point mass", LOW),
    "reference": (1.0, 1.0, "reference paths\nof single roles", LOW),
    "pool": (2.0, 1.0, "calibration flights\none drone, PD control\n60 (N + 1), or fewer", HIGH),
    "residual": (3.0, 1.0, "residual\nfit to the gap of\nacceleration, frozen", BOTH),
    "paths": (1.0, 0.0, "three fixed paths\nfor every task and team", LOW),
    "flights": (2.0, 0.0, "three flights\none drone, PD control\n0.5 fleet-minutes", HIGH),
    "effects": (3.0, 0.0, "named effects\nidentified from\nthe flights", BOTH),
    "train": (4.0, 0.5, "BPTT from a fresh policy\nin the corrected\npoint mass", LOW),
    "deploy": (5.0, 0.5, "deployment\n64 episodes in\nhigh fidelity", HIGH),
}
"""Column, row, text and colour of each box."""
ARROWS = (
    ("lf", "reference"),
    ("reference", "pool"),
    ("pool", "residual"),
    ("paths", "flights"),
    ("flights", "effects"),
    ("residual", "train"),
    ("effects", "train"),
    ("train", "deploy"),
)
"""What follows on what."""
WIDTH, HEIGHT, GAP = 1.72, 0.62, 2.05
"""Size of a box and distance of columns [in]."""


def write_pipeline(_: Tables, path: Path) -> bool:
    """Writes a PNG: the stages of Hybrid (above) and grey box (below), with what each flies."""
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(6 * GAP + 0.2, 2.6))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_xlim(-0.1, 6 * GAP + 0.1)
        axes.set_ylim(-0.25, 2.35)
        axes.axis("off")
        for column, row, text, color in BOXES.values():
            x, y = column * GAP, 1.15 * row + 0.1
            axes.add_patch(Rectangle((x, y), WIDTH, HEIGHT, facecolor=color, edgecolor="#666666"))
            axes.text(x + WIDTH / 2, y + HEIGHT / 2, text, ha="center", va="center", fontsize=8.5)
        for first, last in ARROWS:
            (x0, y0), (x1, y1) = (
                (BOXES[name][0] * GAP, 1.15 * BOXES[name][1] + 0.1 + HEIGHT / 2)
                for name in (first, last)
            )
            axes.annotate(
                "",
                xy=(x1, y1),
                xytext=(x0 + WIDTH, y0),
                arrowprops={"arrowstyle": "-|>", "color": "#444444"},
            )
        for name, y in (("Hybrid", 1.15 + HEIGHT + 0.2), ("grey box", HEIGHT + 0.2)):
            axes.text(GAP * (0 if y > 1.0 else 1), y, name, fontsize=10, fontweight="bold")
        keys = ((LOW, "low fidelity"), (HIGH, "high fidelity"), (BOTH, "fit"))
        for i, (color, text) in enumerate(keys):
            x = 4 * GAP + 1.35 * i
            axes.add_patch(Rectangle((x, 2.05), 0.22, 0.14, facecolor=color, edgecolor="#666666"))
            axes.text(x + 0.3, 2.12, text, va="center", fontsize=8.5)
        return saved(figure, path)


def write_cost(tables: Tables, path: Path) -> bool:
    """Writes a PNG: settled reward against fleet-minutes, a column a task, a row a team size.

    Of the team sizes at which most methods were run, the smallest and the largest. Points are
    medians over seeds; bars reach from the worst seed to the best. Nothing is written, and False
    returned, where no method has two seeds.
    """
    rewards, bills = (
        at_budgets(undisturbed(tables, metric), FEWEST_SEEDS)
        for metric in (PRIMARY, "fleet_minutes")
    )
    marks: dict[tuple[int, str], list[Mark]] = {}
    for cell, own in rewards.items():
        for entry, seeds in own.items():
            if paid := [*bills.get(cell, {}).get(entry, {}).values()]:
                mark = _mark(entry, estimate(paid).mean, [*seeds.values()])
                marks.setdefault((cell.team_size, cell.task), []).append(mark)
    if not marks:
        return False
    teams, tasks = _fullest(marks), sorted({task for _, task in marks})
    panels = [own for (n, _), own in marks.items() if n in teams]
    run = Counter(e for own in panels for e in {m.entry._replace(variant="") for m in own})
    entries = ordered(e for e in run if 2 * run[e] > len(panels))
    everybody = ordered(m.entry._replace(variant="") for own in marks.values() for m in own)

    def look(entry: Entry, _: object) -> tuple[str, str]:
        return look_of(entry, everybody)

    with plt.rc_context(STYLE):
        size = (2.5 * len(tasks) + 1.7, 2.5 * len(teams) + 0.3)
        figure, axes = plt.subplots(len(teams), len(tasks), figsize=size, squeeze=False)
        for row, n in zip(axes, teams, strict=True):
            for panel, task in zip(row, tasks, strict=True):
                own = marks.get((n, task), [])
                draw_marks(panel, own, entries, look, lambda entry: plain(name_of(entry)))
                panel.set_title(f"{plain(task)}, N = {n}")
                if not own:
                    panel.text(0.5, 0.5, "not run", ha="center", transform=panel.transAxes)
                    panel.set_axis_off()
                    continue
                _scale(panel)
            row[0].set_ylabel("settled reward")
        shown: dict[str, Any] = {}
        for panel in axes.flat:
            handles, labels = panel.get_legend_handles_labels()
            shown |= dict(zip(labels, handles, strict=True))
        names = [name for e in entries if (name := plain(name_of(e))) in shown]
        figure.legend(
            [shown[name] for name in names],
            names,
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            frameon=False,
        )
        figure.tight_layout()
        return saved(figure, path, tight=True)


def _mark(entry: Entry, minutes: float, rewards: list[float]) -> Mark:
    """The median over seeds, with bars from the worst to the best."""
    middle = float(np.median(rewards))
    return Mark(entry, minutes, middle, [[middle - min(rewards)], [max(rewards) - middle]])


def _fullest(marks: Mapping[tuple[int, str], Sequence[Mark]]) -> list[int]:
    """Smallest and largest of the team sizes at which most methods were run.

    A method of one team size alone does not count: its panels would be all that is shown.
    """
    run: dict[Entry, set[int]] = {}
    for (n, _), own in marks.items():
        for mark in own:
            run.setdefault(mark.entry._replace(variant=""), set()).add(n)
    count = {n: sum(n in sizes for sizes in run.values() if len(sizes) > 1) for n, _ in marks}
    most = [n for n in count if count[n] == max(count.values())]
    return sorted({min(most), max(most)})


def _scale(panel: Axes) -> None:
    """Logarithmic, but near 0; the best on top."""
    panel.set_yscale("symlog", linthresh=LINEAR)
    bottom, top = reward_span(panel)
    panel.set_ylim(bottom, top)
    panel.set_yticks([y for y in (-1000, -100, -10, -1, 0) if bottom <= y <= top])
    up_to(panel, panel.dataLim.x1)
    panel.set_xticks([x for x in (0, 1, 10, 100, 1000) if x <= panel.get_xlim()[1]])
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter("{x:g}")


def write_top_views(tables: Tables, path: Path, team_size: int = TEAM_SIZE) -> bool:
    """Writes a PNG: one episode from above, a column a task, a row a method.

    Nothing is written, and False returned, where no trajectory of that team size is there.
    """
    flown = _flights(tables, team_size)
    tasks = list(dict.fromkeys(task for _, task in flown))
    methods = [entry for entry in (HYBRID, GREY_BOX) if any(e == entry for e, _ in flown)]
    if not flown:
        return False
    with plt.rc_context(STYLE):
        size = (2.6 * len(tasks) + 0.4, 2.6 * len(methods) + 0.4)
        figure, axes = plt.subplots(len(methods), len(tasks), figsize=size, squeeze=False)
        for row, entry in zip(axes, methods, strict=True):
            for panel, task in zip(row, tasks, strict=True):
                if (entry, task) in flown:
                    _view(panel, flown[entry, task])
                panel.set_aspect("equal", adjustable="datalim")
                panel.set_xlabel("x [m]")
            row[0].set_ylabel(f"{NAMES.get(entry, entry.label)}\ny [m]")
        for panel, task in zip(axes[0], tasks, strict=True):
            panel.set_title(task)
        figure.tight_layout()
        return saved(figure, path)


def keep_flights(tables: Tables, directory: Path, team_size: int = TEAM_SIZE) -> None:
    """Writes the trajectories of the top views beside other tables, as `flights.parquet`."""
    flown = [path for _, path in sorted(_flights(tables, team_size).items())]
    pd.concat(flown, ignore_index=True).to_parquet(directory / FEW_TRAJECTORIES, index=False)


def _flights(tables: Tables, team_size: int) -> dict[tuple[Entry, str], pd.DataFrame]:
    """Trajectory of the smallest seed of each method, by method and task, undisturbed."""
    results = tables.results.drop_duplicates("run")
    plain = results["deployed_effects"].eq("") & results["team_size"].eq(team_size)
    paths = {str(run): rows for run, rows in tables.trajectories.groupby("run")}
    found: dict[tuple[Entry, str], pd.DataFrame] = {}
    for row in sorted(records(results.loc[plain]), key=lambda r: (r["task"], r["seed"])):
        entry = entry_of(row)
        if entry in (HYBRID, GREY_BOX) and row["run"] in paths:
            found.setdefault((entry, row["task"]), paths[row["run"]])
    return found


def _view(panel: Axes, path: pd.DataFrame) -> None:
    """Paths whose older parts are fainter; circles where they start, stars where they end."""
    colors = plt.get_cmap("tab10")
    for i, (_, own) in enumerate(path.sort_values("t").groupby("drone")):
        xy, color = own[["pos_x", "pos_y"]].to_numpy(float), colors(i % 10)
        for j in range(len(xy) - 1):
            faded = 0.1 + 0.9 * (j + 1) / len(xy)
            panel.plot(*xy[j : j + 2].T, color=color, alpha=faded, linewidth=1.2)
        panel.plot(*xy[0], marker="o", color=color, fillstyle="none", markersize=6)
        panel.plot(*xy[-1], marker="*", color=color, markersize=9)
    reach = np.ptp(path[["pos_x", "pos_y"]].to_numpy(float), axis=0).max()
    panel.margins(0.05 if np.isfinite(reach) else 0.0)


if __name__ == "__main__":
    keep_flights(Tables.load(Path(sys.argv[1])), Path(sys.argv[2]))
