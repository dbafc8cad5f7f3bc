r"""Flies a task: one world, any simulator, any controller.

A controller is anything that maps a `TaskState` to actions in [-1, 1], one row a drone.

Gradient decay (a departure from the paper, tuned for every method): the state carried from step
to step passes only a share g of its gradient,

    s <- g s + (1 - g) stop_gradient(s),

so a reward reaches back about 1 / (1 - g) steps. Zhang et al. (2024), "Back to Newton's Laws",
decay gradients too. Plain 500-step back-propagation (g = 1) is best where the policy trains in the
simulator that it is deployed in, decay where it does not (`reports/tuning.md`).

With g < 1, what still grows is limited as well: the cotangent of each number of the carried state
is clipped to +-`COTANGENT_LIMIT`, about ten times what a well-behaved episode has (a reward slope
of 1 per metre, felt for 1 / (1 - g) = 50 steps), for which the loss must be the plain sum of
rewards; its scale is put right afterwards. With g = 1 nothing is decayed or clipped, as in the
paper, unless a limit is given.
"""

import abc
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from simulators.contract import AbstractSimulator
from simulators.flight import Flight
from tasks.contact import in_contact
from tasks.contract import AbstractTask, TaskState

Controller = Callable[[TaskState], Float[Array, "drones 3"]]


class AbstractEpisodeController(eqx.Module):
    """A controller that differs from episode to episode."""

    @abc.abstractmethod
    def for_episode(self, key: PRNGKeyArray) -> Controller:
        """The controller of the episode that `key` starts."""


COTANGENT_LIMIT = 500.0
"""Largest derivative of a drone's return by one number of the carried state."""


class Episode(eqx.Module):
    """One episode, sums over its steps; cheap enough for training."""

    reward: Float[Array, "*worlds"]
    """Return with the exact collision penalty, mean over drones."""
    smooth_reward: Float[Array, "*worlds"]
    """Return with the differentiable penalty, summed over drones: what training differentiates."""
    crashes: Float[Array, "*worlds"]
    """Onsets of contact, summed over drones."""
    contact_steps: Float[Array, "*worlds"]
    """Steps with any drone in contact."""

    def with_step(
        self, task: AbstractTask, after: TaskState, before: Bool[Array, " drones"]
    ) -> tuple["Episode", Bool[Array, " drones"], Float[Array, " drones"]]:
        """The sums with one more step, who is in contact after it, and the exact reward of each.

        `before` is the contact one step earlier.
        """
        reward, smooth = task.rewards(after)
        contact = in_contact(after.flight.pos, after.flight.t)
        sums = Episode(
            reward=self.reward + jnp.mean(reward),
            smooth_reward=self.smooth_reward + jnp.sum(smooth),
            crashes=self.crashes + jnp.sum(contact & ~before),
            contact_steps=self.contact_steps + jnp.any(contact),
        )
        return sums, contact, reward


class Record(eqx.Module):
    """One step; with a leading time axis an episode, entry k being the state after action k."""

    flight: Flight
    """The team."""
    action: Float[Array, "*time drones 3"]
    """Actions in [-1, 1]."""
    reward: Float[Array, "*time drones"]
    """Reward with the exact collision penalty."""
    error: Float[Array, "*time drones"]
    """Distance to where the drone should be [m]."""
    contact: Bool[Array, "*time drones"]
    """Whether the drone is in contact."""


def passed_back(cotangent: Array, decay: float, limit: float | None) -> Array:
    """What a step passes back of a cotangent of the carried state.

    Without a limit it is clipped to +-`COTANGENT_LIMIT` where it is decayed, else not at all.
    """
    if limit is None and decay < 1.0:
        limit = COTANGENT_LIMIT
    scaled = cotangent if decay == 1.0 else decay * cotangent
    return scaled if limit is None else jnp.clip(scaled, -limit, limit)


@functools.partial(jax.custom_vjp, nondiff_argnums=(1, 2))
def _identity(x: Array, decay: float, limit: float | None) -> Array:
    """`x`, of whose cotangent a step passes back a part."""
    return x


def _identity_fwd(x: Array, decay: float, limit: float | None) -> tuple[Array, None]:
    return x, None


def _identity_bwd(decay: float, limit: float | None, _: None, cotangent: Array) -> tuple[Array]:
    return (passed_back(cotangent, decay, limit),)


_identity.defvjp(_identity_fwd, _identity_bwd)


def _damped(tree: Any, decay: float, limit: float | None) -> Any:
    """`tree`, whose gradient is decayed and limited; at a decay of 1 without a limit, as it is."""
    if decay == 1.0 and limit is None:
        return tree
    part = lambda x: _identity(x, decay, limit) if eqx.is_inexact_array(x) else x  # noqa: E731
    return jax.tree.map(part, tree)


def episode(
    task: AbstractTask,
    simulator: AbstractSimulator,
    controller: Controller,
    key: PRNGKeyArray,
    decay: float = 1.0,
    limit: float | None = None,
) -> Episode:
    """One episode's sums, differentiable in the controller, checkpointed per control step.

    `decay` and `limit` say what of the gradient a step passes back (`passed_back`).
    """
    state, goal = start(task, simulator, key)

    def step(carry: tuple, k: Array) -> tuple[tuple, None]:
        state, touched, sums = carry
        state = _damped(state, decay, limit)
        action = controller(TaskState(simulator.sensed(state), goal, k))
        state = simulator.step(state, action)
        after = TaskState(simulator.flight(state), goal, k + 1)
        sums, touched, _ = sums.with_step(task, after, touched)
        return (state, touched, sums), None

    zero = jnp.zeros(())
    begin = (state, jnp.zeros(task.n_drones, bool), Episode(zero, zero, zero, zero))
    (_, _, sums), _ = jax.lax.scan(jax.checkpoint(step), begin, jnp.arange(task.horizon))
    return sums


def record(
    task: AbstractTask,
    simulator: AbstractSimulator,
    controller: Controller,
    key: PRNGKeyArray,
) -> Record:
    """One episode with everything that happened in it."""
    state, goal = start(task, simulator, key)

    def step(state: Any, k: Array) -> tuple[Any, Record]:
        action = controller(TaskState(simulator.sensed(state), goal, k))
        state = simulator.step(state, action)
        flight = simulator.flight(state)
        after = TaskState(flight, goal, k + 1)
        return state, Record(
            flight=flight,
            action=action,
            reward=task.rewards(after)[0],
            error=task.error(after),
            contact=in_contact(flight.pos, flight.t),
        )

    return jax.lax.scan(step, state, jnp.arange(task.horizon))[1]


def start(task: AbstractTask, simulator: AbstractSimulator, key: PRNGKeyArray) -> tuple[Any, Any]:
    """The state and the goal at the start of an episode."""
    task_key, simulator_key = jax.random.split(key)
    pos, goal = task.reset(task_key)
    return simulator.reset(pos, simulator_key), goal
