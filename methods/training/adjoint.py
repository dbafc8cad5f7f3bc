r"""The gradient of an epoch by its adjoint, written out, where `jax.grad` would repeat products.

With the state s, the observation o(s), the policy's layers y_i and the step f, the backward sweep
carries lambda, the derivative of the loss by the state, from the last step to the first:

    (d/ds, d/da) = f's adjoint of (lambda, -1 for the smooth reward)
    delta_i      = (d/dy_i) (1 - y_i^2),  d/dy_(i-1) = delta_i W_i,  dW_i += delta_i' y_(i-1)
    lambda       = clip(share (d/ds + o's adjoint of d/do))

and is what `jax.grad` of `tasks.rollout.episode` gives, up to rounding. Products of all worlds are
one product. What the layers gave on the way forward is either kept in buffers that one epoch hands
to the next (memory that is asked for anew costs as much as computing it), or computed again where
`kept` is None. What a simulator's frozen effects did is not computed again, if it is `Replayable`.

A policy of another architecture has no layers written out: `jax.grad` of the episode it is.
"""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from methods.training.meter import billed
from methods.training.policy import AbstractPolicy, Policy, PolicyController, is_written_out
from simulators.contract import AbstractSimulator, Replayable
from tasks.contract import AbstractTask, TaskState
from tasks.rollout import Episode, episode, passed_back, start

MOST_STORED_BYTES = 128e6
"""Bytes of activations above which they are computed again; a choice."""


def buffers(
    policy: Policy, task: AbstractTask, n_worlds: int, n_trainings: int = 0
) -> list[Array] | None:
    """Buffers for the layers' outputs in an epoch; None if they would exceed `MOST_STORED_BYTES`.

    With `n_trainings` there is an axis of as many before the others.
    """
    rows, several = n_worlds * task.n_drones, (n_trainings,) if n_trainings else ()
    shapes = [(*several, task.horizon, rows, size) for size in policy.sizes]
    size = sum(4.0 * math.prod(shape) for shape in shapes)
    if size > MOST_STORED_BYTES:
        return None
    return [jnp.zeros(shape) for shape in shapes]


def gradient(
    task: AbstractTask,
    simulator: AbstractSimulator,
    policy: AbstractPolicy,
    keys: Key[Array, " worlds"],
    decay: float,
    kept: Sequence[Array] | None,
    limit: float | None = None,
) -> tuple[Episode, AbstractPolicy, Sequence[Array] | None]:
    """Episodes by world, the gradient of minus the sum of their smooth returns, and `kept` filled.

    `decay` and `limit` say what of the gradient a step passes back (`tasks/rollout.py`).
    """
    if not is_written_out(policy):
        return *by_autodiff(task, simulator, policy, keys, decay, limit), kept
    counted_before = billed(simulator, 0)  # a step that is repeated is no new flight
    first, goal = jax.vmap(lambda key: start(task, simulator, key))(keys)
    n_worlds, n_drones, steps = len(keys), task.n_drones, jnp.arange(task.horizon)

    def observe(state: Any, k: Array) -> Float[Array, "rows obs"]:
        see = lambda s, g: task.observe(TaskState(simulator.sensed(s), g, k))  # noqa: E731
        return jax.vmap(see)(state, goal).reshape(n_worlds * n_drones, -1)

    def act(layers: Sequence[Array]) -> Float[Array, "worlds drones 3"]:
        return layers[-1].reshape(n_worlds, n_drones, 3)

    def forward(carry: tuple, k: Array) -> tuple[tuple, tuple]:
        state, touched, sums, kept = carry
        layers = policy.layers(observe(state, k))
        if kept is not None:
            kept = [room.at[k].set(values) for room, values in zip(kept, layers, strict=True)]
        after = jax.vmap(simulator.step)(state, act(layers))

        def score(sums: Episode, state: Any, goal: Any, before: Array) -> tuple[Episode, Array]:
            seen = TaskState(simulator.flight(state), goal, k + 1)
            return sums.with_step(task, seen, before)[:2]

        sums, touched = jax.vmap(score)(sums, after, goal, touched)
        return (after, touched, sums, kept), (state, after)

    zeros = jnp.zeros(n_worlds)
    touched = jnp.zeros((n_worlds, n_drones), bool)
    begin = (first, touched, Episode(zeros, zeros, zeros, zeros), kept)
    (_, _, sums, kept), (states, afters) = jax.lax.scan(forward, begin, steps)

    def backward(carry: tuple, row: tuple) -> tuple[tuple, None]:
        costate, slopes = carry
        k, state, after = row
        live, fixed = eqx.partition(state, eqx.is_inexact_array)
        layers = policy.layers(observe(state, k)) if kept is None else [room[k] for room in kept]

        def advance(live: Any, action: Array) -> tuple[Any, Array]:
            def one(state: Any, after: Any, goal: Any, action: Array) -> tuple[Any, Array]:
                new = _repeating(counted_before, after).step(state, action)
                seen = TaskState(simulator.flight(new), goal, k + 1)
                return eqx.filter(new, eqx.is_inexact_array), jnp.sum(task.rewards(seen)[1])

            new, smooth = jax.vmap(one)(eqx.combine(live, fixed), after, goal, action)
            return new, jnp.sum(smooth)

        _, pull_step = jax.vjp(advance, live, act(layers))
        by_state, by_action = pull_step((costate, -jnp.ones(())))
        by_obs, new = policy.pull_back(layers, by_action.reshape(-1, 3))
        _, pull_obs = jax.vjp(lambda live: observe(eqx.combine(live, fixed), k), live)
        costate = jax.tree.map(
            lambda a, b: passed_back(a + b, decay, limit), by_state, pull_obs(by_obs)[0]
        )
        return (costate, jax.tree.map(jnp.add, slopes, new)), None

    nothing = jax.tree.map(jnp.zeros_like, eqx.filter(first, eqx.is_inexact_array))
    flat = jax.tree.map(jnp.zeros_like, eqx.filter(policy, eqx.is_inexact_array))
    (_, slopes), _ = jax.lax.scan(backward, (nothing, flat), (steps, states, afters), reverse=True)
    return sums, slopes, kept


def _repeating(simulator: AbstractSimulator, after: Any) -> AbstractSimulator:
    """The simulator for a step that is known to end in `after`."""
    return simulator.repeating(after) if isinstance(simulator, Replayable) else simulator


def by_autodiff(
    task: AbstractTask,
    simulator: AbstractSimulator,
    policy: AbstractPolicy,
    keys: Key[Array, " worlds"],
    decay: float,
    limit: float | None = None,
) -> tuple[Episode, AbstractPolicy]:
    """Episodes and gradient as `gradient` returns them, by `jax.grad` for any policy; slower."""
    live, fixed = eqx.partition(policy, eqx.is_inexact_array)

    def loss(live: Any) -> tuple[Array, Episode]:
        controller = PolicyController(task, eqx.combine(live, fixed))
        fly = lambda key: episode(task, simulator, controller, key, decay, limit)  # noqa: E731
        episodes = jax.vmap(fly)(keys)
        return -jnp.sum(episodes.smooth_reward), episodes

    slopes, episodes = jax.grad(loss, has_aux=True)(live)
    return episodes, slopes
