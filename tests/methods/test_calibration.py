"""Calibration flights: exact targets, role-balanced order, both attitudes, the bill."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import SPEC, Hold, fresh, leaning
from scipy.spatial.transform import Rotation

from methods.calibration.pool import (
    DITHER_STEPS,
    HOVER_SPEED,
    calibrate,
    make_reference,
    pool_size,
    track,
)
from methods.calibration.residual_effect import ResidualEffect
from methods.residuals.contract import AbstractResidualModel
from methods.training.policy import PolicyController
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.drag import Drag
from simulators.effects.mass import Mass
from simulators.point_mass import PointMass
from simulators.vehicle import GRAVITY, ActionSpace
from tasks.rollout import record

KEY = jax.random.key(11)
H = 0.02
EXCITATION = 0.05
TASK = Hold(horizon=30, goal=(0.4, -0.3, 0.3), spacing=(0.8, 0.8), jitter=0.3)
FLIGHTS = 4
NOMINAL = PointMass()
HEAVY = with_effects(PointMass(), [Mass(e=0.2)])
CELLS = {
    "crazyflow-filtered": (Crazyflow(), "filtered"),
    "crazyflow-measured": (Crazyflow(), "measured"),
    "heavy-filtered": (HEAVY, "filtered"),
}
POLICY = leaning(TASK, 0.3, 0.15)


def fly(
    reality,
    attitude="filtered",
    flights=FLIGHTS,
    policy=POLICY,
    hover_weight=0.0,
    key=KEY,
    nominal=NOMINAL,
):
    """A calibration."""
    return calibrate(
        task=TASK,
        nominal=nominal,
        reality=reality,
        policy=policy,
        key=key,
        n_flights=flights,
        attitude=attitude,
        hover_weight=hover_weight,
        excitation=EXCITATION,
    )


@eqx.filter_jit
def retrace_one(reality, attitude, policy, key, role):
    reference = make_reference(TASK, NOMINAL, policy, key, role)
    return reference, track(NOMINAL, reality, reference, attitude, EXCITATION, key)


def retrace(reality, attitude="filtered", policy=POLICY):
    """References and flights of the same calibration, one after another."""
    rows = [
        retrace_one(reality, attitude, policy, key, jnp.asarray(i % TASK.n_drones))
        for i, key in enumerate(jax.random.split(KEY, FLIGHTS))
    ]
    return jax.tree.map(lambda *x: np.stack(x), *rows)


@pytest.fixture(scope="module", params=sorted(CELLS))
def cell(request):
    return CELLS[request.param]


@pytest.fixture(scope="module")
def pool(cell):
    return fly(*cell)


@pytest.fixture(scope="module")
def flown(cell):
    return retrace(*cell)


def by_flight(rows, flights=FLIGHTS):
    return np.asarray(rows).reshape(flights, TASK.horizon, -1)


def nominal_acceleration(rpy, action):
    """The paper's equations for an attitude [rad] and the thrust that an action asks for."""
    roll, pitch = rpy[..., 0], rpy[..., 1]
    thrust = ActionSpace().thrust_max * (action[..., 2] + 1.0) / 2.0
    up = np.stack(
        [np.sin(pitch) * np.cos(roll), -np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=-1
    )
    cos, sin = np.cos(rpy[..., 2]), np.sin(rpy[..., 2])  # a real drone's yaw is not quite zero
    up = np.stack(
        [cos * up[..., 0] - sin * up[..., 1], sin * up[..., 0] + cos * up[..., 1], up[..., 2]],
        axis=-1,
    )
    return thrust[..., None] / SPEC.mass * up - np.array([0.0, 0.0, GRAVITY])


def lag(rpy, action):
    """One nominal step of the attitude towards what an action asks for."""
    wanted = np.concatenate([0.5 * action[..., :2], np.zeros_like(action[..., :1])], axis=-1)
    return rpy + (1.0 - np.exp(-H / 0.104)) * (wanted - rpy)


def test_targets_added_to_the_nominal_step_give_the_observed_velocity(pool, flown):
    _, flight = flown
    x, target = by_flight(pool.transitions.features), by_flight(pool.transitions.target)
    before, after = flight.before.vel[:, :, 0], flight.after.vel[:, :, 0]
    np.testing.assert_allclose(x[..., :3], flight.before.pos[:, :, 0], atol=2e-6)
    np.testing.assert_allclose(x[..., 3:6], before, atol=2e-6)
    np.testing.assert_allclose(before + H * (x[..., 9:] + target), after, atol=5e-6)
    assert np.abs(target).max() > 0.5  # there is something to correct


def test_the_nominal_step_is_that_of_the_chosen_attitude(cell, pool, flown):
    _, flight = flown
    x, action = by_flight(pool.transitions.features), flight.action[:, :, 0].astype(float)
    if cell[1] == "measured":
        quat = flight.before.quat[:, :, 0].astype(float)
        rpy = lag(Rotation.from_quat(quat).as_euler("xyz"), action)
    else:
        rpy = np.zeros((FLIGHTS, TASK.horizon + 1, 3))
        for k in range(TASK.horizon):
            rpy[:, k + 1] = lag(rpy[:, k], action[:, k])
        rpy = rpy[:, 1:]
    np.testing.assert_allclose(x[..., 6:9], rpy, atol=2e-5)
    np.testing.assert_allclose(x[..., 9:], nominal_acceleration(rpy, action), atol=5e-4)


class Lookup(AbstractResidualModel):
    """The target of the logged transition with the nearest features."""

    features: jax.Array
    target: jax.Array

    def __call__(self, features):
        distance = jnp.sum((features[:, None, 3:] - self.features[None, :, 3:]) ** 2, axis=-1)
        return self.target[jnp.argmin(distance, axis=-1)]


def test_the_corrected_point_mass_repeats_the_flight():
    """The reading `filtered` is what a policy meets: the same actions, the same velocities."""
    reality, attitude = CELLS["crazyflow-filtered"]
    logged = fly(reality, attitude).transitions
    x, y = by_flight(logged.features)[1], by_flight(logged.target)[1]
    _, flight = retrace(reality, attitude)
    model = Lookup(jnp.asarray(x), jnp.asarray(y))
    simulator = with_effects(NOMINAL, [ResidualEffect(model, SPEC.mass)])
    state, vel = simulator.reset(jnp.asarray(flight.before.pos[1, 0]), KEY), []
    step = eqx.filter_jit(simulator.step)
    for action in flight.action[1]:
        state = step(state, jnp.asarray(action))
        vel.append(state.vel)
    np.testing.assert_allclose(np.stack(vel), flight.after.vel[1], atol=1e-4)


def test_flights_are_counted_and_pool_is_the_papers(pool):
    assert pool.flights == FLIGHTS
    assert len(pool.transitions.target) == FLIGHTS * TASK.horizon
    assert pool_size(3) == 240
    assert pool_size(18) * 10 / 60 == pytest.approx(190)  # minutes


def test_position_remainder_and_tracking_error_equal_a_recount(pool, flown):
    reference, flight = flown
    before, after = flight.before, flight.after
    remainder = (after.pos - before.pos - H * after.vel)[:, :, 0]
    assert pool.pos_remainder == pytest.approx(
        np.sqrt((remainder**2).sum(axis=-1).mean()), rel=1e-2, abs=1e-7
    )
    distance = np.linalg.norm(before.pos[:, :, 0] - reference.pos, axis=-1)
    assert pool.tracking_error == pytest.approx(distance.mean(), rel=1e-4)


def test_flight_i_takes_role_i_modulo_the_team_size():
    """Roles start 0.8 m apart along x with a jitter of 0.3 m: the start tells the role."""
    pool = fly(HEAVY, flights=7)
    start = by_flight(pool.transitions.features, flights=7)[:, 0, 0]
    np.testing.assert_array_equal(np.round(start / 0.8), np.arange(7) % 3)
    assert len(np.unique(start)) == 7  # of an episode of its own each


def test_a_smaller_budget_is_a_prefix_of_the_pool():
    small, large = (fly(HEAVY, flights=n).transitions for n in (FLIGHTS, 7))
    n = len(small.target)
    np.testing.assert_allclose(small.features, large.features[:n], rtol=1e-5, atol=5e-6)
    np.testing.assert_allclose(small.target, large.target[:n], atol=5e-4)


def test_the_reference_is_one_role_of_a_low_fidelity_episode():
    flown = record(TASK, NOMINAL, PolicyController(TASK, POLICY), KEY).flight
    reference = make_reference(TASK, NOMINAL, POLICY, KEY, jnp.asarray(2))
    np.testing.assert_allclose(reference.pos[1:], flown.pos[:-1, 2], atol=1e-6)
    np.testing.assert_allclose(reference.vel[1:], flown.vel[:-1, 2], atol=1e-6)
    np.testing.assert_allclose(reference.vel[0], 0.0)
    np.testing.assert_allclose(reference.vel[1:], jnp.diff(reference.pos, axis=0) / H, atol=1e-4)
    np.testing.assert_allclose(reference.acc[:-1], jnp.diff(reference.vel, axis=0) / H, atol=1e-5)


def pd_action(reference, flight):
    """The paper's PD law, before clipping."""
    before = flight.before
    wanted = reference.acc + 6.0 * (reference.pos - before.pos[:, :, 0])
    wanted = wanted + 4.0 * (reference.vel - before.vel[:, :, 0]) + [0.0, 0.0, GRAVITY]
    size = np.linalg.norm(wanted, axis=-1)
    roll = -np.arcsin(np.clip(wanted[..., 1] / size, -0.999, 0.999))
    pitch = np.arctan2(wanted[..., 0], wanted[..., 2])
    thrust = 2.0 * SPEC.mass * size / ActionSpace().thrust_max - 1.0
    return np.stack([roll / 0.5, pitch / 0.5, thrust], axis=-1)


def test_actions_are_the_trackers_and_clipped_ones_are_logged():
    policy = leaning(TASK, 0.97, 0.9)  # such that the controller asks for too much at times
    pool = fly(HEAVY, policy=policy)
    reference, flight = retrace(HEAVY, policy=policy)
    wanted = pd_action(reference, flight)
    dither = flight.action[:, :, 0] - np.clip(wanted, -1, 1)
    assert np.abs(dither).max() <= EXCITATION + 2e-4
    clear = np.abs(np.abs(wanted) - 1.0).min(axis=-1) > 1e-3
    asked = (np.abs(wanted) > 1.0).any(axis=-1)
    at_limit = (np.abs(flight.action[:, :, 0]) > 1.0 - 1e-6).any(axis=-1)
    clipped = np.asarray(flight.clipped[:, :, 0])
    assert clipped[asked & clear].all()
    np.testing.assert_array_equal(clipped[clear & ~asked], at_limit[clear & ~asked])
    assert (clipped & clear & ~asked).any()  # the dither alone went beyond
    assert 0.05 < pool.clipped_share < 0.95
    assert pool.clipped_share == pytest.approx(flight.clipped.mean(), abs=1e-6)


def test_excitation_is_held_bounded_and_different_in_each_flight():
    reference, flight = retrace(HEAVY)
    dither = flight.action[:, :, 0] - pd_action(reference, flight)
    blocks = dither.reshape(FLIGHTS, -1, DITHER_STEPS, 3)
    np.testing.assert_allclose(blocks, blocks[:, :, :1].repeat(DITHER_STEPS, axis=2), atol=2e-4)
    assert 0.8 * EXCITATION < np.abs(blocks).max() <= EXCITATION + 2e-4
    assert len(np.unique(np.round(blocks[:, :, 0], 3))) > FLIGHTS * 3


def test_crashes_of_the_isolated_drone_equal_a_recount():
    """A reference that dives through the floor, which counts from 0.5 s on."""
    policy = leaning(TASK, 0.01, -0.9)
    pool = fly(NOMINAL, policy=policy)
    _, flight = retrace(NOMINAL, policy=policy)
    low = (flight.after.pos[:, :, 0, 2] <= 0.0) & (flight.after.t > 0.5)
    onsets = low[:, 0].sum() + (low[:, 1:] & ~low[:, :-1]).sum()
    assert pool.crashes == onsets == FLIGHTS
    assert fly(NOMINAL).crashes == 0


def test_there_is_nothing_to_correct_if_reality_is_the_point_mass():
    pool = fly(NOMINAL)
    np.testing.assert_allclose(pool.transitions.target, 0.0, atol=1e-3)
    assert pool.pos_remainder == pytest.approx(0.0, abs=1e-6)


EFFECTS, FINE = with_effects(PointMass(), [Drag(c=0.8), Mass(e=0.2)]), PointMass(dt=0.005)


@pytest.mark.parametrize(
    ("nominal", "attitude"),
    [
        (EFFECTS, "filtered"),
        (FINE, "measured"),
        # `make test` has each simulator and each attitude once.
        pytest.param(EFFECTS, "measured", marks=pytest.mark.exhaustive),
        pytest.param(FINE, "filtered", marks=pytest.mark.exhaustive),
    ],
)
def test_what_the_nominal_simulator_knows_is_not_corrected(nominal, attitude):
    """Drag, mass and shorter steps are in reality and in the nominal simulator alike."""
    known = fly(nominal, attitude, nominal=nominal).transitions.target
    np.testing.assert_allclose(known, 0.0, atol=2e-3)
    assert np.abs(fly(nominal, attitude).transitions.target).max() > 0.04


def test_what_reality_draws_is_apart_from_what_the_reference_drew(monkeypatch):
    """Else the gusts of a calibration flight would follow from where its path begins."""
    keys, reset = [], PointMass.reset
    monkeypatch.setattr(PointMass, "reset", lambda *x: keys.append(x[2]) or reset(*x))
    reference = jax.tree.map(lambda x: jnp.asarray(x[0]), retrace(NOMINAL)[0])
    keys.clear()
    track(NOMINAL, NOMINAL, reference, "filtered", EXCITATION, KEY)
    used = {int(jax.random.bits(key)) for key in keys}
    assert used
    assert not used & {int(jax.random.bits(k)) for k in (KEY, *jax.random.split(KEY, 4))}


def test_a_heavier_reality_shows_as_missing_thrust():
    """Targets of a mass 1.2 m: (1 / 1.2 - 1) of the nominal thrust over mass."""
    pool = fly(HEAVY)
    thrust = pool.transitions.features[:, 9:] + jnp.asarray([0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(pool.transitions.target, (1 / 1.2 - 1) * thrust, atol=2e-3)


def test_hover_weight_adds_weight_to_slow_transitions_only():
    policy = fresh(TASK)
    plain, weighted = (fly(NOMINAL, policy=policy, hover_weight=w) for w in (0.0, 4.0))
    np.testing.assert_array_equal(plain.transitions.weight, 1.0)
    speed = np.linalg.norm(weighted.transitions.features[:, 3:6], axis=1)
    expected = 1.0 + 4.0 * np.exp(-0.5 * (speed / HOVER_SPEED) ** 2)
    np.testing.assert_allclose(weighted.transitions.weight, expected, rtol=1e-4)
    assert expected.max() > 4.9
    assert expected.min() < 3.0


def test_the_same_key_gives_the_same_flights():
    first, second = (fly(HEAVY).transitions for _ in range(2))
    np.testing.assert_array_equal(first.target, second.target)
    other = fly(HEAVY, key=jax.random.key(12)).transitions
    assert not np.array_equal(first.target, other.target)
