"""The written-out gradient against `jax.grad` of an episode, for every kind of simulator."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import SIMULATORS, attached

from methods.calibration.residual_effect import ResidualEffect
from methods.domain_randomization import randomized
from methods.residuals.contract import AbstractResidualModel
from methods.training import adjoint
from methods.training.adjoint import MOST_STORED_BYTES, buffers, gradient
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy, Policy, PolicyController, make_policy
from simulators.contract import with_effects
from tasks.circle import Circle
from tasks.figure8 import Figure8
from tasks.pitchandexpand import PitchAndExpand
from tasks.rollout import Episode, episode
from tasks.spread import Spread

KEY = jax.random.key(3)


class Curved(AbstractResidualModel):
    """A residual that depends on everything it sees."""

    def __call__(self, features):
        return 0.3 * jnp.sin(features[:, :3] + features[:, 3:6] - features[:, 9:])


def simulators():
    mass = SIMULATORS["point_mass"]().spec.mass
    return {
        "point_mass": SIMULATORS["point_mass"](),
        "residual": with_effects(SIMULATORS["point_mass"](), [ResidualEffect(Curved(), mass)]),
        "residual, finer steps": with_effects(
            SIMULATORS["point_mass"](dt=0.005), [ResidualEffect(Curved(), mass)]
        ),
        "effects": attached(
            SIMULATORS["point_mass"](),
            attitude_loop={"natural_freq": 15.0, "damping": 1.1},
            delay={"seconds": 0.03},
            drag={"c": 0.5},
        ),
        "drawn anew": randomized(SIMULATORS["point_mass"](dt=0.01)),
        "crazyflow": SIMULATORS["crazyflow"](),
    }


def starts(task, simulator):
    """A policy, and keys of two worlds."""
    policy = make_policy(task, simulator.spec, simulator.action_space, KEY)
    return policy, jax.random.split(KEY, 2)


@eqx.filter_jit
def plainly(task, simulator, policy, keys, decay, limit=None):
    """Episodes and gradient by `jax.grad`."""

    def loss(policy):
        controller = PolicyController(task, policy)
        fly = lambda key: episode(task, simulator, controller, key, decay, limit)  # noqa: E731
        flown = jax.vmap(fly)(keys)
        return -jnp.sum(flown.smooth_reward), flown

    (_, flown), slopes = eqx.filter_value_and_grad(loss, has_aux=True)(policy)
    return flown, slopes


def both(task, simulator, decay, keep, limit=None):
    """Episodes and gradient by `jax.grad` and by the adjoint."""
    policy, keys = starts(task, simulator)
    flown, expected = plainly(task, simulator, policy, keys, decay, limit)
    kept = buffers(policy, task, len(keys)) if keep else None
    by_adjoint = eqx.filter_jit(gradient)
    found, slopes, _ = by_adjoint(task, simulator, policy, keys, decay, kept, limit)
    return flown, expected, found, slopes


def assert_close(expected, found, tolerance):
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        np.testing.assert_allclose(b, a, rtol=0, atol=tolerance * float(jnp.abs(a).max() + 1e-30))


@pytest.mark.parametrize(
    ("name", "keep"),
    [
        ("point_mass", True),
        # `make test` has layers that are computed again in crazyflow, and finer steps.
        pytest.param("point_mass", False, marks=pytest.mark.exhaustive),
        pytest.param("residual", True, marks=pytest.mark.exhaustive),
        ("residual, finer steps", True),
        ("effects", True),
        ("drawn anew", True),
        ("crazyflow", False),
    ],
)
def test_it_is_the_gradient_of_an_episode(name, keep):
    task = Circle(n_drones=4, horizon=30)
    flown, expected, found, slopes = both(task, simulators()[name], 0.98, keep)
    assert_close(flown, found, 1e-5)
    assert jax.tree.structure(expected) == jax.tree.structure(slopes)
    assert_close(expected, slopes, 1e-5)


def test_a_limit_without_decay_binds_in_both():
    task, simulator = Circle(n_drones=2, horizon=30), SIMULATORS["point_mass"]()
    _, expected, _, slopes = both(task, simulator, 1.0, True, limit=1.0)
    assert_close(expected, slopes, 1e-5)
    _, plain = plainly(task, simulator, *starts(task, simulator), 1.0)
    norm = lambda tree: sum(float(jnp.sum(x**2)) for x in jax.tree.leaves(tree)) ** 0.5  # noqa: E731
    assert norm(slopes) < 0.9 * norm(plain)


@pytest.mark.parametrize(
    ("task_class", "decay"),
    [
        (Circle, 1.0),
        # `make test` has the other two, and all in `tests/tasks/test_task_gradients.py`.
        pytest.param(Figure8, 0.9, marks=pytest.mark.exhaustive),
        pytest.param(PitchAndExpand, 0.9, marks=pytest.mark.exhaustive),
        (Spread, 0.9),
    ],
)
def test_it_is_so_in_double_precision_for_every_task(task_class, decay):
    with jax.enable_x64(True):
        task = task_class(n_drones=3, horizon=25)
        flown, expected, found, slopes = both(task, SIMULATORS["point_mass"](), decay, True)
        assert_close(flown, found, 1e-10)
        assert_close(expected, slopes, 1e-10)


def test_a_frozen_residual_is_computed_once_a_step():
    calls = []

    class Counting(AbstractResidualModel):
        def __call__(self, features):
            jax.debug.callback(lambda: calls.append(1))
            return jnp.zeros((len(features), 3))

    simulator = SIMULATORS["point_mass"]()
    simulator = with_effects(simulator, [ResidualEffect(Counting(), simulator.spec.mass)])
    both_ways = eqx.filter_jit(gradient)
    task = Circle(n_drones=3, horizon=7)
    policy = make_policy(task, simulator.spec, simulator.action_space, KEY)
    keys = jax.random.split(KEY, 1)
    jax.block_until_ready(both_ways(task, simulator, policy, keys, 0.98, None)[1].net.layers)
    jax.effects_barrier()
    assert len(calls) == 7


def test_room_is_not_kept_where_one_world_is_asked_for_nor_without_end():
    """A large team flies in one world as well, but in a cheap simulator."""
    simulator = SIMULATORS["point_mass"]()
    for n_drones, n_worlds, keeps in (
        (12, 8, True),
        (12, 1, False),
        (100, 8, True),
        (300, 4, False),
    ):
        task = Circle(n_drones=n_drones)
        policy = make_policy(task, simulator.spec, simulator.action_space, KEY)
        room = BPTT(n_worlds=n_worlds).room(policy, task)
        assert (room is not None) == keeps
        if room:
            assert [x.shape[-1] for x in room] == [task.obs_size, 128, 128, 3]
            assert sum(x.nbytes for x in room) <= MOST_STORED_BYTES


def test_a_residual_does_not_depend_on_what_it_remembers():
    simulator = simulators()["residual"]
    state = simulator.reset(jnp.zeros((2, 3)), KEY)
    shaken = eqx.tree_at(lambda s: s.memory[0].acc, state, jnp.ones((2, 3)))
    action = jnp.zeros((2, 3))
    np.testing.assert_array_equal(
        simulator.step(state, action).vel, simulator.step(shaken, action).vel
    )


class Wrapped(AbstractPolicy):
    """The shared policy in a class of its own, whose layers nobody has written out."""

    inner: Policy

    def __call__(self, obs):
        return self.inner(obs)


def test_a_policy_of_its_own_architecture_has_the_same_gradient():
    with jax.enable_x64(True):
        task, simulator = Circle(n_drones=3, horizon=25), SIMULATORS["point_mass"]()
        policy = make_policy(task, simulator.spec, simulator.action_space, KEY)
        keys = jax.random.split(KEY, 2)
        fast, slopes, _ = gradient(task, simulator, policy, keys, 0.97, None)
        slow, others, _ = gradient(task, simulator, Wrapped(policy), keys, 0.97, None)
        np.testing.assert_allclose(slow.smooth_reward, fast.smooth_reward, rtol=1e-10)
        for one, other in zip(jax.tree.leaves(slopes), jax.tree.leaves(others), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    "other", [{"activation": jax.nn.relu}, {"final_activation": jnp.sin}, {"use_bias": False}]
)
def test_a_network_of_other_layers_is_trained_as_what_it_is(other, monkeypatch):
    """By automatic differentiation, as the policy above."""
    task, simulator = Circle(n_drones=3, horizon=15), SIMULATORS["point_mass"]()
    layers = {"activation": jnp.tanh, "final_activation": jnp.tanh} | other
    policy = Policy(eqx.nn.MLP(task.obs_size, 3, 8, 2, key=KEY, **layers))
    given, limit, asked = (task, simulator, policy, jax.random.split(KEY, 2), 0.97), 5.0, []
    answer = Episode(*[jnp.zeros(2)] * 4), Policy(policy.net)
    monkeypatch.setattr(adjoint, "by_autodiff", lambda *x: asked.append(x) or answer)
    found = gradient(*given, None, limit)
    for one, two in zip((*found, *asked[0]), (*answer, None, *given, limit), strict=True):
        assert one is two
    assert BPTT(n_worlds=4).room(policy, task) is None
