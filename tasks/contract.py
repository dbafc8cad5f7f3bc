r"""What a task is: where a team starts, what each drone sees, and what it is paid for.

`AbstractTask` leaves observation, reward and metric open: any functions that JAX can differentiate.
The built-in tasks are of one kind, `AbstractTargetTask`: each states, for each drone, the vector to
the point where it should be and the velocity and acceleration it should have there (`target`).
Observation, reward and metric are functions of these; without the acceleration a moving target
cannot be followed without lag, because the velocity alone does not tell where along its path the
target is:

    observation = [offset, v* - v, v, a*, (roll, pitch), neighbours]
    reward      = task_reward(d, |v* - v| + vel_slack)  -  collision penalty  (`tasks/contact.py`)
    metric      = d = |offset| + slack  [m]

Neighbours are the `n_neighbors` nearest drones: offset and relative velocity, each weighted by
1 / (0.25 + d^2), zeros where the team has fewer. Every norm is sqrt(|x|^2 + 1e-6). Rewards are
those of the state after the action. All of this is a choice where the paper is silent; what it
does say stands in each task.

Slack. Near a centre or an axis the nearest point of a ring or sphere jumps with the slightest
motion, and 500 steps of back-propagation turn such jumps into gradients of 1e4 and more. Within
`CORE` a direction u is therefore shortened to q u, q = rho / CORE, and what that takes from the
distance and from the velocity error is added again, so that nobody is paid for being at a centre:

    slack = (1 - q) r,   vel_slack = (1 - q) |v*|

With a radius r >= CORE, |q r - rho| + slack = |r - rho|, the distance itself in the plane of a ring
or around a centre. Elsewhere, and in velocity, the sum is at least the true one (triangle
inequality), and its slope stays bounded.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from simulators.algebra.rotation import quat_to_rpy
from simulators.flight import Flight
from tasks import contact

SPAWN_SPACING = 0.8
"""Distance between neighbouring spawn points [m]; a choice."""
SPAWN_JITTER = 0.1
"""Largest random offset of a spawn point along x and y [m]; a choice."""


CORE = 0.3
"""Radius within which a direction is shortened towards zero [m]; a choice."""


class TaskState(eqx.Module):
    """What a controller may know: the flight, the episode's goal, the step."""

    flight: Flight
    """The team now."""
    goal: Any
    """What was drawn for this episode, a pytree of the task's own."""
    step: Int[Array, ""]
    """Control steps since the reset."""


class Target(eqx.Module):
    """Where each drone should be and how fast it should be there, world frame."""

    offset: Float[Array, "drones 3"]
    """From the drone to the nearest point that satisfies the task [m]."""
    vel: Float[Array, "drones 3"]
    """Velocity that satisfies the task [m/s]."""
    acc: Float[Array, "drones 3"]
    """Acceleration of a drone that keeps satisfying it [m/s^2]."""
    slack: Float[Array, " drones"] | float = 0.0
    """Distance that `offset` does not show [m], see the top of the module."""
    vel_slack: Float[Array, " drones"] | float = 0.0
    """Velocity error that `vel` does not show [m/s]."""


def check_above(of: Any, low: int, *names: str) -> None:
    """Raises a ValueError unless each of these settings of a task or method is above `low`."""
    for name in names:
        if not getattr(of, name) > low:
            raise ValueError(f"`{name}` must be above {low}, got {getattr(of, name)}.")


def check_at_least(of: Any, low: int, *names: str) -> None:
    """Raises a ValueError unless each of these settings of a task or method is at least `low`."""
    for name in names:
        if not getattr(of, name) >= low:
            raise ValueError(f"`{name}` must be at least {low}, got {getattr(of, name)}.")


class AbstractTask(eqx.Module):
    """A cooperative task for `n_drones` drones that share one policy."""

    n_drones: eqx.AbstractVar[int]
    """Team size, at least 2."""
    horizon: eqx.AbstractVar[int]
    """Episode length [control steps of 0.02 s]."""
    version: eqx.AbstractClassVar[str]
    """Declared version; results are reused only while it stays the same."""
    station_keeping: eqx.AbstractClassVar[bool]
    """Whether the team hovers at the end, which calibration flights under-represent."""

    def __check_init__(self) -> None:
        check_at_least(self, 2, "n_drones")
        check_at_least(self, 1, "horizon")

    @abc.abstractmethod
    def reset(self, key: PRNGKeyArray) -> tuple[Float[Array, "drones 3"], Any]:
        """Spawn positions on the ground [m] and the goal of a new episode."""

    @abc.abstractmethod
    def observe(self, state: TaskState) -> Float[Array, "drones obs"]:
        """What each drone sees."""

    @property
    @abc.abstractmethod
    def obs_size(self) -> int:
        """Length of one drone's observation."""

    @abc.abstractmethod
    def rewards(self, state: TaskState) -> tuple[Float[Array, " drones"], Float[Array, " drones"]]:
        """Reward of one step, per drone: as reported (exact), and as trained on (smooth).

        `tasks/contact.py` has the penalty of contacts, exact and smooth.
        """

    @abc.abstractmethod
    def error(self, state: TaskState) -> Float[Array, " drones"]:
        """How far each drone is from what the task asks for, the metric `position_error` [m]."""


class AbstractTargetTask(AbstractTask):
    """A task that says where each drone should be; observation and reward follow from that."""

    n_neighbors: eqx.AbstractVar[int]
    """How many nearest drones each one observes."""
    observe_attitude: eqx.AbstractVar[bool]
    """Whether roll and pitch are observed."""

    def __check_init__(self) -> None:
        check_at_least(self, 0, "n_neighbors")

    @abc.abstractmethod
    def target(self, state: TaskState) -> Target:
        """Where each drone should be now."""

    @abc.abstractmethod
    def task_reward(
        self, distance: Float[Array, " drones"], vel_error: Float[Array, " drones"]
    ) -> Float[Array, " drones"]:
        """Reward of one step, per drone, from distance [m] and velocity error [m/s]."""

    def observe(self, state: TaskState) -> Float[Array, "drones obs"]:
        """What each drone sees; the layout stands at the top of this module."""
        flight, target = state.flight, self.target(state)
        parts = [target.offset, target.vel - flight.vel, flight.vel, target.acc]
        if self.observe_attitude:
            parts.append(quat_to_rpy(flight.quat)[:, :2])
        return jnp.concatenate([*parts, self._neighbors(flight)], axis=-1)

    @property
    def obs_size(self) -> int:
        """Length of one drone's observation."""
        return 12 + 2 * self.observe_attitude + 6 * self.n_neighbors

    def error(self, state: TaskState) -> Float[Array, " drones"]:
        """Distance of each drone to where it should be [m]."""
        target = self.target(state)
        return norm(target.offset) + target.slack

    def rewards(self, state: TaskState) -> tuple[Float[Array, " drones"], Float[Array, " drones"]]:
        """Reward of one step, per drone: as reported (exact), and as trained on (smooth)."""
        target = self.target(state)
        vel_error = norm(target.vel - state.flight.vel) + target.vel_slack
        reward = self.task_reward(norm(target.offset) + target.slack, vel_error)
        pos = state.flight.pos
        return reward - contact.penalty(pos), reward - contact.soft_penalty(pos)

    def _neighbors(self, flight: Flight) -> Float[Array, "drones features"]:
        n, k = self.n_drones, min(self.n_neighbors, self.n_drones - 1)
        index = contact.nearest(jax.lax.stop_gradient(flight.pos), k)
        state = jnp.concatenate([flight.pos, flight.vel], axis=-1)
        relative = state[index] - state[:, None]
        squared = jnp.sum(relative[..., :3] ** 2, axis=-1, keepdims=True)
        seen = (relative / (0.25 + squared)).reshape(n, 6 * k)
        return jnp.pad(seen, ((0, 0), (0, 6 * (self.n_neighbors - k))))


def norm(x: Float[Array, "*n axes"]) -> Float[Array, "*n"]:
    """Euclidean norm over the last axis, with a defined gradient at zero."""
    return jnp.sqrt(jnp.sum(x**2, axis=-1) + 1e-6)


def spawn_grid(n_drones: int, key: PRNGKeyArray) -> Float[Array, "drones 3"]:
    """Points of a jittered square grid on the ground, centred on the origin [m, world]."""
    side = -(-n_drones // max(1, round(n_drones**0.5)))
    index = jnp.arange(n_drones)
    rows = -(-n_drones // side)
    x = (index % side) - 0.5 * (side - 1)
    y = (index // side) - 0.5 * (rows - 1)
    xy = SPAWN_SPACING * jnp.stack([x, y], axis=-1)
    xy = xy + jax.random.uniform(key, (n_drones, 2), minval=-SPAWN_JITTER, maxval=SPAWN_JITTER)
    return jnp.concatenate([xy, jnp.zeros((n_drones, 1))], axis=-1)


def ring_radius(n_drones: int, spacing: float, smallest: float) -> float:
    """Radius of a ring with `spacing` [m] of arc between `n_drones`, at least `smallest`."""
    return max(smallest, spacing * n_drones / (2.0 * jnp.pi))


def shortfall(vector: Float[Array, "*n axes"]) -> Float[Array, "*n"]:
    """By how much `direction` is shorter than 1 [-]: 0 from `CORE` on, 1 at the origin."""
    return 1.0 - norm(vector) / jnp.maximum(norm(vector), CORE)


def direction(vector: Float[Array, "*n axes"]) -> Float[Array, "*n axes"]:
    """Unit vector; shorter than 1 within `CORE` of the origin, where a unit vector would jump."""
    return vector / jnp.maximum(norm(vector), CORE)[..., None]


def ring_offset(
    pos: Float[Array, "drones 3"], center: Float[Array, " 3"], radius: float
) -> Float[Array, "drones 3"]:
    """Vector from each drone to the nearest point of a horizontal ring [m]."""
    relative = pos - center
    out = radius * direction(relative[:, :2]) - relative[:, :2]
    return jnp.concatenate([out, -relative[:, 2:]], axis=-1)
