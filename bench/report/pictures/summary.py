"""Cost and reward against team size, a panel a task and metric; for sweeps of several sizes."""

import numpy as np
from matplotlib.axes import Axes

from bench.report.pictures.looks import Key, legend, on_page, ordered
from bench.report.pictures.svg import Panel, name, plain_ticks, render
from bench.stats.scores import PRIMARY, UPPER
from bench.stats.statistics import Cell, Entry, default_of, estimate, seed_values
from bench.store.tables import Tables

SUMMARY_INTRO = (
    "Mean over seeds with one standard deviation, default settings. Lines only guide the eye, and "
    "markers stand side by side to be told apart."
)
COSTS = {
    "fleet_minutes": "HF fleet-minutes",
    "training_crashes": "HF training crashes",
}
"""Metrics beside the reward, on an axis that is logarithmic but near 0."""
WIDTH = 0.12
"""Share of the distance of two team sizes over which markers are spread."""


def summary_panels(tables: Tables) -> tuple[list[tuple[str, list[Panel]]], list[Key]]:
    """Panels by task and world, and who is drawn how; none of a task with one team size."""
    names = {PRIMARY: PRIMARY.replace("_", " ")} | COSTS
    values = {metric: seed_values(tables.results, metric) for metric in names}
    groups: dict[str, list[Cell]] = {}
    for cell in values[PRIMARY]:
        groups.setdefault(cell._replace(team_size=0).label.replace(", N = 0", ""), []).append(cell)
    groups = {title: cells for title, cells in groups.items() if len(cells) > 1}
    drawn = {e for cells in groups.values() for c in cells for e in values[PRIMARY][c]}
    everybody = ordered({e for e in drawn if default_of(e) == e and e.method != UPPER})
    found = []
    for i, (title, cells) in enumerate(groups.items()):
        panels = []
        for metric, label in names.items():
            own = {cell.team_size: values[metric].get(cell, {}) for cell in cells}
            salt = f"summary-{i}-{metric}"
            panels.append(_panel(title, label, own, everybody, metric in COSTS, salt))
        found.append((title, panels))
    return found, legend(everybody, everybody)


def _panel(
    title: str,
    label: str,
    own: dict[int, dict[Entry, dict[int, float]]],
    everybody: list[Entry],
    log: bool,
    salt: str,
) -> Panel:
    sizes = sorted(own)
    room = WIDTH * float(np.diff(sizes).min())

    def draw(axes: Axes) -> None:
        for i, entry in enumerate(everybody):
            color, marker = on_page(entry, everybody)
            found = [estimate(own[n].get(entry, {}).values()) for n in sizes]
            shift = room * (i / max(1, len(everybody) - 1) - 0.5)
            line = axes.errorbar(
                [n + shift for n in sizes],
                [x.mean for x in found],
                yerr=[np.nan_to_num(x.std) for x in found],
                color=color,
                marker=marker,
                markersize=4,
                linewidth=1.0,
            )
            name(line.lines[0], entry.label)
        if log:
            axes.set_yscale("symlog", linthresh=1)
            axes.set_ylim(bottom=-0.2)
            plain_ticks(axes.yaxis)
        axes.set(xlabel="team size N", ylabel=label, xticks=sizes)

    alt = f"{label} of {len(everybody)} methods against team size on {title}; the board has them."
    return Panel(label, render(draw, salt), alt)
