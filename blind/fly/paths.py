"""The flights of `diagnosis.remedies.flight_paths` as a controller tracks them, and steps beside.

Every function takes the times of the physics steps [s] and gives the `TrackedPath` of one drone.
Steps of attitude and thrust are added to the controller's commands and are as sharp as these.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from blind.fly.references import TrackedPath
from diagnosis.remedies.flight_paths import Targets, Times, hover

Array = np.ndarray

STEP_EVERY = 0.4
"""Time between two steps of attitude or thrust [s]."""
ANGLE = 0.3
"""Size of a step of roll or pitch, from half of it on one side to half of it on the other [rad]."""
THRUST = 0.3
"""Size of a step of thrust over hover thrust, likewise [-]."""


def tracked(path: Callable[[Times], Targets | TrackedPath], t: Times) -> TrackedPath:
    """A path as a controller follows it: targets are given velocities and accelerations."""
    found = path(t)
    return _tracked(t, found) if isinstance(found, Targets) else found


def attitude_steps(t: Times) -> TrackedPath:
    """Steps of roll and pitch of 0.3 rad every 0.4 s in hover."""
    return _tracked(t, hover(t), tilt=_steps(t, np.ones(len(t), bool)))


def both_steps(t: Times) -> TrackedPath:
    """Steps of attitude and of thrust in turn, 2.4 s each."""
    tilting = _count(t) % 12 < 6
    thrust = np.where(tilting, 0.0, THRUST * _square(t))
    return _tracked(t, hover(t), tilt=_steps(t, tilting), thrust=thrust)


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


def _tracked(
    t: Times, targets: Targets, tilt: Array | float = 0.0, thrust: Array | float = 0.0
) -> TrackedPath:
    vel = np.gradient(targets.pos, t, axis=0)
    dither = np.zeros((len(t), 4))
    dither[:, :2], dither[:, 3] = tilt, thrust
    return TrackedPath(targets.pos, vel, np.gradient(vel, t, axis=0), targets.yaw, dither)
