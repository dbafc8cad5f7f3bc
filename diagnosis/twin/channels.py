"""Flights as evenly sampled channels: measured, simulated, and the simulation's slopes.

A channel is an angle, or the mean acceleration between two nodes (`NODE_DT` apart). Accelerations
and velocities are turned into the heading frame, by the measured yaw, so that a flight north and a
flight east look alike.

| channel | | unit |
|---|---|---|
| 0, 1, 2 | roll, pitch, yaw | rad |
| 3, 4, 5 | acceleration forward, left (heading frame), up | m/s^2 |
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.logs.flights import FlightLog
from diagnosis.logs.segments import NODE_DT, REPLAY_WINDOW_S, Segments
from diagnosis.replay.replay import NARROW, Replay, directions_along

CHANNELS = (
    *("roll", "pitch", "yaw"),
    *("acceleration forward", "acceleration left", "acceleration up"),
)
"""What a sample holds."""
UNITS = ("rad",) * 3 + ("m/s^2",) * 3
"""Their units."""
N = len(CHANNELS)
"""Number of channels."""
ANGLES = 3
"""Leading channels that are angles."""
FEWEST_SAMPLES = 50
"""Samples that a flight must have to say anything: one second; a choice."""
PART = 125
"""Samples that count in a part of a flight, at least: 2.5 seconds; a choice."""


@dataclasses.dataclass(frozen=True)
class Channels:
    """One flight of one drone at `1 / NODE_DT` Hz."""

    name: str
    """The flight's name."""
    measured: Float[np.ndarray, "time 6"]
    """What the log says."""
    simulated: Float[np.ndarray, "time 6"]
    """What the simulator says under the logged commands."""
    slopes: Float[np.ndarray, "params time 6"]
    """Derivatives of `simulated` by the parameters of all effects, or by those asked for."""
    vel: Float[np.ndarray, "time 3"]
    """Measured velocity, heading frame [m/s]."""
    valid: Bool[np.ndarray, " time"]
    """Samples that count."""
    filled: Bool[np.ndarray, ""] | bool = False
    """Whether samples lie on splines between slower measurements."""

    @property
    def gap(self) -> Float[np.ndarray, "time 6"]:
        """Measured minus simulated."""
        return self.measured - self.simulated

    def with_slopes_of(self, other: "Channels", along: Sequence[int]) -> "Channels":
        """The same, whose slopes are by the parameters at `along`, with the other's by the rest."""
        slopes = other.slopes.copy()
        slopes[list(along)] = self.slopes
        return dataclasses.replace(self, slopes=slopes)

    def parts(self, before: int) -> tuple["Channels", ...]:
        """The flight in parts of `PART` samples that count or a few more, or as a whole.

        Each begins with the `before` samples that precede it, which do not count.
        """
        n, counted = max(int(self.valid.sum()) // PART, 1), np.cumsum(self.valid)
        inner = np.searchsorted(counted, counted[-1] * np.arange(1, n) / n)
        ends = [0, *inner.tolist(), len(counted)]
        return tuple(
            self._part(max(start - before, 0), start, end)
            for start, end in itertools.pairwise(ends)
        )

    def _part(self, history: int, start: int, end: int) -> "Channels":
        valid = self.valid[history:end].copy()
        valid[: start - history] = False
        return dataclasses.replace(
            self,
            measured=self.measured[history:end],
            simulated=self.simulated[history:end],
            slopes=self.slopes[:, history:end],
            vel=self.vel[history:end],
            valid=valid,
        )


def to_arrays(flights: Sequence[Channels], names: Sequence[str]) -> dict[str, np.ndarray]:
    """Flights as arrays, under their places among `names` in the place of their own names."""
    return {
        f"{names.index(flight.name)}.{field}": np.asarray(array)
        for flight in flights
        for field, array in vars(flight).items()
        if field != "name"
    }


def of_arrays(arrays: Mapping[str, np.ndarray], names: Sequence[str]) -> tuple[Channels, ...]:
    """The inverse of `to_arrays`."""
    made: dict[int, dict[str, np.ndarray]] = {}
    for key, array in arrays.items():
        place, field = key.split(".")
        made.setdefault(int(place), {})[field] = array
    return tuple(Channels(name=names[i], **made[i]) for i in sorted(made))


def make_channels(
    replay: Replay,
    logs: Sequence[FlightLog],
    segments: Segments,
    vector: Float[np.ndarray, " params"],
    along: Sequence[int] | None,
) -> tuple[Channels, ...]:
    """The channels of every flight of one drone with `FEWEST_SAMPLES`, simulated at `vector`.

    Their slopes are by all parameters, or by those at `along`, in that order.
    """
    few = along if along is not None and len(along) <= NARROW else None
    vectors = np.repeat(vector[None], len(logs), axis=0)
    directions = directions_along(len(vector), few)
    parts = [p for _, p in replay(segments, vectors, directions, turns=False)]
    value = np.concatenate([part.value for part in parts])[:, :, 0]
    slope = np.concatenate([part.slope for part in parts], axis=1)[:, :, :, 0]
    if along is not None:
        slope = slope[list(along)] if few is None else slope[: len(few)]
    made = [
        _of_flight(replay, segments, log.name, segments.flight == i, value, slope)
        for i, log in enumerate(logs)
    ]
    return tuple(one for one in made if one.valid.sum() >= FEWEST_SAMPLES)


def _of_flight(
    replay: Replay,
    segments: Segments,
    name: str,
    mine: Bool[np.ndarray, " segments"],
    value: Float[np.ndarray, "segments windows nodes 9"],
    slope: Float[np.ndarray, "params segments windows nodes 9"],
) -> Channels:
    row = segments.row[mine][:, 1:, 0]
    n_nodes = row.shape[2]
    place = segments.place[mine][:, 1:, 0].reshape(-1, n_nodes) * replay.dt
    start = segments.vel[mine][:, 1:, 0].reshape(-1, 3)
    row, flown = row.reshape(-1, 9), value[mine].reshape(-1, n_nodes, 9)
    pushed = slope[:, mine].reshape(len(slope), -1, n_nodes, 9)
    t = (np.arange(len(place))[:, None] * REPLAY_WINDOW_S + place).ravel()
    measured_acc, even = _measured_acc(t, row[:, 3:6])
    valid = segments.valid[mine][:, 1:, 0].ravel()
    valid &= even & np.concatenate([[False], valid[:-1]])
    yaw = row[:, 8]
    simulated = _acc(flown[..., 3:6], start, place)
    slopes = np.stack([_acc(one[..., 3:6], np.zeros_like(start), place) for one in pushed])
    end = int(np.flatnonzero(valid)[-1]) + 1 if valid.any() else 0
    angles, lean = flown[..., 6:].reshape(-1, 3), pushed[..., 6:].reshape(len(slope), -1, 3)
    return Channels(
        name=name,
        measured=np.concatenate([row[:, 6:], headed(measured_acc, yaw)], axis=1)[:end],
        simulated=np.concatenate([_near(angles, row[:, 6:]), headed(simulated, yaw)], axis=1)[:end],
        slopes=np.concatenate([lean, headed(slopes, yaw)], axis=2)[:, :end],
        vel=headed(row[:, 3:6], yaw)[:end],
        valid=valid[:end],
    )


def _near(angles: Float[np.ndarray, "time 3"], to: Float[np.ndarray, "time 3"]) -> np.ndarray:
    """`angles` with the whole turns that bring the yaw next to that of `to`."""
    turns = np.round((to - angles) / (2.0 * np.pi)) * np.asarray([0.0, 0.0, 1.0])
    return angles + 2.0 * np.pi * turns


def _measured_acc(
    t: Float[np.ndarray, " time"], vel: Float[np.ndarray, "time 3"]
) -> tuple[np.ndarray, Bool[np.ndarray, " time"]]:
    """Acceleration since the row before [m/s^2], and where the two are one node apart."""
    step = np.diff(t, prepend=t[0])
    even = np.abs(step - NODE_DT) < 0.5 * NODE_DT
    change = np.diff(vel, axis=0, prepend=vel[:1])
    return change / np.where(even, step, NODE_DT)[:, None], even


def _acc(
    vel: Float[np.ndarray, "windows nodes 3"],
    start: Float[np.ndarray, "windows 3"],
    place: Float[np.ndarray, "windows nodes"],
) -> Float[np.ndarray, "time 3"]:
    """Mean acceleration up to each node since the node before, or since its window's start."""
    before = np.concatenate([start[:, None], vel[:, :-1]], axis=1)
    step = np.maximum(np.diff(place, axis=1, prepend=0.0), 0.25 * NODE_DT)
    return ((vel - before) / step[..., None]).reshape(-1, 3)


def headed(
    vector: Float[np.ndarray, "*n time 3"], yaw: Float[np.ndarray, " time"]
) -> Float[np.ndarray, "*n time 3"]:
    """World vectors in the frame that is level and turned by `yaw` [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([c * x + s * y, c * y - s * x, vector[..., 2]], axis=-1)
