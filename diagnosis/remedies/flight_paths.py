"""Targets of single manoeuvres: what `diagnosis.decide.advice` says, and gentle flights beside.

Every function takes times [s] and gives `Targets`; z points up, the origin lies on the floor amid
the room. `bench blind --next-flight` flies the same paths, so that what is advised was tried.
"""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

Times = Float[np.ndarray, " steps"]

HEIGHT = 1.0
"""Height of what does not fly low [m]."""


@dataclasses.dataclass(frozen=True)
class Targets:
    """Where a drone should be."""

    pos: Float[np.ndarray, "steps 3"]
    """Position, world [m]."""
    yaw: Times
    """Heading, counter-clockwise from the world's x axis [rad]."""


def hover(t: Times) -> Targets:
    """Hover at 1 m, swaying by 5 cm."""
    return _level(swaying(t, HEIGHT))


def hover_low(t: Times) -> Targets:
    """Hover at 0.1 m, swaying by 5 cm."""
    return _level(swaying(t, 0.1))


def slow_lines(t: Times) -> Targets:
    """To and fro along a straight line, at most at 0.5 m/s."""
    return _level(_at_height(0.5 * np.sin(t) * smooth(t / 2.0)))


def fast_lines(t: Times) -> Targets:
    """To and fro along a straight line, at 3 m/s in its middle."""
    return _level(_at_height(2.0 * np.sin(1.5 * t) * smooth(t / 4.0)))


def two_speeds(t: Times) -> Targets:
    """Along a line at 0.5 and 3 m/s, each held for 2 s, and most of the way back."""
    at = [0.0, 0.5, 2.5, 3.5, 5.5, 6.5, 8.5, 9.5, 11.5, 12.0]
    speed = np.interp(t % 12.0, at, [0.0, 0.5, 0.5, 3.0, 3.0, 0.0, 0.0, -3.0, -3.0, -0.5])
    return _level(_at_height(np.cumsum(speed) * (t[1] - t[0])))


def pumping(t: Times) -> Targets:
    """Up and down by 25 cm every 1.4 s: thrust swings by half of the weight to either side."""
    pos = swaying(t, HEIGHT)
    pos[:, 2] += 0.25 * np.sin(2 * np.pi * t / 1.4) * smooth(t / 2.0)
    return _level(pos)


def tumbling(t: Times) -> Targets:
    """Climbs and descents at up to 1 m/s in a circle of 1 m at 2 m/s, tilted by 0.4 rad."""
    swing = smooth(t / 2.0)
    x, y = swing * np.cos(2.0 * t), swing * np.sin(2.0 * t)
    return _level(np.stack([x, y, 1.5 + 0.5 * swing * np.sin(2.0 * t)], axis=1))


def turning(t: Times) -> Targets:
    """Hover with the yaw turned by 90 degrees every 3 s, to the left, back, and to the right."""
    quarters = np.asarray([0.0, 0.0, 1.0, 0.0, -1.0])
    i = np.floor(t / 3.0).astype(int) % 4
    yaw = quarters[i] + smooth((t % 3.0) / 0.5) * (quarters[i + 1] - quarters[i])
    return Targets(swaying(t, HEIGHT), 0.5 * np.pi * yaw)


def heights(t: Times) -> Targets:
    """Hover at 1, 0.3, 0.1 and 0.05 m, 2.5 s each."""
    at = np.asarray([1.0, 1.0, 0.3, 0.1, 0.05])
    i = np.minimum(np.floor(t / 2.5).astype(int), 3)
    part = smooth((t - 2.5 * i) / 1.0)
    pos = swaying(t, 0.0)
    pos[:, 2] = at[i] + part * (at[i + 1] - at[i])
    return _level(pos)


Path = Callable[[Times], Targets]
PATHS: Mapping[str, tuple[Path, float]] = {
    "hover": (hover, 60.0),
    "fast_lines": (fast_lines, 12.0),
    "two_speeds": (two_speeds, 12.0),
    "pumping": (pumping, 12.0),
    "tumbling": (tumbling, 12.0),
    "turning": (turning, 12.0),
    "heights": (heights, 12.0),
}
"""Paths that cards name (`EffectCard.paths`), each with how long to fly it [s]."""
GENERAL = "tumbling"
"""What is flown where nothing is to be separated: speed, tilt and thrust all change in it."""


def smooth(s: np.ndarray) -> np.ndarray:
    """0 before 0, 1 after 1, five times continuous between (minimum jerk)."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def swaying(t: Times, height: float) -> Float[np.ndarray, "steps 3"]:
    """Positions [m] of a hover that sways by 5 cm."""
    size = 0.05 * smooth(t / 2.0)
    return np.stack(
        [size * np.sin(0.7 * t), size * np.sin(0.5 * t), np.full_like(t, height)], axis=1
    )


def _at_height(x: Times) -> Float[np.ndarray, "steps 3"]:
    return np.stack([x, np.zeros_like(x), np.full_like(x, HEIGHT)], axis=1)


def _level(pos: Float[np.ndarray, "steps 3"]) -> Targets:
    return Targets(pos, np.zeros(len(pos)))
