"""Where the drones of a blind case are told to go, and the shaking that informs about them.

Eight kinds of flight follow each other: circle, figure 8, steps along each axis, fast lines, a
circle under slow yaw sweeps, a low circle, vertical moves, and a low figure 8. Sizes and speeds
vary by a few tens of percent from case to case. Every flight starts at rest at its first target
and swings in within `_RAMP` seconds.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from diagnosis.remedies.flight_paths import smooth

N_KINDS = 8
"""Kinds of flight."""
LOW = (5, 7)
"""Kinds that fly near the floor."""
_RAMP = 2.0
"""Time in which a flight swings in [s]."""
_DESCENT = 3.0
"""Time in which a low flight comes down [s]."""
_HEIGHT = 1.0
"""Height of the flights that are not low [m]."""

Array = np.ndarray


@dataclasses.dataclass(frozen=True)
class TrackedPath:
    """Targets of one drone at every physics step."""

    pos: Float[Array, "steps 3"]
    """Position, world [m]."""
    vel: Float[Array, "steps 3"]
    """Velocity [m/s]."""
    acc: Float[Array, "steps 3"]
    """Acceleration [m/s^2]."""
    yaw: Float[Array, " steps"]
    """Heading [rad]."""
    dither: Float[Array, "steps 4"]
    """Added to the commands: roll, pitch, yaw [rad], and thrust relative to hover [-]."""


def make_reference(
    kind: int, t: Float[Array, " steps"], rng: np.random.Generator, low_height: float = 0.0
) -> TrackedPath:
    """Targets of a flight of the given kind (counted modulo `N_KINDS`) at times `t` [s].

    `low_height` [m] lifts the low flights, for vehicles with something below them.
    """
    kind = kind % N_KINDS
    shape = _SHAPES[kind](rng)
    centre = np.asarray([0.0, 0.0, _HEIGHT])
    if kind in LOW:
        shape, centre = _lowered(shape, rng), np.asarray([0.0, 0.0, low_height])
    pos = shape(t) * smooth(t / _RAMP)[:, None] + centre
    if kind in LOW:  # the way down from a safe height
        pos[:, 2] += 0.7 * (1.0 - smooth(t / _DESCENT))
    vel = np.gradient(pos, t, axis=0)
    yaw = np.zeros_like(t)
    if kind == 4:
        yaw = rng.uniform(0.7, 1.1) * np.sin(2 * np.pi * rng.uniform(0.08, 0.13) * t)
    return TrackedPath(pos, vel, np.gradient(vel, t, axis=0), yaw, _dither(t, rng))


def above(below: TrackedPath, t: Float[Array, " steps"], rng: np.random.Generator) -> TrackedPath:
    """Targets of a second drone that sweeps to and fro about half a metre above another."""
    angle = rng.uniform(0.0, 2 * np.pi)
    sweep = rng.uniform(0.2, 0.3) * np.sin(2 * np.pi * rng.uniform(0.2, 0.35) * t)
    across = 0.1 * np.sin(2 * np.pi * rng.uniform(0.1, 0.17) * t + rng.uniform(0.0, 6.0))
    x = np.cos(angle) * sweep - np.sin(angle) * across
    y = np.sin(angle) * sweep + np.cos(angle) * across
    pos = below.pos + np.stack([x, y, np.full_like(t, rng.uniform(0.45, 0.6))], axis=1)
    vel = np.gradient(pos, t, axis=0)
    return TrackedPath(pos, vel, np.gradient(vel, t, axis=0), below.yaw, _dither(t, rng))


def _dither(t: Array, rng: np.random.Generator) -> Array:
    """Zero-mean sums of five sines of 0.5 to 6 Hz: tilts by 0.035 rad, thrust by 3.5 % (RMS)."""
    freq = rng.uniform(0.5, 6.0, (4, 5))
    phase = rng.uniform(0.0, 2 * np.pi, (4, 5))
    waves = np.sin(2 * np.pi * freq[:, :, None] * t + phase[:, :, None]).sum(axis=1)
    size = np.asarray([0.035, 0.035, 0.02, 0.035]) / np.sqrt(2.5)
    return (size[:, None] * waves).T


Shape = Callable[[Array], Array]


def _circle(rng: np.random.Generator) -> Shape:
    radius, rate = rng.uniform(0.7, 1.0), rng.uniform(1.4, 1.9) * rng.choice([-1.0, 1.0])
    rise = rng.uniform(0.1, 0.2)

    def shape(t: Array) -> Array:
        a = rate * t
        return np.stack([radius * np.cos(a), radius * np.sin(a), rise * np.sin(0.7 * a)], axis=1)

    return shape


def _eight(rng: np.random.Generator) -> Shape:
    size, rate, phase = rng.uniform(0.8, 1.1), rng.uniform(1.0, 1.35), rng.uniform(0.0, 6.0)

    def shape(t: Array) -> Array:
        a = rate * t + phase
        return np.stack(
            [size * np.sin(a), 0.6 * size * np.sin(2 * a), 0.15 * np.cos(1.3 * a)], axis=1
        )

    return shape


def _steps(rng: np.random.Generator) -> Shape:
    every = rng.uniform(1.1, 1.5)
    goals = rng.uniform(-1.0, 1.0, (4096, 3)) * np.asarray([0.7, 0.7, 0.3])

    def shape(t: Array) -> Array:
        i = np.floor(t / every).astype(int) % (len(goals) - 1)
        part = smooth((t % every) / 1.0)[:, None]
        return goals[i] * (1.0 - part) + goals[i + 1] * part

    return shape


def _lines(rng: np.random.Generator) -> Shape:
    angle, rate = rng.uniform(0.0, np.pi), rng.uniform(1.5, 1.8)
    size = rng.uniform(1.1, 1.4)

    def shape(t: Array) -> Array:
        # The direction of the line turns slowly, so that every heading is flown.
        direction = angle + 0.25 * t
        along = size * np.sin(rate * t)
        z = 0.1 * np.sin(0.9 * t)
        return np.stack([along * np.cos(direction), along * np.sin(direction), z], axis=1)

    return shape


def _vertical(rng: np.random.Generator) -> Shape:
    size, rate = rng.uniform(0.4, 0.55), rng.uniform(1.8, 2.4)
    drift = rng.uniform(0.2, 0.4)

    def shape(t: Array) -> Array:
        x, y = drift * np.sin(0.6 * t), drift * np.sin(0.8 * t + 1.0)
        return np.stack([x, y, size * np.sin(rate * t)], axis=1)

    return shape


def _lowered(shape: Shape, rng: np.random.Generator) -> Shape:
    """The same path over ground, between 0.08 and 0.3 m high."""
    rate, phase = rng.uniform(0.9, 1.5), rng.uniform(0.0, 6.0)

    def low(t: Array) -> Array:
        pos = 0.7 * shape(t)
        pos[:, 2] = 0.17 + 0.09 * np.sin(rate * t + phase)
        return pos

    return low


_SHAPES = (_circle, _eight, _steps, _lines, _circle, _circle, _vertical, _eight)
