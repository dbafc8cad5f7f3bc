"""The section of the blind report that shows whether advised manoeuvres do what is said of them."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from bench.paper.figures import saved
from bench.report.pictures.looks import COLORS
from bench.stats.statistics import records
from bench.text import markdown
from blind.report.sections import OUR_COLOR, measured_by
from blind.report.tables import Tables
from diagnosis.decision import Decision

LEAST_MARGIN = Decision().decidable_chi2
"""Margin from which two effects are told apart."""
NAME = "next_flight"
"""File name of the table."""
CAPTION = (
    "How clearly one effect is told from another: bland flights, and the advised flight of the "
    "same duration. The truth stands first; the line is a margin of 25, margins below 1 are drawn "
    "at 1"
)


def section(tables: Tables, picture: list[str]) -> list[str]:
    """Heading, text, table and picture; nothing where nothing was flown."""
    if NAME not in tables.studies:
        return []
    rows = records(tables.studies[NAME])
    told, before = (
        sum(row[column] >= LEAST_MARGIN for row in rows) for column in ("advised", "bland")
    )
    lost = [f"{row['truth']} from {row['rival']}" for row in rows if row["advised"] < LEAST_MARGIN]
    flat = [f"{row['truth']} from {row['rival']}" for row in rows if row["advised"] <= row["bland"]]
    text = (
        "Manoeuvres that the diagnosis advises for a pair were flown in simulation with either "
        "effect of the pair being true, beside bland flights as long. The margin is the "
        "chi-square of the best fit of the other effect alone beyond that of the truth, in flights "
        f"without noise at the noise that is logged; at {LEAST_MARGIN:.0f} the two are 5 standard "
        "deviations apart. The advised "
        f"flights separate {told} of {len(rows)} directions, bland ones {before}. Advice for pairs "
        "that are not in the table was not flown."
    )
    notes = [
        f"**Not separated: {markdown.escape('; '.join(lost))}.**" if lost else "",
        f"No better than bland: {markdown.escape('; '.join(flat))}." if flat else "",
    ]
    pairs = [frozenset((row["truth"], row["rival"])) for row in rows]
    cells = []
    for pair in dict.fromkeys(pairs):
        one, other = (row for row, own in zip(rows, pairs, strict=True) if own == pair)
        cells.append(
            (
                markdown.escape(f"{one['truth']} / {other['truth']}"),
                markdown.escape(one["advice"]),
                f"{one['seconds']:.0f} s",
                f"{_short(one['bland'])} / {_short(other['bland'])}",
                f"{_short(one['advised'])} / {_short(other['advised'])}",
            )
        )
    headings = ("pair", "advice", "flown", "margin, bland", "margin, advised")
    table = markdown.table(headings, cells, (0, 1))
    note = "Margins with the first and with the second effect of the pair being true."
    notes += measured_by(tables, NAME)[:1]
    return ["### What to fly next", text, *filter(None, notes), note, table, *picture]


def draw(tables: Tables, path: Path) -> bool:
    """Whether there was something to draw: bland and advised margins, a line a direction."""
    if NAME not in tables.studies:
        return False
    table = tables.studies[NAME]
    bland, advised = (np.maximum(table[name].to_numpy(float), 1.0) for name in ("bland", "advised"))
    y = np.arange(len(table)) + 0.35 * (np.arange(len(table)) // 2)
    figure, axes = plt.subplots(figsize=(7.6, 0.24 * len(table) + 1.3), layout="constrained")
    axes.hlines(y, bland, advised, color="#c5ccd4", lw=2, zorder=1)
    axes.scatter(bland, y, s=26, marker="s", color=COLORS[1], label="bland", zorder=2)
    axes.scatter(advised, y, s=30, color=OUR_COLOR, label="advised", zorder=3)
    axes.axvline(LEAST_MARGIN, color="black", lw=1, ls=":")
    names = [f"{truth}, not {rival}" for truth, rival in table[["truth", "rival"]].to_numpy()]
    axes.set(xscale="log", yticks=y, yticklabels=names, xlabel="margin of the truth (chi-square)")
    axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=2, fontsize=8, frameon=False)
    return saved(figure, path)


def _short(margin: float) -> str:
    return f"{round(margin, 1) + 0.0:.1f}" if margin < 100.0 else f"{margin:,.0f}"
