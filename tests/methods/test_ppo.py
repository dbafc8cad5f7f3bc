"""PPO: its advantages, its clipped objective, what it is billed, and that it learns."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import Hold, Memory, fresh, lift, same, setup

from bench.conformance.methods import behaviour
from bench.conformance.suite import execute
from methods.ppo import PPO, Learner, Steps, fly, loss, prepared
from methods.running.metered import train_metered
from methods.training.context import Context
from methods.training.policy import PolicyController
from simulators.point_mass import PointMass
from tasks.rollout import record

KEY = jax.random.key(3)
CLIMB = Hold(n_drones=2, horizon=25, goal=(0.0, 0.0, 4.0), vel_weight=0.0, spacing=(3.0, 3.0))
"""The goal is too high to be reached: the best is full thrust, level, all the way."""
CELL = setup(CLIMB, PointMass(), fresh(CLIMB))
TINY = PPO(epochs=3, n_worlds=2, passes=2, minibatches=2)


@pytest.fixture(scope="module")
def trained():
    return train_metered(TINY, CELL, KEY)


@pytest.fixture(scope="module")
def learner():
    critic = eqx.nn.MLP(CLIMB.obs_size, "scalar", 8, 1, key=jax.random.key(0))
    return Learner(fresh(CLIMB), jnp.log(jnp.asarray([0.1, 0.2, 0.4])), critic)


def test_it_finds_full_thrust_on_a_task_whose_best_policy_is_known():
    learned = train_metered(PPO(epochs=40, n_worlds=16, lr=3e-3), CELL, KEY)
    reality = PointMass()
    value = lambda controller: float(  # noqa: E731
        record(CLIMB, reality, controller, KEY).reward.sum(0).mean()
    )
    best = value(lift(CLIMB, 1.0 - reality.action_space.hover(reality.spec.mass)))
    before = value(PolicyController(CLIMB, fresh(CLIMB)))
    after = value(PolicyController(CLIMB, learned.policy))
    assert before < after <= best + 1e-3
    assert after > before + 0.9 * (best - before)
    assert learned.status == "ok"


def test_advantages_are_discounted_sums_of_errors():
    rng = np.random.default_rng(0)
    shape, settings = (6, 2, 3), PPO(discount=0.9, trace=0.7)
    reward, value = rng.normal(size=shape), rng.normal(size=shape)
    last = rng.normal(size=shape[1:])
    steps = Steps(*(jnp.asarray(x, float) for x in (
        np.zeros((*shape, 5)), np.zeros((*shape, 3)), np.zeros(shape), value, reward)))  # fmt: skip
    found = prepared(steps, jnp.asarray(last, float), settings)
    following = np.concatenate([value[1:], last[None]])
    errors = 0.1 * reward + 0.9 * following - value
    expected = np.zeros(shape)
    for t in range(6):
        expected[t] = sum(0.63**i * errors[t + i] for i in range(6 - t))
    np.testing.assert_allclose(found.reward, expected.reshape(-1), rtol=1e-4, atol=1e-6)
    assert found.obs.shape == (36, 5)


def test_the_density_is_that_of_a_normal_distribution(learner):
    obs, raw = jnp.zeros((4, CLIMB.obs_size)), jnp.asarray([[0.3, -0.2, 1.4]] * 4)
    mean, std = np.asarray(learner.policy(obs)), np.array([0.1, 0.2, 0.4])
    z = (np.asarray(raw) - mean) / std
    expected = (-0.5 * z**2 - np.log(std * np.sqrt(2.0 * np.pi))).sum(1)
    np.testing.assert_allclose(learner.density(obs, raw), expected, rtol=1e-4)


def test_no_gain_is_sought_beyond_the_clip(learner):
    """Where the ratio is already above 1 + eps and the advantage positive, nothing pulls."""
    obs = jax.random.normal(KEY, (8, CLIMB.obs_size))
    raw = learner.policy(obs) + jnp.asarray([[0.1]] * 4 + [[-0.3]] * 4)
    density = learner.density(obs, raw)
    # The first four are better than the others and far likelier than when they were drawn.
    old = density - jnp.asarray([1.0] * 4 + [-1.0] * 4)
    advantage = jnp.asarray([1.0] * 4 + [-1.0] * 4)
    part = Steps(obs, raw, old, learner.values(obs) - advantage, advantage)
    slopes = eqx.filter_grad(loss)(learner, part, PPO())
    assert all(not np.asarray(x).any() for x in jax.tree.leaves((slopes.policy, slopes.log_std)))
    near = dataclasses.replace(part, density=density)
    assert np.abs(eqx.filter_grad(loss)(learner, near, PPO()).log_std).max() > 1e-3


def test_an_episode_explores_around_the_policy_and_its_actions_are_within_bounds(learner):
    steps, last, sums = fly(CLIMB, PointMass(), learner, KEY)
    mean = jax.vmap(learner.policy)(steps.obs)
    np.testing.assert_allclose((steps.raw - mean).std((0, 1)), [0.1, 0.2, 0.4], rtol=0.35)
    assert last.shape == (2,)
    np.testing.assert_allclose(sums.reward, steps.reward.sum(0).mean(), rtol=1e-5)


def test_every_step_of_its_flight_is_billed(trained):
    seconds = 3 * 2 * CLIMB.horizon * 0.02 * CLIMB.n_drones
    assert trained.ledger.hf_fleet_seconds == pytest.approx(seconds, rel=1e-9)
    assert trained.ledger.epochs == 3
    assert set(trained.curves) >= {"reward", "smooth_reward", "crashes", "grad_norm"}
    assert trained.notes["training_reward"] == pytest.approx(
        np.mean(trained.curves["smooth_reward"]), rel=1e-5
    )


def test_large_teams_fly_fewer_episodes():
    assert [PPO().worlds(n) for n in (3, 12, 200)] == [16, 8, 1]


def test_crashes_of_training_are_billed():
    close = setup(Hold(n_drones=2, horizon=5), PointMass(), fresh(CLIMB))  # 0.25 m apart
    ledger = train_metered(TINY, close, KEY).ledger
    assert ledger.training_crashes == 3 * 2 * 2
    assert ledger.training_crash_step_rate == 1.0


def test_another_key_gives_another_policy(trained):
    assert not same(trained.policy, train_metered(TINY, CELL, jax.random.key(4)).policy)


def test_a_training_that_is_killed_goes_on_where_it_was(trained):
    keeper, flown = Memory(), []

    def progress(stage, epoch, epochs, reward):
        flown.append(epoch)
        if flown == [1, 2]:
            raise KeyboardInterrupt

    def train():
        context = Context(progress, keeper=keeper)
        return train_metered(TINY, dataclasses.replace(CELL, context=context), KEY)

    with pytest.raises(KeyboardInterrupt):
        train()
    resumed = train()
    assert flown == [1, 2, 3]  # none twice
    assert same(resumed.policy, trained.policy)
    assert resumed.ledger.hf_fleet_seconds == trained.ledger.hf_fleet_seconds
    np.testing.assert_allclose(resumed.curves["reward"], trained.curves["reward"], rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"epochs": 0}, "`epochs` must be at least 1, got 0"),
        ({"discount": 1.0}, r"`discount` must lie in \[0, 1\), got 1.0"),
        ({"std": 0.0}, "`std` must be above 0, got 0.0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, match):
    with pytest.raises(ValueError, match=match):
        PPO(**settings)


def test_it_behaves_as_every_method_must():
    few = {"passes": 2, "minibatches": 2}
    assert [x for x in execute(PPO, behaviour(PPO, PointMass, {}, few)) if x.problem] == []
