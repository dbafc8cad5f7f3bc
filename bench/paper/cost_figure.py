"""How far each method is from the best known, against high-fidelity flight, as a picture.

The gap is 1 - settled score: 1 is a team that stays at its spawn, 0 the upper reference. Its axis
is logarithmic, because the methods' gaps differ by factors, and has the best on top.

A method at its default budget is a large marker. Fewer calibration flights and trainings that were
cut short (suite `budget`) are small ones of the same colour, joined in the order of their bills.
"""

import re
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from bench.paper.budget import name_of
from bench.paper.figures import STYLE, look_of, ordered, plain
from bench.paper.values import at_home, undisturbed
from bench.stats.scores import scored
from bench.stats.statistics import FEWEST, Cell, Entry, Values, estimate, seed_values
from bench.store.tables import Tables

BUDGET = re.compile(r"flights=\d+|flown=grey_box|trainer\.share=[\d.]+")
"""Variants that differ from the default in their budget of flight alone."""
FINEST = 1e-3
"""Gap below which the axis is linear; scores of five seeds tell no finer apart."""


class Point(NamedTuple):
    """What an entry is worth and what it flies, at one team size."""

    entry: Entry
    minutes: float
    """Mean bill over tasks and seeds [fleet-minutes]."""
    score: float
    """Mean over tasks of the mean over seeds."""
    spread: float | None
    """Root mean square over tasks of the standard deviation over seeds; None with one seed."""


def write_cost(tables: Tables, path: Path) -> bool:
    """Writes a PNG: gap to the upper reference against fleet-minutes, a panel a team size.

    Nothing is written, and False returned, where nothing has a score.
    """
    found = points(tables)
    if not found:
        return False
    entries = ordered({p.entry._replace(variant="") for own in found.values() for p in own})
    with plt.rc_context(STYLE):
        width = 2.6 * len(found) + 1.6
        figure, axes = plt.subplots(
            1, len(found), figsize=(width, 3.2), sharex=True, sharey=True, squeeze=False
        )
        for (n, own), panel in zip(sorted(found.items()), axes[0], strict=True):
            _draw(panel, own, entries)
            panel.axhline(0.0, color="#999999", linewidth=0.8, linestyle=":")
            panel.set_title(f"N = {n}")
            panel.set_xlabel("HF flight [fleet-minutes]")
        axes[0][0].set_ylabel("gap to the upper reference")
        _scale_gap(axes[0][0], found)
        axes[0][0].set_xscale("symlog", linthresh=0.1)
        largest = max(p.minutes for own in found.values() for p in own)
        axes[0][0].set_xlim(-0.05, max(1.0, 3.0 * largest))
        _legend(figure, axes[0], [plain(name_of(e)) for e in entries])
        figure.tight_layout()
        figure.savefig(path, dpi=110, bbox_inches="tight")
        plt.close(figure)
    return True


def _scale_gap(panel: Axes, found: dict[int, list[Point]]) -> None:
    """Logarithmic, best on top; bars that reach beyond all means do not set the range."""
    gaps = [1.0 - p.score for own in found.values() for p in own]
    panel.set_yscale("symlog", linthresh=FINEST)
    panel.set_ylim(2.0 * max(*gaps, FINEST), min(2.0 * min(gaps), -FINEST))


def points(tables: Tables) -> dict[int, list[Point]]:
    """What is drawn, by team size; an entry needs bills of two seeds in a cell."""
    scores = _budgets(at_home(seed_values(scored(tables), "score"), tables))
    bills = _budgets(undisturbed(tables, "fleet_minutes"), FEWEST)
    found: dict[int, list[Point]] = {}
    for n in sorted({cell.team_size for cell in scores}):
        cells = [cell for cell in scores if cell.team_size == n]
        for entry in sorted({e for cell in cells for e in scores[cell]}):
            if minutes := [x for c in cells for x in bills.get(c, {}).get(entry, {}).values()]:
                own = [estimate(scores[c][entry].values()) for c in cells if entry in scores[c]]
                found.setdefault(n, []).append(_point(entry, minutes, own))
    return found


def _point(entry: Entry, minutes: list[float], own: list[Any]) -> Point:
    squares = [x.std**2 for x in own if x.has_interval]
    score = float(np.mean([x.mean for x in own]))
    spread = float(np.sqrt(np.mean(squares))) if squares else None
    return Point(entry, float(np.mean(minutes)), score, spread)


def _budgets(values: Values, fewest: int = 1) -> dict[Cell, dict[Entry, dict[int, float]]]:
    """Default settings and other budgets, with at least so many seeds in a cell."""
    return {
        cell: {
            entry: seeds
            for entry, seeds in own.items()
            if len(seeds) >= fewest and (not entry.variant or BUDGET.fullmatch(entry.variant))
        }
        for cell, own in values.items()
    }


def _draw(panel: Axes, own: list[Point], entries: list[Entry]) -> None:
    for entry in entries:
        color, marker = look_of(entry, entries)
        family = sorted(
            (p for p in own if p.entry._replace(variant="") == entry), key=lambda p: p.minutes
        )
        if len(family) > 1:
            xy = [(p.minutes, 1.0 - p.score) for p in family]
            panel.plot(*zip(*xy, strict=True), color=color, linewidth=0.8, alpha=0.6)
        for point in family:
            default = not point.entry.variant
            panel.errorbar(
                point.minutes,
                1.0 - point.score,
                yerr=point.spread,
                color=color,
                marker=marker,
                markersize=6 if default else 3,
                linestyle="none",
                label=plain(name_of(entry)) if default else "_",
            )


def _legend(figure: Any, panels: Any, names: list[str]) -> None:
    """The methods that some panel shows, in the order of `names`, right of the panels."""
    found: dict[str, Any] = {}
    for panel in panels:
        handles, labels = panel.get_legend_handles_labels()
        found |= dict(zip(labels, handles, strict=True))
    shown = [name for name in names if name in found]
    figure.legend(
        [found[name] for name in shown],
        shown,
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        frameon=False,
    )
