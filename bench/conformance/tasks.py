"""What a task must keep to: starts, targets, rewards and observations that hold for any team."""

import functools
import itertools
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from bench.conformance.suite import Check, close, declaration_checks, demand, equal, finite
from simulators.algebra.rotation import rpy_to_quat
from simulators.flight import Flight
from simulators.point_mass import PointMass
from simulators.vehicle import COLLISION_RADIUS
from tasks.contract import AbstractTargetTask, AbstractTask, TaskState
from tasks.rollout import episode

SIZES = (2, 3, 5, 18)
"""Team sizes that every task must serve."""
KEY = jax.random.key(0)
SHORT = 20
"""Steps of the episodes flown here."""


def declarations(cls: type[Any]) -> list[Check]:
    """Checks of what the class says of itself; the others need them."""
    return [
        *declaration_checks(cls, AbstractTask, n_drones=3),
        Check("it serves teams of 2, 3, 5 and 18 drones", lambda: _sizes(cls)),
        Check("it says whether the team hovers at the end", lambda: _station_keeping(cls)),
    ]


def behaviour(cls: type[Any]) -> list[Check]:
    """Checks of starts, targets, rewards, observations and whole episodes."""
    sentences = {
        "a wrong setting is refused with its name": _refuses,
        "teams start on the floor, out of contact": _starts,
        "the same key gives the same episode, another key another": _keys,
        "every quantity has one row per drone": _shapes,
        "every quantity is finite": _finite,
        "renumbering the drones renumbers observations, rewards and errors": _renumbering,
        "compiled and batched equal single and eager": _batched,
        "an episode is finite and can be differentiated": _episode,
    }
    if issubclass(cls, AbstractTargetTask):
        sentences |= {
            "its targets fit the team": _target_shapes,
            "moving by the offset satisfies the task": _offset,
            "no place is better than the target": _best,
            "offsets do not jump when a drone moves a little": _jumps,
        }
    return [Check(text, functools.partial(check, cls)) for text, check in sentences.items()]


@eqx.filter_jit
def random_state(task: AbstractTask, key: PRNGKeyArray = KEY) -> TaskState:
    """A team in flight, nobody near a tie of distances."""
    keys = jax.random.split(key, 4)
    n = task.n_drones
    turn, out, up = jax.random.uniform(keys[2], (3, n), maxval=2.0)
    pos = jnp.stack(
        [(2 + out) * jnp.cos(jnp.pi * turn), (2 + out) * jnp.sin(jnp.pi * turn), up], axis=-1
    )
    flight = Flight(
        t=jnp.asarray(2.0),
        pos=pos,
        vel=jax.random.normal(keys[3], (n, 3)),
        quat=rpy_to_quat(jax.random.uniform(keys[1], (n, 3), minval=-0.3, maxval=0.3)),
        ang_vel=jnp.zeros((n, 3)),
        thrust=jnp.full(n, 0.4),
        torque=jnp.zeros((n, 3)),
    )
    return TaskState(flight, task.reset(keys[0])[1], jnp.asarray(100))


@eqx.filter_jit
def everything(task: AbstractTask, state: TaskState) -> tuple[Array, tuple[Array, Array], Array]:
    """Observations, both rewards and errors."""
    return task.observe(state), task.rewards(state), task.error(state)


def _moved(state: TaskState, pos: Array) -> TaskState:
    return eqx.tree_at(lambda s: s.flight.pos, state, pos)


def _sizes(cls: type[Any]) -> None:
    for n in SIZES:
        task = cls(n_drones=n)
        demand(task.n_drones == n, f"made for {n} drones it has `n_drones` = {task.n_drones}")
        demand(
            isinstance(task.horizon, int) and task.horizon >= 1,
            f"`horizon` must be a number of control steps, at least 1, got {task.horizon!r}",
        )


def _station_keeping(cls: type[Any]) -> None:
    demand(
        isinstance(cls.station_keeping, bool),
        f"`station_keeping` must be True or False, got {cls.station_keeping!r:.40}",
    )


def _refuses(cls: type[Any]) -> None:
    for name, value in (("n_drones", 1), ("horizon", 0)):
        try:
            cls(**{name: value})
        except ValueError as error:
            demand(
                name in str(error), f"refusing {name}={value} it does not name `{name}`: {error}"
            )
        else:
            demand(False, f"{name}={value} is accepted; do not override `__check_init__`")


def _starts(cls: type[Any]) -> None:
    for n in SIZES:
        task = cls(n_drones=n)
        pos = np.asarray(
            jax.jit(jax.vmap(lambda k, t=task: t.reset(k)[0]))(jax.random.split(KEY, 100))
        )
        demand(
            pos.shape == (100, n, 3),
            f"`reset` must return positions of shape ({n}, 3), got {pos.shape[1:]}",
        )
        demand(np.isfinite(pos).all(), f"`reset` returns positions that are not finite for N = {n}")
        demand(
            np.abs(pos[..., 2]).max() <= 1e-6,
            f"teams must start on the floor (z = 0), got z = {pos[..., 2].max():g} m; rotors stand "
            "still at the reset, so a drone in the air would fall",
        )
        apart = np.linalg.norm(pos[:, :, None] - pos[:, None], axis=-1) + 10.0 * np.eye(n)
        demand(
            apart.min() > 2.0 * COLLISION_RADIUS,
            f"with N = {n} two drones start {apart.min():.2f} m apart, which is a crash; at least "
            f"{2.0 * COLLISION_RADIUS:.2f} m are needed",
        )


def _keys(cls: type[Any]) -> None:
    task = cls(n_drones=3)
    first, again, other = (task.reset(k) for k in (KEY, KEY, jax.random.key(1)))
    demand(equal(first, again), "`reset` returns different episodes for the same key")
    demand(
        not equal(first, other),
        "`reset` returns the same episode for another key; draw something from `key`, because "
        "episodes of an evaluation are told apart by it",
    )


def _shapes(cls: type[Any]) -> None:
    targeted = issubclass(cls, AbstractTargetTask)
    settings = [{"observe_attitude": on} for on in (False, True)] if targeted else [{}]
    for n, setting in itertools.product(SIZES, settings):
        task: AbstractTask = functools.partial(cls, n_drones=n, **setting)()
        state = jax.eval_shape(lambda t=task: random_state(t))
        obs, rewards, error = jax.eval_shape(lambda s, t=task: everything(t, s), state)
        found = {
            "`observe`": (obs.shape, (n, task.obs_size)),
            "`rewards`, as reported,": (rewards[0].shape, (n,)),
            "`rewards`, as trained on,": (rewards[1].shape, (n,)),
            "`error`": (error.shape, (n,)),
        }
        _demand_shapes(found, n)


def _target_shapes(cls: type[Any]) -> None:
    for n in SIZES:
        task = cls(n_drones=n)
        target = jax.eval_shape(task.target, jax.eval_shape(lambda t=task: random_state(t)))
        row = jax.ShapeDtypeStruct((n,), float)
        paid = jax.eval_shape(task.task_reward, row, row)
        found = {
            "`target().offset`": (target.offset.shape, (n, 3)),
            "`target().vel`": (target.vel.shape, (n, 3)),
            "`target().acc`": (target.acc.shape, (n, 3)),
            "`task_reward`": (paid.shape, (n,)),
        }
        _demand_shapes(found, n)
        for name in ("slack", "vel_slack"):
            got = getattr(target, name).shape
            demand(
                got in ((), (n,)), f"`target().{name}` must be one number or {n}, got shape {got}"
            )


def _demand_shapes(found: Mapping[str, tuple[tuple, tuple]], n: int) -> None:
    for what, (got, wanted) in found.items():
        demand(got == wanted, f"{what} must have shape {wanted} for N = {n}, got {got}")


def _finite(cls: type[Any]) -> None:
    task = cls(n_drones=5)
    state = random_state(task)
    together = _moved(state, jnp.zeros_like(state.flight.pos))
    for words, where in (("in flight", state), ("with all drones in one place", together)):
        demand(
            finite(everything(task, where)),
            f"observations, rewards or errors are not finite {words}",
        )


def _offset(cls: type[Any]) -> None:
    task = cls(n_drones=3)
    state = random_state(task)
    there = _moved(state, state.flight.pos + task.target(state).offset)
    left = float(task.error(there).max())
    demand(
        left < 5e-3,
        f"a drone that has moved by its offset is still {left:.3f} m from its target; `offset` is "
        "the vector from the drone to the nearest right place",
    )


def _best(cls: type[Any]) -> None:
    task = cls(n_drones=3)
    best = task.task_reward(jnp.zeros(3), jnp.zeros(3))
    for distance, vel_error in ((0.5, 0.0), (5.0, 0.0), (0.0, 0.5), (0.5, 0.5)):
        reward = task.task_reward(jnp.full(3, distance), jnp.full(3, vel_error))
        demand(
            (reward <= best + 1e-6).all(),
            f"`task_reward` is {float(reward[0]):g} at {distance} m and {vel_error} m/s of error, "
            f"more than {float(best[0]):g} at the target",
        )
    away = task.task_reward(jnp.full(3, 5.0), jnp.zeros(3))
    demand((away < best).all(), "`task_reward` is as good 5 m away as at the target")


def _jumps(cls: type[Any]) -> None:
    task = cls(n_drones=3)
    offset = jax.jit(lambda state: task.target(state).offset)
    for seed in range(20):
        state = random_state(task, jax.random.key(seed))
        step = 1e-3 * jax.random.normal(jax.random.key(seed + 100), state.flight.pos.shape)
        change = offset(_moved(state, state.flight.pos + step)) - offset(state)
        demand(
            float(jnp.abs(change).max()) < 0.1,
            f"moving drones by a millimetre moves an offset by {float(jnp.abs(change).max()):.2f}"
            " m; back-propagation turns such jumps into useless gradients (see `direction` in "
            "tasks/contract.py)",
        )


def _renumbering(cls: type[Any]) -> None:
    task = cls(n_drones=5)
    order = jnp.asarray([3, 0, 4, 2, 1])

    def renumbered(tree: object) -> object:
        rows = lambda x: getattr(x, "ndim", 0) > 0 and len(x) == 5  # noqa: E731
        return jax.tree.map(lambda x: x[order] if rows(x) else x, tree)

    apart = random_state(task)
    for words, state in (
        ("apart", apart),
        ("so close together that they touch", _moved(apart, 0.1 * apart.flight.pos)),
    ):
        turned = TaskState(
            jax.tree.map(lambda x: x[order] if x.ndim else x, state.flight),
            renumbered(state.goal),
            state.step,
        )
        expected = jax.tree.map(lambda x: x[order], everything(task, state))
        demand(
            close(everything(task, turned), expected, 1e-4, 1e-5),
            f"observations, rewards or errors of drones {words} depend on the numbers of the "
            "drones; what belongs to a drone must be a row of the goal",
        )


def _batched(cls: type[Any]) -> None:
    task = cls(n_drones=5)
    states = [random_state(task, jax.random.key(seed)) for seed in range(2)]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *states)
    batched = eqx.filter_jit(eqx.filter_vmap(everything, in_axes=(None, 0)))(task, stacked)
    for i, state in enumerate(states):
        eager = task.observe(state), task.rewards(state), task.error(state)
        compiled = everything(task, state)
        demand(close(compiled, eager, 1e-4, 1e-5), "compiled it gives other numbers than eager")
        alone = jax.tree.map(lambda x, i=i: x[i], batched)
        demand(
            close(alone, eager, 1e-4, 1e-5),
            "in a batch of worlds it gives other numbers than alone",
        )


def _episode(cls: type[Any]) -> None:
    task, simulator = cls(n_drones=3, horizon=SHORT), PointMass()
    hover = simulator.action_space.hover(simulator.spec.mass)

    def smooth_return(action: Array) -> tuple[Array, Array]:
        flown = episode(task, simulator, lambda _: jnp.broadcast_to(action, (3, 3)), KEY)
        return flown.smooth_reward, flown.reward

    start = jnp.asarray([0.05, -0.05, hover + 0.1])
    (smooth, reward), slope = jax.jit(jax.value_and_grad(smooth_return, has_aux=True))(start)
    demand(finite((smooth, reward)), f"an episode of {SHORT} steps has the return {float(reward)}")
    demand(finite(slope), f"the gradient of an episode's return is {np.asarray(slope)}")
    demand(
        bool(jnp.any(slope != 0.0)),
        "the return does not change with the actions, so nothing can be learned from its gradient",
    )
