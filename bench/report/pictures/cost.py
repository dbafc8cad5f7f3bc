"""How far each method is from the best known, against high-fidelity flight, as a picture.

The gap is 1 - settled score: 1 is a team that stays at its spawn, 0 the upper reference. Its axis
is logarithmic, because the methods' gaps differ by factors, and has the best on top. Without an
upper reference there is no score; the gap is then the settled reward over that at the spawn, so
that 0 is a reward of 0.

A method at its default budget is a large marker. Fewer calibration flights and trainings that were
cut short (suite `budget`) are small ones of the same colour, joined in the order of their bills.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from bench.report.pictures.looks import Key, legend, on_page, ordered
from bench.report.pictures.svg import Panel, name, plain_ticks, render
from bench.stats.choices import at_budgets
from bench.stats.scores import at_home, recovered, scored, undisturbed
from bench.stats.statistics import (
    FEWEST_SEEDS,
    Entry,
    Values,
    estimate,
    seed_values,
)
from bench.store.tables import Tables
from bench.text.numbers import number, significant

FINEST = 1e-3
"""Gap below which the axis is linear; scores of five seeds tell no finer apart."""
GAP = "gap to the upper reference"
"""What the vertical axis shows where there are scores."""
LOSS = "settled reward / that at the spawn"
"""What it shows elsewhere."""
PAGE_SIZE = (4.8, 3.0)
"""Width and height of a panel on a page [in]."""


class Mark(NamedTuple):
    """A method at a budget, as it is drawn."""

    entry: Entry
    minutes: float
    """Its bill, a mean over tasks and seeds on a page [fleet-minutes]."""
    value: float
    """A reward; on a page a gap, mean over tasks of the mean over seeds."""
    bars: Any
    """Error bars as matplotlib takes them; None: without."""


Look = Callable[[Entry, Sequence[Entry]], tuple[str, str]]
"""Colour and marker of an entry among others."""
Label = Callable[[Entry], str]
"""What the legend calls an entry."""


def cost_panels(tables: Tables) -> tuple[list[Panel], list[Key]]:
    """Gap to the upper reference against fleet-minutes, a panel a team size, and who is drawn how.

    Where nothing has a score, the gap is by the reward at the spawn.
    """
    found, axis = points(tables), GAP
    if not found:
        found, axis = points(tables, recovered(tables)), LOSS
    entries = _entries(found)
    panels = []
    for n, own in sorted(found.items()):

        def draw(panel: Axes, own: list[Mark] = own) -> None:
            _draw(panel, own, entries)
            panel.set_ylabel(axis)
            _scale(panel, found)
            plain_ticks(panel.xaxis)
            plain_ticks(panel.yaxis)

        said = "; ".join(
            f"{p.entry.label} {significant(p.value)} at {significant(p.minutes)} fleet-minutes"
            for p in sorted(own, key=lambda p: p.value)
        )
        svg = render(draw, f"cost-{n}", PAGE_SIZE)
        panels.append(Panel(f"N = {n}", svg, f"{axis[0].upper()}{axis[1:]}, N = {n}: {said}."))
    return panels, legend(entries, entries)


def points(tables: Tables, values: Values | None = None) -> dict[int, list[Mark]]:
    """What is drawn, by team size: gaps of scores, or of `values`, of which 1 is the best."""
    scores = seed_values(scored(tables), "score") if values is None else values
    scores = at_budgets(at_home(scores, tables))
    bills = at_budgets(undisturbed(tables, "fleet_minutes"), FEWEST_SEEDS if values is None else 1)
    found: dict[int, list[Mark]] = {}
    for n in sorted({cell.team_size for cell in scores}):
        cells = [cell for cell in scores if cell.team_size == n]
        for entry in sorted({e for cell in cells for e in scores[cell]}):
            if minutes := [x for c in cells for x in bills.get(c, {}).get(entry, {}).values()]:
                own = [estimate(scores[c][entry].values()) for c in cells if entry in scores[c]]
                if len(own) == len(cells):  # means over other tasks are no comparison
                    found.setdefault(n, []).append(_point(entry, minutes, own))
    return found


def _entries(found: dict[int, list[Mark]]) -> list[Entry]:
    """Who is drawn, in order, whatever the budget."""
    return ordered({p.entry._replace(variant="") for own in found.values() for p in own})


def _point(entry: Entry, minutes: list[float], own: list[Any]) -> Mark:
    squares = [x.std**2 for x in own if x.has_interval]
    score = float(np.mean([x.mean for x in own]))
    spread = float(np.sqrt(np.mean(squares))) if squares else None  # None with one seed
    return Mark(entry, float(np.mean(minutes)), 1.0 - score, spread)


def draw_marks(
    panel: Axes, marks: Sequence[Mark], entries: list[Entry], look: Look, label: Label
) -> list[tuple[Mark, Line2D]]:
    """Draws methods at their budgets: defaults large, others small, joined by rising bill.

    Returns:
        Each mark with what is drawn of it.
    """
    drawn = []
    for entry in entries:
        color, marker = look(entry, entries)
        family = sorted(
            (m for m in marks if m.entry._replace(variant="") == entry), key=lambda m: m.minutes
        )
        if len(family) > 1:
            xy = [(m.minutes, m.value) for m in family]
            panel.plot(*zip(*xy, strict=True), color=color, linewidth=0.8, alpha=0.6)
        for mark in family:
            default = not mark.entry.variant
            bars = panel.errorbar(
                mark.minutes,
                mark.value,
                yerr=mark.bars,
                color=color,
                marker=marker,
                markersize=6 if default else 3,
                linestyle="none",
                label=label(entry) if default else "_",
            )
            drawn.append((mark, bars.lines[0]))
    panel.set_xlabel("HF flight [fleet-minutes]")
    panel.set_xscale("symlog", linthresh=0.1)
    return drawn


def up_to(panel: Axes, largest: float) -> None:
    """Shows bills from 0 to beyond the largest [fleet-minutes]."""
    panel.set_xlim(-0.05, max(1.0, 3.0 * largest))


def _draw(panel: Axes, own: list[Mark], entries: list[Entry]) -> None:
    for mark, line in draw_marks(panel, own, entries, on_page, lambda entry: entry.label):
        said = f"{mark.entry.label}: {number(mark.value, 4)}, {significant(mark.minutes)} min"
        name(line, said)
    panel.axhline(0.0, color="#999999", linewidth=0.8, linestyle=":")


def _scale(panel: Axes, found: dict[int, list[Mark]]) -> None:
    """Logarithmic, best on top; bars that reach beyond all means do not set the range."""
    gaps = [p.value for own in found.values() for p in own]
    panel.set_yscale("symlog", linthresh=FINEST)
    panel.set_ylim(2.0 * max(*gaps, FINEST), min(2.0 * min(gaps), -FINEST))
    up_to(panel, max(p.minutes for own in found.values() for p in own))
