"""Gradients of an episode's return against central differences, in double precision."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, KEY, SIMULATORS, TASKS, x64

from simulators.vehicle import ActionSpace
from tasks.contract import TaskState
from tasks.rollout import episode

# Small gains on the position and velocity error of each axis, and a bias of the three actions:
# tilts stay below 0.3 rad and the thrust within 40 to 160 % of the weight.
PARAMETERS = [0.15, 0.12, 0.2, 0.08, 0.1, 0.05, 0.05, -0.04, 0.02]
CASES = [
    *(("point_mass", task, horizon) for task in TASKS for horizon in (3, 10, 40)),
    *(("crazyflow", "circle", horizon) for horizon in (3, 40)),
    *(("crazyflow", task, 10) for task in TASKS),
]


class AffineController(eqx.Module):
    """A policy with nine parameters: a PD law on the first six observations, and a bias."""

    task: eqx.Module
    parameters: jax.Array

    def __call__(self, state: TaskState):
        obs = self.task.observe(state)
        kp, kd, bias = jnp.split(self.parameters, 3)
        pull = kp * obs[:, :3] + kd * obs[:, 3:6] + bias
        hover = ActionSpace().hover(HOVER / 9.81)
        return jnp.tanh(jnp.stack([-pull[:, 1], pull[:, 0], hover + pull[:, 2]], axis=-1))


def raised(task_class):
    """The task, spawned 3 m above the ground.

    On the ground crazyflow zeroes the velocity, which makes the return a step function of the
    time of take-off: differences across that step are no derivatives.
    """

    class Raised(task_class):
        def reset(self, key):
            pos, goal = super().reset(key)
            return pos + jnp.asarray([0.0, 0.0, 3.0]), goal

    return Raised


@pytest.mark.parametrize(("simulator", "task", "horizon"), CASES)
def test_the_gradient_of_the_return_equals_finite_differences(simulator, task, horizon):
    with x64():
        made = raised(TASKS[task])(n_drones=3, horizon=horizon)
        flown = SIMULATORS[simulator]()

        def smooth_return(parameters):
            return episode(made, flown, AffineController(made, parameters), KEY).smooth_reward

        center = jnp.asarray(PARAMETERS)
        unit, h = jnp.eye(len(center)), 1e-5
        points = jnp.concatenate([center[None], center + h * unit, center - h * unit])
        values, slopes = jax.jit(jax.vmap(jax.value_and_grad(smooth_return)))(points)
        plus, minus = jnp.split(values[1:], 2)
        assert slopes.dtype == jnp.float64
        # Central differences err by about h^2 = 1e-10 and rounding / h = 1e-10 of the return.
        scale = float(jnp.abs(slopes[0]).max())
        np.testing.assert_allclose(slopes[0], (plus - minus) / (2 * h), atol=1e-6 * scale)
        assert (jnp.abs(slopes[0]) > 1e-6 * scale).sum() >= 6


@pytest.mark.parametrize("decay", [1.0, 0.9])
def test_gradient_decay_changes_the_gradient_and_not_the_return(decay):
    task, simulator = raised(TASKS["circle"])(horizon=20), SIMULATORS["point_mass"]()

    def smooth_return(parameters, decay):
        controller = AffineController(task, parameters)
        return episode(task, simulator, controller, KEY, decay).smooth_reward

    both = [
        jax.jit(jax.value_and_grad(lambda p, d=d: smooth_return(p, d)))(jnp.asarray(PARAMETERS))
        for d in (1.0, decay)
    ]
    assert float(both[0][0]) == pytest.approx(float(both[1][0]), rel=1e-5)
    ratio = float(jnp.linalg.norm(both[1][1]) / jnp.linalg.norm(both[0][1]))
    assert ratio == pytest.approx(1.0) if decay == 1.0 else ratio < 0.9
