"""Records of replayed windows: their normal equations, and what was measured and predicted."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from diagnosis.logs.segments import REPLAY_WINDOW_S, Segments, enough
from diagnosis.replay.replay import Prediction
from diagnosis.replay.whitening import residual


@dataclasses.dataclass(frozen=True)
class Normal:
    """Normal equations at one parameter vector, per window (of all drones together)."""

    H: Float[np.ndarray, "windows params params"]
    """J'J."""
    g: Float[np.ndarray, "windows params"]
    """J'r."""
    c: Float[np.ndarray, " windows"]
    """r'r, the window's chi-square."""
    dof: Float[np.ndarray, " windows"]
    """Numbers in r less the numbers of the start."""
    flight: Int[np.ndarray, " windows"]
    """Flight of each window."""
    t: Float[np.ndarray, " windows"]
    """Start of each window since the flight's first row [s]."""
    kind: Float[np.ndarray, "windows 9"]
    """chi-square of each channel."""
    doubtful: Bool[np.ndarray, " windows"]
    """Windows in which an unknown command may still show."""

    @property
    def chi2(self) -> float:
        """Chi-square of all windows."""
        return float(self.c.sum())

    @property
    def misfit(self) -> Float[np.ndarray, " windows"]:
        """Chi-square of each window over its numbers."""
        return self.c / np.maximum(self.dof, 1.0)

    def of(self, chosen: np.ndarray) -> "Normal":
        """The windows that are chosen, by a mask or by their indices."""
        return Normal(**{name: values[chosen] for name, values in vars(self).items()})

    def by_flight(self) -> list["Normal"]:
        """Those of every flight."""
        return [self.of(self.flight == flight) for flight in np.unique(self.flight)]


Spoiled = Callable[[Normal], Bool[np.ndarray, " windows"]]
"""Which windows are not to count (`outliers.py`)."""


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Windows as they were measured and predicted, one line a drone and window."""

    row: Float[np.ndarray, "lines nodes 9"]
    """Measured position [m], velocity [m/s], roll, pitch, yaw [rad]."""
    residual: Float[np.ndarray, "lines nodes 9"]
    """Measured minus predicted."""
    time: Float[np.ndarray, "lines nodes"]
    """Time of each node since the start of its window [s]."""
    valid: Bool[np.ndarray, "lines nodes"]
    """Which nodes count."""
    thrust: Float[np.ndarray, " lines"]
    """Mean commanded thrust [N]."""
    distance: Float[np.ndarray, " lines"]
    """Smallest distance to another drone [m]; infinite for a drone alone."""
    battery: Float[np.ndarray, " lines"]
    """Mean voltage of the battery [V]; NaN where it is not known."""
    flight: Int[np.ndarray, " lines"]
    """Flight of each line."""
    t: Float[np.ndarray, " lines"]
    """Start of the window since the flight's first row [s]."""


def counted(group: Segments, chosen: slice) -> Bool[np.ndarray, "segments windows drones nodes"]:
    """Which nodes of the scored windows count, of the segments that are chosen."""
    return enough(group.valid[chosen, 1:])


def tracked(
    group: Segments, chosen: slice, prediction: Prediction, dt: float
) -> dict[str, np.ndarray]:
    """The fields of `Tracks` for the segments that are chosen; `dt` is the replay's step [s]."""
    valid = counted(group, chosen)
    shape = valid.shape[:3]
    lines = int(np.prod(shape))
    row = group.row[chosen, 1:]
    thrust = group.cmd[chosen].reshape(shape[0], shape[1] + 1, -1, shape[2], 4)[..., 3]
    pos = group.pos[chosen, 1:]
    apart = np.linalg.norm(pos[:, :, :, None] - pos[:, :, None], axis=-1)
    apart = np.where(np.eye(shape[2], dtype=bool), np.inf, apart).min(axis=-1)
    nodes = valid.shape[3]
    battery = np.full(shape, np.nan)
    volts = group.voltage[chosen].reshape(shape[0], shape[1] + 1, -1)[:, 1:].mean(axis=2)
    battery[..., 0] = np.where(volts > 0.0, volts, np.nan)
    start = group.start[chosen][:, None] + REPLAY_WINDOW_S * np.arange(1, shape[1] + 1)
    per_drone = lambda x: np.broadcast_to(x[..., None], shape).reshape(lines)  # noqa: E731
    return {
        "row": row.reshape(lines, nodes, 9),
        "residual": residual(row, prediction.value).reshape(lines, nodes, 9),
        "time": (group.place[chosen, 1:] * dt).reshape(lines, nodes),
        "valid": valid.reshape(lines, nodes),
        "thrust": thrust[:, 1:].mean(axis=2).reshape(lines),
        "distance": apart.reshape(lines),
        "battery": battery.reshape(lines),
        "flight": per_drone(np.repeat(group.flight[chosen][:, None], shape[1], axis=1)),
        "t": per_drone(start),
    }
