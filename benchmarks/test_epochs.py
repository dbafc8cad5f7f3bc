"""How long one training epoch takes, and how near it is to its limit. `make bench` runs it.

The limit is the time that the matrix products of the policy and of a frozen residual need at the
rate of the policy's (`methods/running/profile.py`), measured in the same process; beside it stand
the time over that of the forward part and the memory.
"""

import contextlib
import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import pytest

from bench.execution.environment import accelerated
from benchmarks.programs.training import epoch_of
from methods.contract import Setup
from methods.hybrid import Hybrid
from methods.running.profile import profile, trained_in
from methods.training.bptt import BPTT
from methods.training.context import Context
from methods.training.evaluate import fly
from methods.training.policy import PolicyController, make_policy
from methods.training.together import Team
from simulators import registry
from tasks.circle import Circle
from tasks.rollout import start

TEAMS = (3, 12, 18)
EPOCHS = 8
"""Of a training with several seeds."""
SEEDS = (1, 2, 4, 16, 64) if accelerated() else (1, 2, 4)
"""Trainings in one program; a core gains nothing from more."""
CELLS = [(name, n) for name in ("low fidelity", "hybrid", "high fidelity") for n in TEAMS]


def trained(name, task):
    """The simulator and the trainer of a configuration."""
    nominal, reality = (registry.load("simulator", s)() for s in ("point_mass", "crazyflow"))
    if name == "hybrid":
        return trained_in(Hybrid(flights=8), Setup(task, nominal, reality)), BPTT()
    return (reality, BPTT(n_worlds=1)) if name == "high fidelity" else (nominal, BPTT())


@pytest.mark.parametrize(("name", "n_drones"), CELLS)
def test_one_epoch_of_circle(benchmark, capsys, name, n_drones):
    task = Circle(n_drones=n_drones)
    simulator, trainer = trained(name, task)
    policy = make_policy(task, simulator.spec, simulator.action_space, jax.random.key(0))
    found = profile(task, simulator, trainer)  # first, so that it sees the compilation
    epoch = epoch_of(trainer, task, simulator, policy, jax.random.key(1))
    row = benchmark.pedantic(epoch, rounds=7)
    assert not row["skipped"]
    benchmark.extra_info |= {
        "limit_share": found.share,
        "over_forward": found.ratio,
        "megabytes": found.memory / 1e6,
        "compile_s": found.compile_seconds,
        "gflop": found.flops / 1e9,
        "gflop_per_s": found.rate / 1e9,
    }
    with capsys.disabled():
        print(  # noqa: T201
            f"\n{name}, N = {n_drones}: epoch {1e3 * found.seconds['epoch']:.1f} ms, "
            f"{found.flops / 1e9:.2f} GFLOP in products that reach {found.rate / 1e9:.0f} GFLOP/s, "
            f"{100 * found.share:.0f} % of the limit, {found.ratio:.1f} times its forward part, "
            f"{found.memory / 1e6:.3f} MB a drone and episode, compiled in "
            f"{found.compile_seconds:.0f} s"
        )


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("n_drones", TEAMS)
@pytest.mark.parametrize("name", ["low fidelity", "high fidelity"])
def test_seeds_in_one_program(benchmark, name, n_drones, seeds):
    task = Circle(n_drones=n_drones)
    simulator, trainer = trained(name, task)
    trainer = dataclasses.replace(trainer, epochs=EPOCHS)
    policy = make_policy(task, simulator.spec, simulator.action_space, jax.random.key(0))

    def train(team, seed):
        with team.member() if seeds > 1 else contextlib.nullcontext():
            key = jax.random.key(seed)
            context = Context(team=team if seeds > 1 else None)
            return trainer.train(task, simulator, policy, key, context, "benchmark").seconds

    def together():
        """Time of an epoch of one seed [s]."""
        with ThreadPoolExecutor(seeds) as pool:
            seconds = list(pool.map(functools.partial(train, Team(seeds)), range(seeds)))
        return sum(seconds) / (seeds * EPOCHS)

    together()  # compiled
    found = benchmark.pedantic(lambda: [together() for _ in range(3)], rounds=1)
    benchmark.extra_info["ms_per_seed_and_epoch"] = 1e3 * min(found)


@pytest.mark.parametrize("what", ["episodes", "physics alone"])
@pytest.mark.parametrize("simulator_name", ["point_mass", "crazyflow"])
def test_deployment_of_32_episodes(benchmark, simulator_name, what):
    task = Circle(n_drones=18)
    simulator = registry.load("simulator", simulator_name)()
    policy = make_policy(task, simulator.spec, simulator.action_space, jax.random.key(0))
    controller = PolicyController(task, policy)
    keys = jax.random.split(jax.random.key(1), 32)

    def physics(key, actions):
        """The same steps under the same actions, and all that is known of the flight."""

        def step(state, action):
            state = simulator.step(state, action)
            return state, simulator.flight(state)

        return jax.lax.scan(step, start(task, simulator, key)[0], actions)[1]

    if what == "episodes":
        flown = functools.partial(fly, task, simulator, controller, keys)
    else:
        actions = fly(task, simulator, controller, keys).action
        flown = functools.partial(jax.jit(jax.vmap(physics)), keys, actions)
    found = benchmark.pedantic(lambda: jax.block_until_ready(flown()), rounds=7, warmup_rounds=1)
    pos = found.flight.pos if what == "episodes" else found.pos
    assert pos.shape == (32, task.horizon, 18, 3)
    assert jnp.isfinite(pos).all()
