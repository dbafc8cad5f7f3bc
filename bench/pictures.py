"""Figures of the claims as picture files, for pages that cannot run a script."""

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
import seaborn

from bench.calibration_claims import ENOUGH, calibration_sweep
from bench.figures import BUILT_IN, COLORS
from bench.off_spec_claims import NAMES, off_spec_values
from bench.statistics import COUNTED, entry_of, records
from bench.tables import Tables

ROWS = {
    "fleet_minutes": "HF flight in training\n[fleet-minutes]",
    "training_crashes": "HF training crashes",
    "reward": "deployed return",
}
"""Metrics from top to bottom, as in the paper's summary figure, and their axis labels."""
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
"""Settings of every figure."""
LINES: Any = {
    "kind": "line",
    "markers": True,
    "dashes": False,
    "errorbar": "sd",
    "err_style": "bars",
    "height": 2.1,
}
"""Lines through means over seeds, with one standard deviation."""
COSTS = ("fleet_minutes", "training_crashes")
"""Rows with a logarithmic axis from 10 on, the same for all tasks."""


def write_summary(tables: Tables, path: Path) -> bool:
    """Writes a PNG: cost and deployed return against team size, a column a task.

    Means over seeds with one standard deviation; default settings; failed and diverged runs are
    left out. Nothing is written, and False returned, where there is nothing to draw.
    """
    results = tables.results
    shown = results.loc[
        results["metric"].isin(ROWS) & results["status"].isin(COUNTED) & (results["variant"] == "")
    ]
    if shown.empty:
        return False
    entries = [entry_of(row) for row in records(shown)]
    shown = shown.assign(method=[entry.label for entry in entries])
    known = [entry for entry in BUILT_IN if entry in set(entries)]
    order = [e.label for e in known] + sorted({e.label for e in entries if e not in BUILT_IN})
    colors = {label: COLORS[i % len(COLORS)] for i, label in enumerate(order)}
    colors |= {e.label: COLORS[BUILT_IN.index(e)] for e in known}
    with plt.rc_context(STYLE):
        grid = _lines(
            shown,
            "method",
            {label: colors[label] for label in order},
            x="team_size",
            y="value",
            row="metric",
            row_order=list(ROWS),
            col="task",
            aspect=1.25,
            facet_kws={"sharey": False, "margin_titles": False},
        )
        grid.set_titles("{col_name}")
        grid.set(xticks=sorted(shown["team_size"].unique()))
        for label, row in zip(ROWS.values(), grid.axes, strict=True):
            row[0].set_ylabel(label)
        for metric, row in zip(COSTS, grid.axes, strict=False):
            top = 2.0 * max(10.0, shown.loc[shown["metric"] == metric, "value"].max())
            for axes in row:
                axes.set_yscale("symlog", linthresh=10)
                axes.set_ylim(0, top)
        for axes in grid.axes[1:].flat:
            axes.set_title("")
        grid.set_axis_labels("team size N", None)
        return _saved(grid, path)


def write_off_spec(tables: Tables, path: Path) -> bool:
    """Writes a PNG: return on an off-spec drone against team size, a row a disturbance.

    Nothing is written, and False returned, where nothing was recalibrated.
    """
    rows = [
        {"task": cell.task, "N": cell.team_size, "world": cell.deployed_effects, "what": NAMES[e]}
        | {"return": value}
        for cell, found in off_spec_values(tables).items()
        for e, seeds in found.items()
        for value in seeds.values()
    ]
    if not rows:
        return False
    shown = pd.DataFrame(rows)
    with plt.rc_context(STYLE):
        colors = dict(zip(NAMES.values(), COLORS, strict=False))
        grid = _lines(shown, "what", colors, x="N", y="return", row="world", col="task", aspect=1.5)
        grid.set_titles("{col_name}, {row_name}")
        grid.set(xticks=sorted(shown["N"].unique()))
        grid.set_axis_labels("team size N", "deployed return")
        return _saved(grid, path)


def write_calibration(tables: Tables, path: Path) -> bool:
    """Writes a PNG: return beside the whole pool's Hybrid's against flights, a column a team size.

    Nothing is written, and False returned, where the number of flights was not varied.
    """
    rows = [
        {"task": cell.task, "N": cell.team_size, "flights": flights, "share": 100.0 * share}
        for cell, found in calibration_sweep(tables).items()
        for flights, shares in found.items()
        for share in shares
    ]
    if not rows:
        return False
    shown = pd.DataFrame(rows)
    colors = dict(zip(sorted(shown["task"].unique()), COLORS[1:], strict=False))
    most = max(row["flights"] for row in rows)
    ticks = [k for k in (0, 1, 4, 16, 64, 256, 1024) if k <= most]
    with plt.rc_context(STYLE):
        grid = _lines(
            shown, "task", colors, x="flights", y="share", col="N", height=3.0, aspect=1.3
        )
        grid.refline(y=0.0, color=COLORS[0], linestyle="-", linewidth=0.8)
        grid.refline(y=-100.0 * ENOUGH, color=COLORS[0], linestyle=":", linewidth=0.8)
        for axes in grid.axes.flat:
            axes.set_xscale("symlog", base=2, linthresh=1.0)
            axes.set_xlim(-0.4, 1.3 * most)
            axes.set_xticks(ticks, [str(k) for k in ticks])
            axes.minorticks_off()
        grid.set_titles("N = {col_name}")
        grid.set_axis_labels("calibration flights", "return beside the\nwhole pool's Hybrid [%]")
        return _saved(grid, path)


def _lines(
    shown: pd.DataFrame, what: str, colors: Mapping[str, str], **given: Any
) -> seaborn.FacetGrid:
    """`LINES` with a colour and a marker for each value of `what`, in the order of `colors`."""
    order = list(colors)
    known = {"hue": what, "hue_order": order, "style": what, "style_order": order}
    return seaborn.relplot(shown, palette=dict(colors), **(LINES | known | given))


def _saved(grid: seaborn.FacetGrid, path: Path) -> bool:
    """True, after the figure was written and closed."""
    if grid.legend is not None:
        grid.legend.set_title("")
    path.parent.mkdir(parents=True, exist_ok=True)
    grid.savefig(path, dpi=110)
    plt.close(grid.figure)
    return True


def data_uri(path: Path) -> str:
    """A PNG file as a link that needs no file."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()
