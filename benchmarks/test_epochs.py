"""How long one training epoch takes, compilation excluded. `make bench` runs it."""

import equinox as eqx
import jax
import pytest

from methods.bptt import BPTT, _epoch, _optimizer
from methods.policy import PolicyController, make_policy
from simulators import registry
from tasks.circle import Circle
from tasks.rollout import record

CELLS = [pytest.param("point_mass", 16, n, id=f"low fidelity, N = {n}") for n in (3, 12, 18)] + [
    pytest.param("crazyflow", 1, n, id=f"high fidelity, N = {n}") for n in (3, 12, 18)
]


@pytest.mark.parametrize(("simulator_name", "n_worlds", "n_drones"), CELLS)
def test_one_epoch_of_circle(benchmark, simulator_name, n_worlds, n_drones):
    task = Circle(n_drones=n_drones)
    simulator = registry.load("simulator", simulator_name)()
    policy = make_policy(task, simulator.spec, simulator.action_space, jax.random.key(0))
    settings = BPTT(n_worlds=n_worlds)
    state = _optimizer(settings).init(eqx.filter(policy, eqx.is_inexact_array))

    def epoch():
        return jax.block_until_ready(
            _epoch(settings, task, simulator, policy, state, jax.random.key(1))[2]
        )

    epoch()
    row = benchmark.pedantic(epoch, rounds=5)
    assert not row["skipped"]


@pytest.mark.parametrize("simulator_name", ["point_mass", "crazyflow"])
def test_deployment_of_32_episodes(benchmark, simulator_name):
    task = Circle(n_drones=12)
    simulator = registry.load("simulator", simulator_name)()
    policy = make_policy(task, simulator.spec, simulator.action_space, jax.random.key(0))
    controller = PolicyController(task, policy)
    keys = jax.random.split(jax.random.key(1), 32)
    fly = eqx.filter_jit(
        lambda keys: jax.vmap(lambda key: record(task, simulator, controller, key))(keys).reward
    )
    jax.block_until_ready(fly(keys))
    rewards = benchmark.pedantic(lambda: jax.block_until_ready(fly(keys)), rounds=3)
    assert rewards.shape == (32, task.horizon, 12)
