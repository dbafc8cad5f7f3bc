"""Figures of a report: cost and reward against team size, training curves.

Colours are those of Okabe and Ito (2008) and a grey for the baseline, told apart under the common
colour blindnesses; the built-in methods keep theirs from report to report. Markers differ too.
"""

import dataclasses
import html
from collections.abc import Iterable, Sequence
from typing import TypedDict

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from bench.stats.statistics import Cell, Entry, cell_of, entry_of, estimate, records, seed_values
from bench.store.tables import Tables

BUILT_IN = (
    Entry("lf_baseline"),
    Entry("hf_scratch"),
    Entry("hf_hotstart"),
    Entry("hybrid", "affine"),
    Entry("hybrid", "sindy"),
    Entry("hybrid", "mlp"),
    Entry("grey_box"),
    Entry("domain_randomization"),
    Entry("hybrid_once"),
    Entry("recalibrated"),
)
"""The order in which methods are shown; others follow by name."""
COLORS = (
    "#6E6E6E",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#0072B2",
    "#E69F00",
    "#000000",
    "#882255",
    "#999933",
    "#6A3D9A",
    "#44AA99",
)
"""One an entry, in order; repeated, with another dash, beyond twelve."""
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "star", "x", "pentagon")
DASHES = ("solid", "dash", "dot", "dashdot")

CURVES_INTRO = (
    "Return of the training episodes (exact penalty), averaged over bins of epochs. Each method "
    "trains in its own simulator, so heights compare only among methods that train in the same "
    "one. The start may lie below the frame; double-click shows everything."
)

MAX_POINTS = 20_000
"""Points of all curves, and of all trajectories, together: what keeps a page small."""


class Place(TypedDict):
    """Which panel of a figure, from 1."""

    row: int
    col: int


@dataclasses.dataclass(frozen=True)
class Style:
    """How an entry is drawn, in every figure of a report alike."""

    color: str
    symbol: str
    dash: str


@dataclasses.dataclass(frozen=True)
class Drawing:
    """A figure with the words that stand for it."""

    title: str
    plot: go.Figure
    caption: str
    alt: str
    height: int
    """On the page [px]."""


def drawing(
    title: str, plot: go.Figure, height: int, legend: int, caption: str, alt: str
) -> Drawing:
    """A drawing with the look that all share.

    Args:
        title: Heading; text, not HTML.
        plot: What to draw; restyled in place.
        height: Of the panels and their margins [px].
        legend: Number of entries in the legend.
        caption: What the figure shows; text, not HTML.
        alt: The same for those who cannot see it.
    """
    room = 22 * -(-legend // 4)
    height += room
    plot.update_layout(
        template=go.layout.Template(layout={"colorway": COLORS}),
        plot_bgcolor="white",
        height=height,
        font={"family": "system-ui, sans-serif", "size": 13, "color": "#1f2933"},
        margin={"l": 70, "r": 20, "t": 60 + room, "b": 50},
        legend={
            "orientation": "h",
            "x": 0.0,
            "yref": "container",
            "yanchor": "top",
            "y": 1.0 - 28 / height,
        },
        hoverlabel={"namelength": -1},
    )
    lines = {"showline": True, "linecolor": "#9aa5b1", "zeroline": False, "gridcolor": "#e4e9ef"}
    plot.update_xaxes(**lines)
    plot.update_yaxes(**lines)
    return Drawing(title, plot, caption, alt, height)


def styles(tables: Tables) -> dict[Entry, Style]:
    """A style for each entry: built-in ones in their fixed places, others after them by name."""
    rows = [*records(tables.runs), *records(tables.results.drop_duplicates("run"))]
    others = sorted({entry_of(row) for row in rows} - set(BUILT_IN))
    found = {}
    for i, entry in enumerate((*BUILT_IN, *others)):
        turn = i // len(COLORS)
        color, symbol = COLORS[i % len(COLORS)], SYMBOLS[i % len(SYMBOLS)]
        found[entry] = Style(color, symbol, DASHES[turn % len(DASHES)])
    return found


def summary_drawings(tables: Tables) -> list[Drawing]:
    """Fleet-minutes, training crashes and deployed reward against team size, one per world."""
    rewards = seed_values(tables.results, "reward")
    worlds = sorted({(cell.simulator, cell.deployed_effects) for cell in rewards})
    return [_summary(tables, rewards, simulator, effects) for simulator, effects in worlds]


def curve_drawings(tables: Tables) -> list[Drawing]:
    """Training return against epochs, one figure per task, one panel per team size."""
    owner = owners(tables.runs)
    curves = {run: frame for run, frame in by_run(tables.curves).items() if run in owner}
    by_cell: dict[Cell, dict[Entry, list[str]]] = {}
    for run in curves:
        cell, entry = owner[run]
        by_cell.setdefault(cell, {}).setdefault(entry, []).append(run)
    points = int(np.clip(MAX_POINTS // max(1, len(curves)), 30, 100))
    style = styles(tables)
    found = []
    for task in sorted({cell.task for cell in by_cell}):
        cells = sorted(cell for cell in by_cell if cell.task == task)
        columns = min(3, len(cells))
        rows = -(-len(cells) // columns)
        plot = make_subplots(
            rows,
            columns,
            subplot_titles=[f"N = {cell.team_size}" for cell in cells],
            horizontal_spacing=0.07,
            vertical_spacing=0.16 / rows,
        )
        shown: set[Entry] = set()
        for i, cell in enumerate(cells):
            place: Place = {"row": i // columns + 1, "col": i % columns + 1}
            own = {e: [curves[run] for run in by_cell[cell][e]] for e in ordered(by_cell[cell])}
            longest = max(len(frame) for frames in own.values() for frame in frames)
            width = -(-longest // points)
            for entry, frames in own.items():
                plot.add_trace(_curve(entry, style[entry], frames, width, entry in shown), **place)
                shown.add(entry)
            plot.update_yaxes(range=_robust_range(own.values()), **place)
        plot.update_xaxes(title_text="epoch", rangemode="tozero")
        plot.update_yaxes(title_text="training return", col=1)
        found.append(
            drawing(
                task,
                plot,
                330 * rows + 60,
                len(shown),
                f"Training return on {task}, one line per seed.",
                f"Line charts of training return against epoch on {task}.",
            )
        )
    return found


def ordered(entries: Iterable[Entry]) -> list[Entry]:
    """Entries in the order in which they are shown."""
    place = {entry: i for i, entry in enumerate(BUILT_IN)}
    return sorted(entries, key=lambda entry: (place.get(entry, len(place)), entry))


SUMMARY_ROWS = (
    ("fleet_minutes", "HF fleet-minutes", True),
    ("training_crashes", "HF training crashes", True),
    ("reward", "deployed reward", False),
)
"""Metric, axis title, and whether the axis is log(1 + value)."""


def _summary(
    tables: Tables,
    rewards: dict[Cell, dict[Entry, dict[int, float]]],
    simulator: str,
    effects: str,
) -> Drawing:
    cells = [c for c in rewards if (c.simulator, c.deployed_effects) == (simulator, effects)]
    tasks = sorted({cell.task for cell in cells})
    sizes = sorted({cell.team_size for cell in cells})
    entries = ordered({entry for cell in cells for entry in rewards[cell]})
    defaults = [entry for entry in entries if not entry.variant] or entries
    plot = make_subplots(
        len(SUMMARY_ROWS),
        len(tasks),
        column_titles=[html.escape(task) for task in tasks],
        shared_xaxes=True,
        vertical_spacing=0.04,
        horizontal_spacing=0.06,
    )
    style = styles(tables)
    room = min(0.12 * (sizes[-1] - sizes[0]), 0.5 * min(np.diff(sizes), default=0)) or 1.2
    for i, (metric, title, log) in enumerate(SUMMARY_ROWS):
        values = seed_values(tables.results, metric)
        for j, task in enumerate(tasks):
            place: Place = {"row": i + 1, "col": j + 1}
            for k, entry in enumerate(defaults):
                own = [values.get(Cell(task, n, simulator, effects), {}).get(entry) for n in sizes]
                dodge = room * (k / max(1, len(defaults) - 1) - 0.5)
                legend = i == j == 0
                for trace in _line(entry, style[entry], sizes, own, log, dodge, legend):
                    plot.add_trace(trace, **place)
            if log:
                plot.update_yaxes(**_LOG_TICKS, **place)
        plot.update_yaxes(title_text=title, row=i + 1, col=1)
    plot.update_xaxes(tickvals=sizes, range=[sizes[0] - room, sizes[-1] + room])
    plot.update_xaxes(title_text="team size N", row=len(SUMMARY_ROWS))
    world = Cell("", 0, simulator, effects).label.removeprefix(", N = 0").removeprefix(", ")
    return drawing(
        f"Cost and reward against team size{f', {world}' if world else ''}",
        plot,
        860,
        len(defaults),
        "Rows: high-fidelity flight before evaluation, high-fidelity training crashes (both on a "
        "log(1 + x) axis), deployed reward. Columns: tasks. Marker: mean over seeds; band: "
        "± 1 standard deviation (none with one seed). Lines only guide the eye, markers stand side "
        "by side to be told apart, and a missing cell leaves a gap.",
        "Grid of line charts: fleet-minutes, training crashes and deployed reward against team "
        "size for each task; the leaderboard tables hold the same numbers.",
    )


_DECADES = (0, 1, 10, 100, 1_000, 10_000, 100_000, 1_000_000)
_LOG_TICKS = {
    "tickvals": [float(np.log10(1.0 + v)) for v in _DECADES],
    "ticktext": ["0", "1", "10", "100", "1k", "10k", "100k", "1M"],
    "rangemode": "tozero",
}


def _line(
    entry: Entry,
    style: Style,
    sizes: Sequence[int],
    values: Sequence[dict[int, float] | None],
    log: bool,
    dodge: float,
    legend: bool,
) -> list[go.Scatter]:
    """A band and a line through the means, with gaps where there are none."""
    found = [estimate((v or {}).values()) for v in values]
    mean = np.array([e.mean for e in found])
    std = np.nan_to_num(np.array([e.std for e in found]))
    low, high = mean - std, mean + std
    text = [f"{m:.1f} ± {s:.1f}, n = {e.n}" for m, s, e in zip(mean, std, found, strict=True)]
    if log:
        mean, low, high = (np.log10(1.0 + np.maximum(v, 0.0)) for v in (mean, low, high))
    x = np.array(sizes, dtype=float) + dodge
    name = html.escape(entry.label)
    line = go.Scatter(
        x=x,
        y=mean,
        name=name,
        legendgroup=name,
        showlegend=legend,
        mode="lines+markers",
        line={"color": style.color, "dash": style.dash, "width": 2},
        marker={"symbol": style.symbol, "size": 9, "line": {"color": "white", "width": 1}},
        text=text,
        cliponaxis=False,
        hovertemplate="N = %{x:.0f}: %{text}",
    )
    if len(sizes) == 1:
        line.error_y = {"array": high - mean, "arrayminus": mean - low, "color": style.color}
        return [line]
    known = np.isfinite(mean)
    band = go.Scatter(
        x=np.concatenate([x[known], x[known][::-1]]),
        y=np.concatenate([high[known], low[known][::-1]]),
        fill="toself",
        fillcolor=faded(style.color, 0.14),
        line={"width": 0},
        legendgroup=name,
        showlegend=False,
        hoverinfo="skip",
        mode="lines",
    )
    return [band, line]


def _curve(
    entry: Entry, style: Style, frames: list[pd.DataFrame], width: int, shown: bool
) -> go.Scatter:
    """All seeds of an entry as one trace, with gaps between them."""
    parts = [_binned(frame.sort_values("epoch"), width) for frame in frames]
    gap = np.full((1, 2), np.nan)
    xy = np.concatenate([piece for part in parts for piece in (part, gap)]).astype(np.float32)
    name = html.escape(entry.label)
    return go.Scatter(
        x=xy[:, 0],
        y=xy[:, 1],
        name=name,
        legendgroup=name,
        showlegend=not shown,
        mode="lines",
        opacity=0.75,
        line={"color": style.color, "dash": style.dash, "width": 1.6},
        hovertemplate="epoch %{x:.0f}: %{y:.1f}",
    )


def _binned(frame: pd.DataFrame, width: int) -> np.ndarray:
    """Epoch and reward, averaged over bins of `width` epochs."""
    xy = frame[["epoch", "reward"]].to_numpy(dtype=float)
    pieces = np.array_split(xy, -(-len(xy) // width))
    return np.array([piece.mean(axis=0) for piece in pieces])


def _robust_range(groups: Iterable[list[pd.DataFrame]]) -> list[float] | None:
    """A frame that shows the plateaus, and most of the way there.

    It ends below the worst seed's last tenth, and below the last three quarters of most curves.
    """
    tails, ways, tops = [], [], []
    for frame in (frame for frames in groups for frame in frames):
        reward = frame["reward"].to_numpy(dtype=float)
        reward = reward[np.isfinite(reward)]
        if reward.size:
            tails.append(float(np.median(reward[-max(1, reward.size // 10) :])))
            ways.append(float(np.quantile(reward[reward.size // 4 :], 0.02)))
            tops.append(float(reward.max()))
    if not tails:
        return None
    top, low = max(tops), float(np.quantile(tails, 0.1))
    room = max(top - low, 1e-3 * abs(top), 1e-6)
    bottom = min(low - 1.5 * room, float(np.median(ways)))
    return [bottom, top + 0.04 * (top - bottom)]


def by_run(frame: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each run."""
    return {str(run): rows for run, rows in frame.groupby("run")}


def owners(runs: pd.DataFrame) -> dict[str, tuple[Cell, Entry]]:
    """Cell and entry of each run; the world it was evaluated in is left open."""
    return {
        row["run"]: (
            cell_of({"simulator": "crazyflow", "deployed_effects": "", **row}),
            entry_of(row),
        )
        for row in records(runs)
    }


def faded(color: str, alpha: float) -> str:
    """`color`, "#rrggbb", with an opacity."""
    r, g, b = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},{alpha})"
