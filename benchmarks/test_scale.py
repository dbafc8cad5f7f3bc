"""What a step of one drone costs in teams of 3 to 1,000, and what of it is looking for others.

`make bench` prints a line a team size; `reports/performance.md` has the table and the figure.
"""

import jax
import jax.numpy as jnp
import pytest

from benchmarks.programs.training import epoch_of
from methods.training.bptt import BPTT
from methods.training.evaluate import fly
from methods.training.policy import PolicyController, make_policy
from simulators import registry
from tasks.contact import MANY
from tasks.spread import Spread

TEAMS = (3, 18, MANY - 1, MANY, 100, 300, 1000)
CASES = [(name, n) for name in ("point_mass", "crazyflow") for n in TEAMS] + [("rotorpy", 18)]
"""Simulators and teams."""
STEPS = 100
"""Control steps of an episode."""


def given(name, n_drones):
    task, simulator = Spread(n_drones=n_drones, horizon=STEPS), registry.load("simulator", name)()
    return task, simulator, make_policy(task, simulator.spec, simulator.action_space, KEY)


KEY = jax.random.key(0)


@pytest.mark.parametrize(("name", "n_drones"), CASES)
def test_a_training_epoch_per_drone_and_step(benchmark, name, n_drones):
    task, simulator, policy = given(name, n_drones)
    trainer = BPTT() if name == "point_mass" else BPTT(n_worlds=1)
    benchmark.pedantic(epoch_of(trainer, task, simulator, policy, KEY), rounds=5)
    _per_step(benchmark, n_drones * trainer.worlds(n_drones))


@pytest.mark.parametrize(("name", "n_drones"), CASES)
def test_deployment_per_drone_and_step(benchmark, name, n_drones):
    task, simulator, policy = given(name, n_drones)
    keys = jax.random.split(KEY, max(1, 64 // n_drones))
    controller = PolicyController(task, policy)
    flown = benchmark.pedantic(
        lambda: jax.block_until_ready(fly(task, simulator, controller, keys)),
        rounds=5,
        warmup_rounds=1,
    )
    assert jnp.isfinite(flown.reward).all()
    _per_step(benchmark, n_drones * len(keys))


def _per_step(benchmark, drones):
    benchmark.extra_info["us_per_drone_step"] = 1e6 * benchmark.stats.stats.min / (drones * STEPS)
