"""Top views of one evaluation episode for each task, team size and method."""

import html

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from bench.report.figures import (
    MAX_POINTS,
    Drawing,
    Place,
    Style,
    by_run,
    drawing,
    ordered,
    owners,
    styles,
)
from bench.stats.statistics import Cell, Entry
from bench.store.tables import Tables

TOP_VIEW_INTRO = (
    "The first evaluation episode from above, one panel per method; the initial states are the "
    "same wherever the seed is. Circle: start; star: end; the older, the fainter. A few far points "
    "may lie outside the frame."
)


MARKED = 40
"""Team size up to which starts and ends have marks of full size."""


def trajectory_drawings(tables: Tables) -> list[Drawing]:
    """Top views of one episode, one figure per task and team size, one panel per method."""
    owner = owners(tables.runs)
    seed = dict(zip(tables.runs["run"], tables.runs["seed"], strict=True))
    flown: dict[Cell, dict[Entry, list[str]]] = {}
    flights = {run: rows for run, rows in by_run(tables.trajectories).items() if run in owner}
    for run in flights:
        cell, entry = owner[run]
        flown.setdefault(cell, {}).setdefault(entry, []).append(run)
    chosen = {cell: _same_seed(entries, seed) for cell, entries in flown.items()}
    total = sum(len(flights[run]) for picks in chosen.values() for run in picks.values())
    stride = max(1, -(-total // MAX_POINTS))
    style = styles(tables)
    return [_top_view(cell, chosen[cell], flights, seed, style, stride) for cell in sorted(chosen)]


def _top_view(
    cell: Cell,
    picks: dict[Entry, str],
    flights: dict[str, pd.DataFrame],
    seed: dict[str, int],
    style: dict[Entry, Style],
    stride: int,
) -> Drawing:
    columns = min(3, len(picks))
    rows = -(-len(picks) // columns)
    titles = [f"{html.escape(e.label)} (seed {seed[run]})" for e, run in picks.items()]
    plot = make_subplots(
        rows,
        columns,
        subplot_titles=titles,
        horizontal_spacing=0.05,
        vertical_spacing=0.18 / rows,
    )
    for i, (entry, run) in enumerate(picks.items()):
        place: Place = {"row": i // columns + 1, "col": i % columns + 1}
        for trace in _flight(flights[run], style[entry].color, stride):
            plot.add_trace(trace, **place)
    # One scale for all panels, equal along x and y, so that sizes compare.
    xy = pd.concat([flights[run] for run in picks.values()])[["pos_x", "pos_y"]].to_numpy(float)
    xy = xy[np.isfinite(xy).all(axis=1)]
    center, reach = np.zeros(2), 1.0
    if len(xy):
        low, high = np.quantile(xy, [0.005, 0.995], axis=0)
        center, reach = 0.5 * (low + high), 0.55 * float((high - low).max()) + 0.1
    for i in range(len(picks)):
        place: Place = {"row": i // columns + 1, "col": i % columns + 1}
        axis = f"x{'' if i == 0 else i + 1}"
        plot.update_xaxes(range=[center[0] - reach, center[0] + reach], **place)
        plot.update_yaxes(range=[center[1] - reach, center[1] + reach], **place)
        plot.update_yaxes(scaleanchor=axis, constrain="domain", **place)
    plot.update_xaxes(constrain="domain")
    plot.update_xaxes(title_text="x [m]", row=rows)
    plot.update_yaxes(title_text="y [m]", col=1)
    return drawing(
        cell.label,
        plot,
        340 * rows + 30,
        0,
        f"Top view, {cell.label}.",
        f"Paths of {cell.team_size} drones seen from above, one panel per method, {cell.task}.",
    )


def _flight(frame: pd.DataFrame, color: str, stride: int) -> list[go.Scatter]:
    """Paths in four pieces of growing opacity, starts and ends; gaps between drones."""
    gap = np.full((1, 3), np.nan)
    paths = []
    for drone, path in frame.sort_values("t").groupby("drone"):
        xy = path[["pos_x", "pos_y"]].to_numpy(dtype=float)
        keep = np.r_[np.arange(0, len(xy) - 1, stride), len(xy) - 1]
        paths.append(np.column_stack([xy[keep], np.full(len(keep), float(str(drone)))]))
    found = []
    for piece, opacity in enumerate((0.2, 0.4, 0.65, 1.0)):
        parts = []
        for path in paths:
            first, last = (len(path) * np.array([piece, piece + 1])) // 4
            parts += [path[max(0, first - 1) : last], gap]
        found.append(_scatter(np.concatenate(parts), color, "lines", opacity=opacity))
    starts, ends = np.array([p[0] for p in paths]), np.array([p[-1] for p in paths])
    # Marks of a large team are small, or each would cover those of its neighbours.
    scale = min(1.0, (MARKED / len(paths)) ** 0.5)
    edge = {"color": "white", "width": scale**2}
    hollow = {"symbol": "circle-open", "size": 8 * scale, "color": "#444444"}
    star = {"symbol": "star", "size": 11 * scale, "color": color, "line": edge}
    found.append(_scatter(starts, color, "markers", marker=hollow))
    return [*found, _scatter(ends, color, "markers", marker=star)]


def _scatter(xyd: np.ndarray, color: str, mode: str, **how: object) -> go.Scatter:
    xyd = xyd.astype(np.float32)
    return go.Scatter(
        x=xyd[:, 0],
        y=xyd[:, 1],
        customdata=xyd[:, 2] if mode == "markers" else None,
        mode=mode,
        line={"color": color, "width": 1.6},
        showlegend=False,
        hovertemplate="drone %{customdata}<extra></extra>" if mode == "markers" else None,
        hoverinfo=None if mode == "markers" else "skip",
        **how,
    )


def _same_seed(entries: dict[Entry, list[str]], seed: dict[str, int]) -> dict[Entry, str]:
    """A run of each entry, all of the seed that most entries have (the smallest of those)."""
    have = [seed[run] for runs in entries.values() for run in runs]
    wanted = min(set(have), key=lambda s: (-have.count(s), s))
    return {
        entry: min(entries[entry], key=lambda run: (seed[run] != wanted, seed[run], run))
        for entry in ordered(entries)
    }
