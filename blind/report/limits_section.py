"""The section of the blind report that tells a user how long to fly: limits against seconds."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from bench.paper.figures import saved
from bench.report.pictures.looks import COLORS
from bench.stats.statistics import records
from bench.text import markdown
from bench.text.numbers import MISSING, percent
from blind.report.sections import OUR_COLOR, measured_by
from blind.report.tables import Tables
from blind.score.scoring import proportion

NAME = "limits"
"""File name of the table."""
CAPTION = (
    "Size that is named in 90 % of cases, predicted, against seconds of flight (flights "
    "of 10 s), at three times the usual measurement noise, the usual one, and 0.3 of it. Dashed: "
    "the bound of a test that knows what it looks for. The grey band holds the catalogue's "
    "small to large sizes"
)
NOISE_COLORS = {0.3: COLORS[2], 1.0: OUR_COLOR, 3.0: COLORS[1]}
"""Colour of each noise."""
SHOWN = (10.0, 60.0, 600.0)
"""Seconds of flight in the table."""


def section(tables: Tables, picture: list[str]) -> list[str]:
    """Heading, text, tables and picture; nothing where nothing was measured."""
    if NAME not in tables.studies:
        return []
    table = tables.studies[NAME]
    text = (
        "The limit of an effect is the size from which a diagnosis names it in 90 % of cases, "
        "alone or beside another effect. The limits are predicted. Flights without noise are "
        "linearised where the effect is true, and Gaussian noise is drawn. The evidence of every "
        "single effect, and of the true one with any other, is then compared as the diagnosis "
        "does it. "
        "Flights take 10 s and are of eight kinds in turn (the first is a circle at 1 m, the sixth "
        "a low flight), so that a longer time also means other flights. A dash means that no size "
        "is named by then. *Bound* is the limit of a test that knows which effect to look for and "
        "uses all flights, with 2 % of false alarms. Like the diagnosis it looks at half seconds "
        "whose starts are unknown; a method that follows a whole flight could find smaller "
        "effects. *Mistaken for* is the most frequent "
        "other answer just below the limit at 60 s."
    )
    usual = table.loc[(table["kind"] == "predicted") & (table["noise"] == 1.0)]
    headings = ("effect", "unit", *(f"{s:.0f} s" for s in SHOWN), "bound, 60 s", "mistaken for")
    return [
        "### How small, and how long to fly",
        text,
        *measured_by(tables, NAME),
        *picture,
        markdown.table(headings, [_line(part) for _, part in usual.groupby("effect")], (0, 1, 6)),
        *_checks(table.loc[table["kind"] == "checked"]),
    ]


def _line(part: pd.DataFrame) -> tuple[str, ...]:
    by_seconds = {row["seconds"]: row for row in records(part)}
    sizes = [by_seconds[s]["size"] for s in SHOWN]
    minute = by_seconds[60.0]
    return (
        markdown.escape(minute["effect"]),
        markdown.escape(minute["unit"]),
        *(_shown(size) for size in sizes),
        _shown(minute["bound"]),
        markdown.escape(minute["rival"] or MISSING),
    )


def _checks(table: pd.DataFrame) -> list[str]:
    """Predicted beside measured shares of cases in which the effect was named."""
    if table.empty:
        return []
    cells: dict[tuple[float, float], list[dict[str, Any]]] = {}
    for row in records(table):
        cells.setdefault((row["seconds"], row["factor"]), []).append(row)
    rows = []
    for (seconds, factor), cases in sorted(cells.items()):
        named = proportion(sum(bool(case["named"]) for case in cases), len(cases))
        wrong = sorted({f"{c['effect']}: {c['rival']}" for c in cases if not c["named"]})
        rows.append(
            (
                f"{seconds:.0f} s",
                f"{factor:g}",
                percent(sum(case["predicted"] for case in cases) / named.n, 0),
                f"{named.hits}/{named.n}",
                named.interval(),
                markdown.escape("; ".join(wrong)) or MISSING,
            )
        )
    found, n = sum(bool(row["named"]) for row in records(table)), len(table)
    expected = sum(row["predicted"] for row in records(table))
    effects = ", ".join(dict.fromkeys(table["effect"].tolist()))
    note = (
        f"Checked by {n} diagnoses of noisy flights at sizes about the predicted limit of "
        f"{markdown.escape(effects)}: the effect was among those that were named in {found}; "
        f"{expected:.1f} were predicted. Cases of a duration share paths and noise across sizes "
        "and effects; predictions stand on one draw of the paths."
    )
    headings = ("flown", "size / limit", "predicted", "named", "95 % interval", "said instead")
    return [note, markdown.table(headings, rows, (0, 5))]


def draw(tables: Tables, path: Path) -> bool:
    """Whether there was something to draw: a panel an effect."""
    if NAME not in tables.studies:
        return False
    table = tables.studies[NAME]
    predicted = table.loc[table["kind"] == "predicted"]
    if predicted.empty:
        return False
    effects = list(dict.fromkeys(predicted["effect"]))
    n_columns = 4
    n_rows = -(-len(effects) // n_columns)
    figure, grid = plt.subplots(
        n_rows, n_columns, figsize=(9.2, 1.95 * n_rows + 0.5), sharex=True, layout="constrained"
    )
    panels = np.ravel(grid)
    for axes, effect in zip(panels, effects, strict=False):
        _panel(axes, predicted.loc[predicted["effect"] == effect])
    for axes in panels[len(effects) :]:
        axes.axis("off")
    for axes in panels[max(len(effects) - n_columns, 0) : len(effects)]:
        axes.tick_params(labelbottom=True)
    handles: dict[str, Any] = {}
    for axes in panels[: len(effects)]:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=4, frameon=False
    )
    figure.supxlabel("flight [s]", fontsize=9)
    return saved(figure, path)


def _panel(axes: Axes, part: pd.DataFrame) -> None:
    first = records(part)[0]
    if np.isfinite(first["small"]):
        axes.axhspan(first["small"], first["large"], color="#eef0f3", zorder=0)
    for noise in sorted(set(part["noise"].tolist())):
        color = NOISE_COLORS.get(noise, "black")
        own = part.loc[part["noise"] == noise].sort_values("seconds")
        axes.plot(own["seconds"], own["size"], "o-", ms=3, color=color, label=f"noise x {noise:g}")
        axes.plot(own["seconds"], own["bound"], "--", lw=0.9, color=color)
    axes.plot([], [], "--", lw=0.9, color="black", label="bound")
    axes.set(xscale="log", yscale="log", ylabel=f"[{first['unit']}]")
    axes.set_title(first["effect"].replace("_", " "), fontsize=9)
    axes.set_xticks([10, 60, 600], ["10", "60", "600"])
    axes.tick_params(which="minor", bottom=False)


def _shown(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else MISSING
