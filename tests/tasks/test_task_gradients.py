"""Gradients of an episode's return against central differences, in double precision."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, KEY, SIMULATORS, TASKS

from simulators.vehicle import GRAVITY, ActionSpace
from tasks.contract import AbstractTargetTask, TaskState
from tasks.rollout import episode

# Small gains on the position and velocity error of each axis, and a bias of the three actions:
# tilts stay below 0.3 rad and the thrust inside the vehicle's range, beyond which crazyflow clips
# it and the derivative jumps to zero.
PARAMETERS = [0.15, 0.12, 0.2, 0.08, 0.1, 0.05, 0.05, -0.04, 0.02]
HORIZONS = (3, 10, 40)
CASES = [(task, horizon) for task in TASKS for horizon in HORIZONS]


class OneOfAll(AbstractTargetTask):
    """The task and the horizon that `choice` and `last` pick, so that one program tests all.

    Teams start 3 m above the ground: on the ground crazyflow zeroes the velocity, which makes the
    return a step function of the time of take-off, and differences across a step no derivatives.
    """

    tasks: tuple[AbstractTargetTask, ...]
    choice: jax.Array
    """One-hot, an entry a task."""
    last: jax.Array
    """The step whose reward is the last to count."""
    n_drones: int = eqx.field(static=True, default=3)
    horizon: int = eqx.field(static=True, default=max(HORIZONS))
    n_neighbors: int = eqx.field(static=True, default=3)
    observe_attitude: bool = eqx.field(static=True, default=False)

    version: ClassVar[str] = "1"
    station_keeping: ClassVar[bool] = False

    def pick(self, values):
        """The chosen one of a list of equal pytrees; a slack of nothing is a single zero."""
        stack = lambda x: jnp.stack(jnp.broadcast_arrays(*x))  # noqa: E731
        return jax.tree.map(lambda *x: jnp.tensordot(self.choice, stack(x), 1), *values)

    def each(self, state):
        """The states of all tasks."""
        return [TaskState(state.flight, goal, state.step) for goal in state.goal]

    def reset(self, key):
        pos, goals = zip(*(task.reset(key) for task in self.tasks), strict=True)
        return self.pick(pos) + jnp.asarray([0.0, 0.0, 3.0]), goals

    def target(self, state):
        states = self.each(state)
        return self.pick([t.target(s) for t, s in zip(self.tasks, states, strict=True)])

    def task_reward(self, distance, vel_error):
        raise AssertionError("`rewards` does not call it")

    def rewards(self, state):
        states = self.each(state)
        chosen = self.pick([t.rewards(s) for t, s in zip(self.tasks, states, strict=True)])
        return jax.tree.map(lambda r: jnp.where(state.step <= self.last, r, 0.0), chosen)


class AffineController(eqx.Module):
    """A policy with nine parameters: a PD law on the first six observations, and a bias."""

    task: eqx.Module
    parameters: jax.Array

    def __call__(self, state: TaskState):
        obs = self.task.observe(state)
        kp, kd, bias = jnp.split(self.parameters, 3)
        pull = kp * obs[:, :3] + kd * obs[:, 3:6] + bias
        hover = ActionSpace().hover(HOVER / GRAVITY)
        return jnp.tanh(jnp.stack([-pull[:, 1], pull[:, 0], hover + pull[:, 2]], axis=-1))


def returns(simulator, task, parameters):
    """What training differentiates."""
    return episode(task, simulator, AffineController(task, parameters), KEY).smooth_reward


@pytest.fixture(scope="module", params=SIMULATORS)
def derivatives(request):
    """Gradient and central differences of every case, for one simulator."""
    with jax.enable_x64(True):
        simulator = SIMULATORS[request.param]()
        tasks = tuple(task(n_drones=3) for task in TASKS.values())
        center = jnp.asarray(PARAMETERS)
        unit, h = jnp.eye(len(center)), 1e-5
        points = jnp.concatenate([center[None], center + h * unit, center - h * unit])

        def one(choice, last, parameters):
            return returns(simulator, OneOfAll(tasks, choice, last), parameters)

        both = jax.vmap(jax.value_and_grad(one, 2), (None, None, 0))
        choices = jnp.repeat(jnp.eye(len(tasks)), len(HORIZONS), axis=0)
        lasts = jnp.tile(jnp.asarray(HORIZONS), len(tasks))
        values, slopes = jax.jit(jax.vmap(both, (0, 0, None)))(choices, lasts, points)
        plus, minus = jnp.split(values[:, 1:], 2, axis=1)
        assert slopes.dtype == jnp.float64
        exact, numeric = np.asarray(slopes[:, 0]), np.asarray((plus - minus) / (2 * h))
        return dict(zip(CASES, zip(exact, numeric, strict=True), strict=True))


@pytest.mark.parametrize(("task", "horizon"), CASES)
def test_the_gradient_of_the_return_equals_finite_differences(derivatives, task, horizon):
    """Central differences err by about h^2 = 1e-10, and by rounding over h, of the return."""
    exact, numeric = derivatives[task, horizon]
    scale = np.abs(exact).max()
    np.testing.assert_allclose(exact, numeric, atol=1e-6 * scale)
    assert (np.abs(exact) > 1e-4 * scale).sum() >= 6
