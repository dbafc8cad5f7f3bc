"""Targets of single manoeuvres: what `diagnosis.decide.advice` says, and gentle flights beside.

Every function takes the times of the physics steps [s] and gives the `TrackedPath` of one drone.
Steps of attitude and thrust are added to the controller's commands and are as sharp as these.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from blind.fly.references import TrackedPath, smooth

Array = np.ndarray
Times = Float[np.ndarray, " steps"]

HEIGHT = 1.0
"""Height of what does not fly low [m]."""
STEP_EVERY = 0.4
"""Time between two steps of attitude or thrust [s]."""
ANGLE = 0.3
"""Size of a step of roll or pitch, from half of it on one side to half of it on the other [rad]."""
THRUST = 0.3
"""Size of a step of thrust over hover thrust, likewise [-]."""


def hover(t: Times) -> TrackedPath:
    """Hover at 1 m, swaying by 5 cm."""
    return _reference(t, _swaying(t, HEIGHT))


def hover_low(t: Times) -> TrackedPath:
    """Hover at 0.1 m, swaying by 5 cm."""
    return _reference(t, _swaying(t, 0.1))


def slow_lines(t: Times) -> TrackedPath:
    """To and fro along a straight line, at most at 0.5 m/s."""
    return _reference(t, _at_height(0.5 * np.sin(t) * smooth(t / 2.0)))


def fast_lines(t: Times) -> TrackedPath:
    """To and fro along a straight line, at 3 m/s in its middle."""
    return _reference(t, _at_height(2.0 * np.sin(1.5 * t) * smooth(t / 4.0)))


def two_speeds(t: Times) -> TrackedPath:
    """Along a line at 0.5 and 3 m/s, each held for 2 s, and back."""
    at = [0.0, 0.5, 2.5, 3.5, 5.5, 6.5, 8.5, 9.5, 11.5, 12.0]
    speed = np.interp(t % 12.0, at, [0.0, 0.5, 0.5, 3.0, 3.0, 0.0, 0.0, -3.0, -3.0, -0.5])
    return _reference(t, _at_height(np.cumsum(speed) * (t[1] - t[0])))


def attitude_steps(t: Times) -> TrackedPath:
    """Steps of roll and pitch of 0.3 rad every 0.4 s in hover."""
    return _reference(t, _swaying(t, HEIGHT), tilt=_steps(t, np.ones(len(t), bool)))


def both_steps(t: Times) -> TrackedPath:
    """Steps of attitude and of thrust in turn, 2.4 s each."""
    tilting = _count(t) % 12 < 6
    thrust = np.where(tilting, 0.0, THRUST * _square(t))
    return _reference(t, _swaying(t, HEIGHT), tilt=_steps(t, tilting), thrust=thrust)


def pumping(t: Times) -> TrackedPath:
    """Up and down by 25 cm every 1.4 s: thrust swings by half of the weight to either side."""
    pos = _swaying(t, HEIGHT)
    pos[:, 2] += 0.25 * np.sin(2 * np.pi * t / 1.4) * smooth(t / 2.0)
    return _reference(t, pos)


def tumbling(t: Times) -> TrackedPath:
    """Climbs and descents at up to 1 m/s in a circle of 1 m at 2 m/s, tilted by 0.4 rad."""
    swing = smooth(t / 2.0)
    x, y = swing * np.cos(2.0 * t), swing * np.sin(2.0 * t)
    return _reference(t, np.stack([x, y, 1.5 + 0.5 * swing * np.sin(2.0 * t)], axis=1))


def turning(t: Times) -> TrackedPath:
    """Hover with the yaw turned by 90 degrees every 3 s, to the left, back, and to the right."""
    quarters = np.asarray([0.0, 0.0, 1.0, 0.0, -1.0])
    i = np.floor(t / 3.0).astype(int) % 4
    yaw = quarters[i] + smooth((t % 3.0) / 0.5) * (quarters[i + 1] - quarters[i])
    return _reference(t, _swaying(t, HEIGHT), yaw=0.5 * np.pi * yaw)


def heights(t: Times) -> TrackedPath:
    """Hover at 1, 0.3, 0.1 and 0.05 m, 2.5 s each."""
    at = np.asarray([1.0, 1.0, 0.3, 0.1, 0.05])
    i = np.minimum(np.floor(t / 2.5).astype(int), 3)
    part = smooth((t - 2.5 * i) / 1.0)
    pos = _swaying(t, 0.0)
    pos[:, 2] = at[i] + part * (at[i + 1] - at[i])
    return _reference(t, pos)


def _swaying(t: Times, height: float) -> Float[np.ndarray, "steps 3"]:
    size = 0.05 * smooth(t / 2.0)
    return np.stack(
        [size * np.sin(0.7 * t), size * np.sin(0.5 * t), np.full_like(t, height)], axis=1
    )


def _at_height(x: Times) -> Float[np.ndarray, "steps 3"]:
    return np.stack([x, np.zeros_like(x), np.full_like(x, HEIGHT)], axis=1)


def _square(t: Times) -> Times:
    """Half up, half down, in turn."""
    return 0.5 - _count(t) % 2


def _count(t: Times) -> Int[np.ndarray, " steps"]:
    """Steps so far."""
    return np.floor(t / STEP_EVERY + 1e-9).astype(int)


def _steps(t: Times, on: Bool[np.ndarray, " steps"]) -> Float[np.ndarray, "steps 2"]:
    """Steps of roll, then of pitch, in turn; zero where they are not `on`."""
    rolling = _count(t) % 4 < 2
    tilt = ANGLE * _square(t) * on
    return np.stack([np.where(rolling, tilt, 0.0), np.where(rolling, 0.0, tilt)], axis=1)


def _reference(
    t: Times,
    pos: Float[np.ndarray, "steps 3"],
    yaw: Array | float = 0.0,
    tilt: Array | float = 0.0,
    thrust: Array | float = 0.0,
) -> TrackedPath:
    vel = np.gradient(pos, t, axis=0)
    dither = np.zeros((len(t), 4))
    dither[:, :2], dither[:, 3] = tilt, thrust
    return TrackedPath(pos, vel, np.gradient(vel, t, axis=0), np.full_like(t, 0.0) + yaw, dither)
