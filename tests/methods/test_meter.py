"""The reality bills its own flight, however it is flown."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import METHODS, TINY, Hold, fresh, same, setup, small

from diagnosis.replay.library import make_library
from methods.contract import AbstractMethod, Ledger, Trained
from methods.running.metered import train_metered
from methods.training.adjoint import by_autodiff, gradient
from methods.training.evaluate import evaluate
from methods.training.meter import Meter, Metered, billed
from methods.training.policy import PolicyController
from methods.training.varied import vary_around
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.delay import Delay
from simulators.effects.drag import Drag
from simulators.point_mass import PointMass
from tasks.rollout import episode

TASK = Hold(n_drones=2, horizon=5)
STEP = 0.02 * TASK.n_drones
"""Fleet-seconds of a control step [s]."""
KEY = jax.random.key(0)


@pytest.fixture
def metered():
    return Metered(with_effects(PointMass(), [Drag(c=0.3), Delay(0.03)]), Meter())


def flown(simulator, actions):
    state = simulator.reset(TASK.reset(KEY)[0], KEY)
    return jax.lax.scan(lambda s, a: (simulator.step(s, a), None), state, actions)[0]


def push(simulator, actions):
    return jnp.sum(simulator.flight(flown(simulator, actions)).pos ** 2)


def checkpointed(simulator, actions):
    state = simulator.reset(TASK.reset(KEY)[0], KEY)
    step = jax.checkpoint(lambda s, a: (simulator.step(s, a), None))
    return jnp.sum(simulator.flight(jax.lax.scan(step, state, actions)[0]).pos ** 2)


ACTIONS = 0.1 * jax.random.normal(KEY, (5, 2, 3))
SEVERAL = jnp.stack([ACTIONS, -ACTIONS, 0.5 * ACTIONS])
WAYS = {
    "by hand": (5, lambda s: [s.step(s.reset(jnp.ones((2, 3)), KEY), a) for a in ACTIONS]),
    "scan": (5, lambda s: flown(s, ACTIONS)),
    "jit": (5, lambda s: jax.jit(lambda a: push(s, a))(ACTIONS)),
    "filter_jit": (5, lambda s: eqx.filter_jit(push)(s, ACTIONS)),
    "vmap": (15, lambda s: jax.vmap(lambda a: push(s, a))(SEVERAL)),
    "vmap of vmap": (
        30,
        lambda s: jax.vmap(jax.vmap(lambda a: push(s, a)))(
            SEVERAL[None] * jnp.ones((2, 1, 1, 1, 1))
        ),
    ),
    "map in batches": (15, lambda s: jax.lax.map(lambda a: push(s, a), SEVERAL, batch_size=2)),
    "grad": (5, lambda s: jax.jit(jax.grad(lambda a: push(s, a)))(ACTIONS)),
    "grad with checkpoints": (5, lambda s: jax.grad(lambda a: checkpointed(s, a))(ACTIONS)),
    "vmap of grad": (15, lambda s: jax.vmap(jax.grad(lambda a: checkpointed(s, a)))(SEVERAL)),
    "jvp": (5, lambda s: jax.jvp(lambda a: push(s, a), (ACTIONS,), (ACTIONS,))),
    "twice": (10, lambda s: [eqx.filter_jit(push)(s, ACTIONS) for _ in range(2)]),
    "many sizes of an effect": (
        15,
        lambda s: jax.vmap(
            lambda c: push(eqx.tree_at(lambda s: s.inner.effects[1].c, s, c), ACTIONS)
        )(jnp.arange(3.0)),
    ),
    "evaluation": (
        15,
        lambda s: evaluate(TASK, s, PolicyController(TASK, fresh(TASK)), 0, n_episodes=3),
    ),
    "an episode": (
        5,
        lambda s: episode(TASK, s, PolicyController(TASK, fresh(TASK)), KEY, 0.98),
    ),
    "an epoch's adjoint": (
        10,
        lambda s: gradient(TASK, s, fresh(TASK), jax.random.split(KEY, 2), 0.98, None),
    ),
    "an epoch by automatic differentiation": (
        10,
        lambda s: by_autodiff(TASK, s, fresh(TASK), jax.random.split(KEY, 2), 0.98),
    ),
    "inside another simulator": (5, lambda s: push(vary_around(s, 0.2), ACTIONS)),
}


@pytest.mark.parametrize("way", WAYS)
def test_each_step_is_counted_once_however_it_is_flown(metered, way):
    steps, fly = WAYS[way]
    fly(metered)
    assert metered.meter.fleet_seconds == pytest.approx(steps * STEP)


def test_a_metered_flight_is_the_flight(metered):
    found, expected = flown(metered, ACTIONS), flown(metered.inner, ACTIONS)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7)


def test_effects_attach_to_a_metered_simulator_and_are_counted(metered):
    windy = with_effects(metered, [Drag(c=2.0)])
    assert len(windy.effects) == 3
    flown(windy, ACTIONS)
    assert metered.meter.fleet_seconds == pytest.approx(5 * STEP)


def test_flight_that_is_known_beforehand_is_billed_once(metered):
    bare = billed(vary_around(metered, 0.2), 10)
    assert not any(isinstance(x, Metered) for x in (bare, bare.simulator))
    push(bare, ACTIONS)
    assert metered.meter.fleet_seconds == pytest.approx(10 * 0.02)
    assert billed(metered.inner, 10) == metered.inner


class Secretive(AbstractMethod):
    """Flies the reality in a loop of its own, and says nothing of it, or something else."""

    said: float = 0.0
    inherited: float = 0.0

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup, key, init=None):
        policy = init or fresh(setup.task)
        controller = PolicyController(setup.task, policy)
        evaluate(setup.task, setup.reality, controller, 0, n_episodes=3)
        ledger = Ledger(
            hf_fleet_seconds=self.said, inherited_fleet_seconds=self.inherited, epochs=1
        )
        return Trained(policy, ledger, {"reward": np.zeros(1)})


@pytest.mark.parametrize(("said", "inherited"), [(0.0, 0.0), (1e6, 0.0), (0.0, 70.0)])
def test_a_method_that_does_not_bill_its_flight_is_billed(said, inherited):
    cell = setup(TASK, Crazyflow(), fresh(TASK))
    ledger = train_metered(Secretive(said=said, inherited=inherited), cell, KEY).ledger
    assert ledger.hf_fleet_seconds == pytest.approx(15 * STEP + inherited)


def test_what_is_no_trained_is_refused():
    broken = dataclasses.replace(Secretive())
    object.__setattr__(broken, "train", lambda *given: None)
    with pytest.raises(TypeError, match="`train` of `Secretive` must return a Trained, got None"):
        train_metered(broken, setup(TASK, PointMass(), fresh(TASK)), KEY)


def test_a_method_of_ours_compiles_the_program_of_the_bare_reality():
    """Counting costs nothing where the trainer knows what it flies."""
    cell = setup(TASK, PointMass(), fresh(TASK))
    plain = METHODS["hf_hotstart"](trainer=TINY).train(cell, KEY)
    counted = train_metered(small("hf_hotstart"), cell, KEY)
    assert counted.ledger.hf_fleet_seconds == pytest.approx(TINY.epochs * TASK.horizon * STEP)
    assert same(plain.policy, counted.policy)


def test_logs_are_not_replayed_in_a_metered_simulator(metered):
    """It sets no states; whoever replays logs does so in the nominal simulator."""
    with pytest.raises(
        TypeError, match=r"must be a simulator itself, got 'point_mass' in a Metered"
    ):
        make_library(metered)
