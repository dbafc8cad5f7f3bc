"""Top views of one evaluation episode, a panel a method."""

import numpy as np
import pandas as pd
from jaxtyping import Float
from markupsafe import Markup

from bench.report.pictures.curves import by_run, owners
from bench.report.pictures.looks import on_page, ordered
from bench.report.pictures.svg import INK, Panel
from bench.stats.statistics import Cell, Entry
from bench.store.tables import Tables

TOP_VIEW_INTRO = (
    "The first evaluation episode from above, one panel per method, all on one scale; the initial "
    "states are the same wherever the seed is. Open circle: start; disc: end; the older, the "
    "fainter. The bar is 1 m. A few far points may lie outside the frame."
)
MAX_POINTS = 20_000
"""Points of all paths together: what keeps a page small."""
MARKED = 40
"""Team size up to which starts and ends have marks of full size."""
SIDE = 1000
"""Width and height of a panel, in units of its drawing."""


def top_views(tables: Tables) -> list[tuple[str, list[Panel]]]:
    """Panels of one episode by task and team size."""
    owner = owners(tables.runs)
    seed = tables.column("seed")
    flown: dict[Cell, dict[Entry, list[str]]] = {}
    flights = {run: rows for run, rows in by_run(tables.trajectories).items() if run in owner}
    for run in flights:
        cell, entry = owner[run]
        flown.setdefault(cell, {}).setdefault(entry, []).append(run)
    chosen = {cell: _same_seed(entries, seed) for cell, entries in flown.items()}
    everybody = ordered({entry for picks in chosen.values() for entry in picks})
    total = sum(len(flights[run]) for picks in chosen.values() for run in picks.values())
    stride = max(1, -(-total // MAX_POINTS))
    found = []
    for cell in sorted(chosen):
        picks, frame = chosen[cell], _frame([flights[run] for run in chosen[cell].values()])
        panels = [
            Panel(
                f"{entry.label}, seed {seed[run]}",
                _view(flights[run], on_page(entry, everybody)[0], frame, stride),
                f"Paths of {cell.team_size} drones from above, {entry.label} on {cell.task}.",
            )
            for entry, run in picks.items()
        ]
        found.append((cell.label, panels))
    return found


def _frame(flights: list[pd.DataFrame]) -> tuple[Float[np.ndarray, " 2"], float]:
    """Centre and half width [m] that shows nearly all of the paths."""
    xy = pd.concat(flights)[["pos_x", "pos_y"]].to_numpy(float)
    xy = xy[np.isfinite(xy).all(axis=1)]
    if not len(xy):
        return np.zeros(2), 1.0
    low, high = np.quantile(xy, [0.005, 0.995], axis=0)
    return 0.5 * (low + high), 0.55 * float((high - low).max()) + 0.1


def _view(
    flight: pd.DataFrame, color: str, frame: tuple[Float[np.ndarray, " 2"], float], stride: int
) -> Markup:
    """Paths in four pieces of growing opacity, with starts, ends and a bar of 1 m."""
    center, reach = frame
    scale = SIDE / (2.0 * reach)
    paint = "var(--ink)" if color == INK else color
    paths = []
    for _, path in flight.sort_values("t").groupby("drone"):
        xy = path[["pos_x", "pos_y"]].to_numpy(dtype=float)
        kept = xy[np.r_[np.arange(0, len(xy) - 1, stride), len(xy) - 1]]
        kept = kept[np.isfinite(kept).all(axis=1)]
        if len(kept):
            paths.append(((kept - center) * [1.0, -1.0] + reach) * scale)
    # Marks of a large team are small, or each would cover those of its neighbours.
    size = 22.0 * min(1.0, (MARKED / max(1, len(paths))) ** 0.5)
    parts = []
    for piece, opacity in enumerate((0.2, 0.4, 0.65, 1.0)):
        lines = []
        for path in paths:
            first, last = (len(path) * np.array([piece, piece + 1])) // 4
            own = path[max(0, first - 1) : last]
            lines.append("M" + "L".join(f"{x:.0f} {y:.0f}" for x, y in own) if len(own) else "")
        parts.append(f'<path d="{"".join(lines)}" stroke-opacity="{opacity}"/>')
    starts = (f'<circle cx="{p[0, 0]:.0f}" cy="{p[0, 1]:.0f}" r="{size:.0f}"/>' for p in paths)
    ends = (
        f'<circle cx="{p[-1, 0]:.0f}" cy="{p[-1, 1]:.0f}" r="{size:.0f}" fill="{paint}"/>'
        for p in paths
    )
    bar = f'<path d="M30 {SIDE - 30}h{scale:.0f}" stroke="var(--soft)"/>'
    return Markup(
        f'<svg class="from-above" viewBox="0 0 {SIDE} {SIDE}" aria-hidden="true" fill="none" '
        f'stroke="{paint}">{"".join(parts)}<g stroke="var(--soft)">{"".join(starts)}</g>'
        f"{''.join(ends)}{bar}</svg>"
    )


def _same_seed(entries: dict[Entry, list[str]], seed: dict[str, int]) -> dict[Entry, str]:
    """A run of each entry, all of the seed that most entries have (the smallest of those)."""
    have = [seed[run] for runs in entries.values() for run in runs]
    wanted = min(set(have), key=lambda s: (-have.count(s), s))
    return {
        entry: min(entries[entry], key=lambda run: (seed[run] != wanted, seed[run], run))
        for entry in ordered(entries)
    }
