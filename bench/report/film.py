"""A film of a flight: each drone is a dot with the path that it has flown so far."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

FORMATS = (".gif", ".png", ".webp")
"""Endings of animated pictures that can be written."""
FPS = 20
"""Pictures per second of flight."""
SIZE = (6.4, 4.8)
"""Width and height of a picture [in], each of 100 px."""
COLORS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
"""Drone after drone, after Okabe and Ito (2008)."""
LEAST_SPAN = 0.5
"""Shortest side of the space that is shown [m]; no side is shorter than a third of the longest."""


def write_film(
    t: Float[np.ndarray, " time"], pos: Float[np.ndarray, "time drones 3"], path: Path
) -> None:
    """Writes a film of positions [m] at times [s], in the format that the ending of `path` says."""
    times = np.arange(t[0], t[-1] + 1e-9, 1.0 / FPS)
    pos = np.where(np.isfinite(pos), pos, np.nan)
    columns = [np.interp(times, t, column) for column in pos.reshape(len(t), -1).T]
    shown = np.stack(columns, axis=-1).reshape(len(times), *pos.shape[1:])

    figure = Figure(figsize=SIZE, dpi=100)
    axes = figure.add_subplot(projection="3d", position=(0, 0.04, 0.94, 0.96))
    low, high = _limits(pos)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
    axes.locator_params(nbins=4)
    clock = axes.text2D(0.05, 0.94, "", transform=axes.transAxes)
    drones = []
    for i in range(pos.shape[1]):
        color = COLORS[i % len(COLORS)]
        (trail,) = axes.plot([], [], [], color=color, alpha=0.5)
        (dot,) = axes.plot([], [], [], "o", color=color, markersize=8)
        drones.append((trail, dot))

    def draw(i: int) -> list:
        clock.set_text(f"{times[i] - t[0]:.1f} s")
        for (trail, dot), path_of in zip(drones, shown.swapaxes(0, 1), strict=True):
            trail.set_data_3d(*path_of[: i + 1].T)
            dot.set_data_3d(*path_of[i : i + 1].T)
        return []

    path.parent.mkdir(parents=True, exist_ok=True)
    film = FuncAnimation(figure, draw, frames=len(times))
    film.save(path, writer=PillowWriter(FPS))


def _limits(
    pos: Float[np.ndarray, "time drones 3"],
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Lowest and highest corner of a space that holds all but the farthest positions."""
    known = pos[np.isfinite(pos).all(axis=-1)]
    low, high = np.quantile(known, [0.01, 0.99], axis=0) if len(known) else np.zeros((2, 3))
    span = high - low
    reach = 0.55 * np.maximum(span, max(LEAST_SPAN, span.max() / 3))
    middle = 0.5 * (low + high)
    return middle - reach, middle + reach
