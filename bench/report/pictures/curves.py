"""Training curves, a panel a cell; every seed is a line."""

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from bench.report.pictures.looks import Key, legend, on_page, ordered
from bench.report.pictures.svg import Panel, name, render
from bench.stats.statistics import Cell, Entry, entry_of, records
from bench.store.tables import Tables

CURVES_INTRO = (
    "Return of the training episodes (exact penalty), averaged over bins of epochs, one line per "
    "seed. Each method trains in its own simulator, so heights compare only among methods that "
    "train in the same one. The start may lie below the frame."
)
MAX_POINTS = 20_000
"""Points of all curves together: what keeps a page small."""


def curve_panels(tables: Tables) -> tuple[list[Panel], list[Key]]:
    """Training return against epochs, a panel a task and team size, and who is drawn how."""
    owner = owners(tables.runs)
    curves = {run: frame for run, frame in by_run(tables.curves).items() if run in owner}
    by_cell: dict[Cell, dict[Entry, list[pd.DataFrame]]] = {}
    for run, frame in curves.items():
        cell, entry = owner[run]
        by_cell.setdefault(cell, {}).setdefault(entry, []).append(frame)
    points = int(np.clip(MAX_POINTS // max(1, len(curves)), 30, 100))
    everybody = ordered({entry for own in by_cell.values() for entry in own})
    panels = [
        _panel(i, cell, by_cell[cell], everybody, points) for i, cell in enumerate(sorted(by_cell))
    ]
    return panels, legend(everybody, everybody)


def _panel(
    index: int,
    cell: Cell,
    frames: dict[Entry, list[pd.DataFrame]],
    everybody: list[Entry],
    points: int,
) -> Panel:
    longest = max(len(frame) for own in frames.values() for frame in own)
    width = -(-longest // points)

    def draw(axes: Axes) -> None:
        for entry in ordered(frames):
            color, _ = on_page(entry, everybody)
            xy = broken_line(frames[entry], width)
            (line,) = axes.plot(xy[:, 0], xy[:, 1], color=color, linewidth=1.0, alpha=0.8)
            name(line, entry.label)
        low, high = robust_range(frame for own in frames.values() for frame in own)
        axes.set(xlabel="epoch", ylabel="training return", xlim=(0, None), ylim=(low, high))

    names = ", ".join(entry.label for entry in ordered(frames))
    alt = f"Training return against epoch on {cell.label}, one line per seed: {names}."
    return Panel(cell.label, render(draw, f"curves-{index}"), alt)


def broken_line(frames: list[pd.DataFrame], width: int) -> np.ndarray:
    """Epochs and returns of all seeds, averaged over bins of `width` epochs, gaps between them."""
    parts = [_binned(frame.sort_values("epoch"), width) for frame in frames]
    gap = np.full((1, 2), np.nan)
    return np.concatenate([piece for part in parts for piece in (part, gap)])


def _binned(frame: pd.DataFrame, width: int) -> np.ndarray:
    xy = frame[["epoch", "reward"]].to_numpy(dtype=float)
    pieces = np.array_split(xy, -(-len(xy) // width))
    return np.array([piece.mean(axis=0) for piece in pieces])


def robust_range(frames: Iterable[pd.DataFrame]) -> tuple[float | None, float | None]:
    """A frame that shows the plateaus, and most of the way there.

    It ends below the worst seed's last tenth, and below the last three quarters of most curves.
    """
    tails, ways, tops = [], [], []
    for frame in frames:
        reward = frame["reward"].to_numpy(dtype=float)
        reward = reward[np.isfinite(reward)]
        if reward.size:
            tails.append(float(np.median(reward[-max(1, reward.size // 10) :])))
            ways.append(float(np.quantile(reward[reward.size // 4 :], 0.02)))
            tops.append(float(reward.max()))
    if not tails:
        return None, None
    top, low = max(tops), float(np.quantile(tails, 0.1))
    room = max(top - low, 1e-3 * abs(top), 1e-6)
    bottom = min(low - 1.5 * room, float(np.median(ways)))
    return bottom, top + 0.04 * (top - bottom)


def by_run(frame: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each run."""
    return {str(run): rows for run, rows in frame.groupby("run")}


def owners(runs: pd.DataFrame) -> dict[str, tuple[Cell, Entry]]:
    """Cell and entry of each run; the world it was evaluated in is left open."""
    return {r["run"]: (Cell(r["task"], r["team_size"]), entry_of(r)) for r in records(runs)}
