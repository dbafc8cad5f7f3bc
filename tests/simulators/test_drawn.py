"""Realities that are drawn: how numbers are drawn, teams that are not alike, what they see."""

import flying
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, hold, positions, random_cmds
from scipy.stats import kstest, norm, truncnorm

from bench.plan.realities import parse_reality
from methods.calibration.pool import calibrate
from methods.training.adjoint import by_autodiff, gradient
from methods.training.meter import Meter, metered
from methods.training.policy import PolicyController, make_policy
from simulators.contract import with_effects
from simulators.distribution import Distribution
from simulators.drawn.drawn_team import Drawn, drawn, one_member
from simulators.drawn.sensing import LONGEST_AGE_S, Sensing
from simulators.effects.drag import Drag
from simulators.effects.mass import Mass
from simulators.flight import Flight
from simulators.point_mass import PointMass
from simulators.vehicle import GRAVITY
from tasks.circle import Circle
from tasks.rollout import record

KEY = jax.random.key(0)
SHARES = jax.random.uniform(KEY, (20_000,))
TEAM = "point_mass+mass(e~normal(0, 0.1))+drag(c~uniform(0.2, 0.6))"


@pytest.fixture(scope="module")
def team():
    return parse_reality(TEAM)


def fly(simulator, cmds, key=KEY):
    """Flights after each command of a team from a reset, and the state at the reset."""
    state = simulator.reset(positions(cmds.shape[1]), key)
    return flying.fly(simulator, state, cmds), state


def test_uniform_draws_are_uniform():
    found = np.asarray(Distribution("uniform", 0.2, 0.6, 0.0, 1.0).quantile(SHARES))
    assert kstest((found - 0.2) / 0.4, "uniform").pvalue > 0.01


def test_normal_draws_are_normal_and_drawn_again_beyond_the_bounds():
    wide = np.asarray(Distribution("normal", 1.0, 0.2, -9.0, 9.0).quantile(SHARES))
    assert kstest((wide - 1.0) / 0.2, norm.cdf).pvalue > 0.01
    cut = np.asarray(Distribution("normal", 0.0, 1.0, -0.5, 2.0).quantile(SHARES))
    assert kstest(cut, truncnorm(-0.5, 2.0).cdf).pvalue > 0.01
    assert cut.min() >= -0.5
    assert (cut == -0.5).mean() < 1e-3  # nothing piles up at the bound


def test_the_ends_of_a_normal_are_its_bounds():
    law = Distribution("normal", 0.0, 1e-3, -0.5, 0.5)
    assert np.isfinite(np.asarray(law.quantile(jnp.asarray([0.0, 1.0 - 1e-7])))).all()


def test_each_drone_flies_as_one_alone_with_its_numbers(team):
    cmds = random_cmds(0, 15, 3)
    found, state = fly(team, cmds)
    assert len(np.unique(np.asarray(state.numbers)[:, 0])) == 3
    for i, (e, c) in enumerate(_numbers(team, state)):
        alone = with_effects(PointMass(), [Mass(e=e), Drag(c=c)])
        start = alone.reset(positions(3)[i : i + 1], KEY)
        expected = flying.fly(alone, start, cmds[:, i : i + 1])
        np.testing.assert_allclose(found.pos[:, i], expected.pos[:, 0], atol=1e-5)
        np.testing.assert_allclose(found.vel[:, i], expected.vel[:, 0], atol=1e-5)


def _numbers(team, state):
    """Excess mass and drag of each drone."""
    drawn_of = {type(effect).__name__: i for i, effect in enumerate(team.effects)}
    order = sorted(drawn_of, key=drawn_of.get)
    columns = [np.asarray(state.numbers)[:, order.index(name)] for name in ("Mass", "Drag")]
    return zip(*columns, strict=True)


def test_the_key_decides_who_flies(team):
    pos = positions(4)
    first, again, other = (
        np.asarray(team.reset(pos, jax.random.key(seed)).numbers) for seed in (3, 3, 4)
    )
    assert np.array_equal(first, again)
    assert not np.isclose(first, other).any()
    assert (first[:, 0] != first[1, 0]).sum() == 3


def test_a_restored_team_stays_where_it_was(team):
    cmds = random_cmds(0, 5, 2)
    flight = jax.tree.map(lambda x: x[-1], fly(team, cmds)[0])
    found = team.flight(team.restore(flight, cmds, KEY))
    for name in ("t", "pos", "vel", "quat"):
        np.testing.assert_allclose(getattr(found, name), getattr(flight, name), atol=1e-5)


def test_a_member_is_the_same_drone_in_every_flight(team):
    member = one_member(metered(team, Meter()), jax.random.key(7)).inner
    assert isinstance(member, Drawn)
    cmds = hold(HOVER, 10, 2)
    one, _ = fly(member, cmds, jax.random.key(1))
    two, _ = fly(member, cmds, jax.random.key(2))
    assert np.array_equal(one.vel, two.vel)
    np.testing.assert_allclose(one.vel[:, 0], one.vel[:, 1], atol=1e-6)
    plain = PointMass()
    assert one_member(plain, KEY) == plain


def test_all_calibration_flights_are_of_one_member_of_the_team():
    task, nominal = Circle(n_drones=2, horizon=30), PointMass()
    reality = parse_reality("point_mass+mass(e~uniform(-0.3, 0.6))")
    policy = make_policy(task, nominal.spec, nominal.action_space, KEY)

    def excess(seed):
        key = jax.random.key(seed)
        rows = calibrate(task, nominal, reality, policy, key, 4, "filtered", 0.0, 0.0).transitions
        lift = rows.features[:, 9:] + jnp.asarray([0.0, 0.0, GRAVITY])  # a_nominal without gravity
        share = 1.0 + np.asarray(rows.target[:, 2] / lift[:, 2])[np.asarray(lift[:, 2]) > 1.0]
        return 1.0 / share - 1.0

    first, second = excess(0), excess(1)
    np.testing.assert_allclose(first, first[0], atol=1e-3)
    assert abs(first[0] - second[0]) > 1e-2


def test_an_effect_between_drones_is_refused():
    with pytest.raises(ValueError, match="Downwash acts between drones"):
        drawn(PointMass(), parse_reality("point_mass+downwash(strength=1)").effects)


def moving(k, n=2):
    """A team at constant velocity, k control steps after the reset."""
    pos = jnp.asarray([[0.3 * k * 0.02, 0.0, 1.0]] * n)
    zero, level = jnp.zeros((n, 3)), jnp.zeros((n, 4)).at[:, 3].set(1.0)
    vel = zero.at[:, 0].set(0.3)
    return Flight(jnp.asarray(k * 0.02), pos, vel, level, zero, zero[:, 0], zero)


def seen(sensing, n_steps, n=2):
    """What a team at constant velocity believes after each step."""

    def step(memory, k):
        memory = sensing.sense(memory, moving(k, n))
        return memory, sensing.seen(memory, moving(k, n))

    return jax.lax.scan(step, sensing.begin(moving(0, n), KEY), jnp.arange(1, n_steps + 1))[1]


@pytest.mark.parametrize("latency", [0.0, 0.013, 0.02, 0.05, LONGEST_AGE_S])
def test_a_state_is_seen_after_its_latency(latency):
    found = seen(Sensing(latency=latency), 20)
    t = np.arange(1, 21) * 0.02
    expected = 0.3 * np.maximum(t - latency, 0.0)
    np.testing.assert_allclose(found.pos[:, 1, 0], expected, atol=1e-6)
    np.testing.assert_allclose(found.t, t, atol=1e-6)


def test_jitter_stays_within_its_size_and_differs_between_drones():
    found = seen(Sensing(latency=0.03, jitter=0.01), 2000)
    age = (np.arange(1, 2001) * 0.02)[:, None] - np.asarray(found.pos[..., 0]) / 0.3
    settled = age[10:]
    assert 0.02 - 1e-3 < settled.min() < 0.0205
    assert 0.0395 < settled.max() < 0.04 + 1e-3
    assert abs(np.corrcoef(settled.T)[0, 1]) < 0.1


def test_noise_has_its_standard_deviation_on_every_axis():
    found = seen(Sensing(pos=0.05, vel=0.2, angle=0.02), 4000, n=1)
    truth = 0.3 * 0.02 * np.arange(1, 4001)
    pos = np.asarray(found.pos[:, 0]) - np.stack([truth, 0.0 * truth, 1.0 + 0.0 * truth], 1)
    np.testing.assert_allclose(pos.std(0), 0.05, rtol=0.1)
    np.testing.assert_allclose(np.asarray(found.vel[:, 0]).std(0), 0.2, rtol=0.1)
    np.testing.assert_allclose(2.0 * np.asarray(found.quat[:, 0, :3]).std(0), 0.02, rtol=0.1)
    np.testing.assert_allclose(np.linalg.norm(found.quat, axis=-1), 1.0, atol=1e-5)


def test_a_share_of_observations_is_lost_and_the_last_one_kept():
    found = np.asarray(seen(Sensing(loss=0.2), 5000).pos[..., 0])
    kept = np.diff(found, axis=0) == 0.0
    np.testing.assert_allclose(kept.mean(0), 0.2, atol=0.02)
    assert not np.array_equal(kept[:, 0], kept[:, 1])


def test_controllers_act_on_what_is_seen_and_the_record_is_the_flight():
    task = Circle(n_drones=2, horizon=12)
    late = parse_reality("point_mass+sensing(latency=0.04)")
    flown = record(task, late, lambda state: jnp.clip(state.flight.pos, -1.0, 1.0), KEY)
    pos = np.asarray(jnp.clip(flown.flight.pos, -1.0, 1.0))
    np.testing.assert_allclose(flown.action[3:], pos[:-3], atol=1e-6)  # seen two steps later
    assert np.abs(np.asarray(flown.action[3:]) - pos[2:-1]).max() > 1e-4


def test_sensing_alone_changes_no_flight():
    cmds = random_cmds(0, 6, 2)
    noisy, _ = fly(parse_reality("point_mass+sensing(pos=0.1, loss=0.5)"), cmds)
    plain, _ = fly(PointMass(), cmds)
    np.testing.assert_allclose(noisy.pos, plain.pos, atol=1e-6)


def test_a_step_with_sensing_is_a_control_step():
    noisy = parse_reality("point_mass+sensing(pos=0.1)")
    state = noisy.reset(positions(2), KEY)
    with pytest.raises(ValueError, match=r"must last 0\.02 s, one control step, got 0\.01"):
        noisy.step_cmd(state, hold(HOVER, 1, 2)[0], 0.01)


def test_the_adjoint_of_a_team_that_sees_late_is_that_of_autodiff():
    task = Circle(n_drones=2, horizon=8)
    reality = parse_reality(f"{TEAM}+sensing(pos=0.01, latency~uniform(0.01, 0.03), loss=0.1)")
    policy = make_policy(task, reality.spec, reality.action_space, KEY)
    keys = jax.random.split(KEY, 2)
    _, found, _ = gradient(task, reality, policy, keys, 1.0, None)
    _, expected = by_autodiff(task, reality, policy, keys, 1.0)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        if hasattr(a, "shape"):
            np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3 * np.abs(b).max())


def test_two_policies_meet_the_same_teams(team):
    task = Circle(n_drones=3, horizon=2)
    policies = [make_policy(task, team.spec, team.action_space, jax.random.key(i)) for i in (0, 1)]
    first, second = (record(task, team, PolicyController(task, p), KEY) for p in policies)
    assert not np.array_equal(first.action, second.action)
    # The same drones: what they do in the first step under the same command is the same.
    assert np.array_equal(
        team.reset(positions(3), KEY).numbers, team.reset(positions(3) + 1.0, KEY).numbers
    )
