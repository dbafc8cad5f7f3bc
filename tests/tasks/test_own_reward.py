"""A task whose reward knows no targets: it is checked, differentiated and trained like any."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import KEY, SIMULATORS
from jaxtyping import Array, Float, PRNGKeyArray

from bench.conformance import tasks as conformance
from methods.training.bptt import BPTT
from methods.training.context import Context
from methods.training.policy import make_policy
from simulators.vehicle import VEHICLES, ActionSpace
from tasks import contact
from tasks.contract import AbstractTask, TaskState, spawn_grid
from tasks.rollout import episode


class Spacing(AbstractTask):
    """Neighbours keep a distance of their own, anywhere above the ground, and save thrust."""

    n_drones: int = eqx.field(static=True, default=3)
    """Team size."""
    horizon: int = eqx.field(static=True, default=30)
    """Episode length [control steps]."""

    version: ClassVar[str] = "1"
    station_keeping: ClassVar[bool] = False

    def reset(self, key: PRNGKeyArray) -> tuple[Float[Array, "drones 3"], Any]:
        pos_key, goal_key = jax.random.split(key)
        return spawn_grid(self.n_drones, pos_key), jax.random.uniform(goal_key, minval=1.5)

    def observe(self, state: TaskState) -> Float[Array, "drones 10"]:
        pos, vel = state.flight.pos, state.flight.vel
        height = pos[:, 2:] - state.goal
        return jnp.concatenate([pos - pos.mean(0), vel, vel - vel.mean(0), height], axis=1)

    @property
    def obs_size(self) -> int:
        return 10

    def rewards(self, state: TaskState) -> tuple[Float[Array, " drones"], Float[Array, " drones"]]:
        effort = 0.1 * (state.flight.thrust - 0.4) ** 2
        reward = -jnp.log1p(self.error(state) ** 2) - effort
        pos = state.flight.pos
        return reward - contact.penalty(pos), reward - contact.soft_penalty(pos)

    def error(self, state: TaskState) -> Float[Array, " drones"]:
        pos = state.flight.pos
        apart = jnp.sqrt(jnp.sum((pos[:, None] - pos[None]) ** 2, axis=-1) + 1e-6)
        spread = jnp.sum((apart - 1.0) ** 2 * (1.0 - jnp.eye(self.n_drones)), axis=1)
        return jnp.sqrt(spread + (pos[:, 2] - state.goal) ** 2 + 1e-6)


@pytest.fixture(scope="module")
def policy():
    return make_policy(Spacing(), VEHICLES["cf21B_500"], ActionSpace(), KEY)


def test_it_passes_the_checks_of_a_task():
    checks = conformance.declarations(Spacing) + conformance.behaviour(Spacing)
    for check in checks:
        check.run()
    assert not any("target" in check.sentence for check in checks)


# Gradients through crazyflow are in `test_task_gradients.py`.
@pytest.mark.parametrize(
    "name", ["point_mass", pytest.param("crazyflow", marks=pytest.mark.exhaustive)]
)
def test_its_gradient_equals_finite_differences(name):
    with jax.enable_x64(True):
        simulator = SIMULATORS[name]()
        hover = simulator.action_space.hover(simulator.spec.mass)

        @jax.jit
        def smooth(action):
            controller = lambda _: jnp.broadcast_to(action, (3, 3))  # noqa: E731
            return episode(Spacing(horizon=8), simulator, controller, KEY).smooth_reward

        start = jnp.asarray([0.05, -0.05, hover + 0.2])
        slope = np.asarray(jax.grad(smooth)(start))
        steps = 1e-6 * np.eye(3)
        rough = [float(smooth(start + h) - smooth(start - h)) / 2e-6 for h in steps]
        np.testing.assert_allclose(slope, rough, rtol=1e-4, atol=1e-9)
        assert np.abs(slope).max() > 0.0


def test_a_training_improves_it(policy):
    trainer = BPTT(epochs=30, n_worlds=8, lr=3e-3)
    training = trainer.train(Spacing(), SIMULATORS["point_mass"](), policy, KEY, Context(), "own")
    rewards = training.curves["reward"]
    assert np.mean(rewards[-5:]) > np.mean(rewards[:5])
