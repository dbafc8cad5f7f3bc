"""Deployment: every number against a recount from the stored flights, any controller, effects."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import Hold, OpenLoop, leaning, lift

from methods.calibration.reference_paths import Followers
from methods.training.evaluate import (
    evaluate,
    evaluation_keys,
    fly,
    settling_times,
    standing_rewards,
    takeoff_steps,
    worst_tenth,
)
from methods.training.policy import PolicyController
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.floor import Floor
from simulators.effects.mass import Mass
from simulators.point_mass import PointMass
from simulators.tracking import PDTracker
from simulators.vehicle import GRAVITY
from tasks.circle import Circle
from tasks.contract import AbstractTask
from tasks.figure8 import Figure8
from tasks.pitchandexpand import PitchAndExpand
from tasks.spread import Spread

SEED, EPISODES = 4, 3
TASK = Hold(horizon=40, goal=(0.5, 0.1, 0.4), spacing=(0.35, 0.6), jitter=0.1, altitude=0.6)
SIMULATORS = {"point_mass": PointMass(), "crazyflow": Crazyflow()}
# Leans over and sinks: drones hit each other at times and the floor in the end.
CONTROLLER = PolicyController(TASK, leaning(TASK, 0.2, -0.4))


class Tracking(eqx.Module):
    """The PD tracker on its way to where the task wants each drone."""

    task: AbstractTask
    tracker: PDTracker = PDTracker()

    def __call__(self, state):
        target = self.task.target(state)
        pos = state.flight.pos + target.offset
        return self.tracker.action(state.flight, pos, target.vel, target.acc)[0]


@pytest.fixture(scope="module", params=sorted(SIMULATORS))
def simulator(request):
    return SIMULATORS[request.param]


@pytest.fixture(scope="module")
def record(simulator):
    flown = fly(TASK, simulator, CONTROLLER, evaluation_keys(SEED, EPISODES))
    return jax.tree.map(np.asarray, flown)


@pytest.fixture(scope="module")
def evaluation(simulator):
    return evaluate(TASK, simulator, CONTROLLER, SEED, EPISODES)


def goals():
    keys = evaluation_keys(SEED, EPISODES)
    return np.stack([np.asarray(TASK.reset(jax.random.split(key)[0])[1]) for key in keys])


def touching(record):
    """Contact with another drone, per pair, and with the floor after half a second."""
    pos = record.flight.pos.astype(float)
    distance = np.linalg.norm(pos[:, :, :, None] - pos[:, :, None], axis=-1)
    others = (distance < 0.3) & ~np.eye(TASK.n_drones, dtype=bool)
    floor = (pos[..., 2] <= 0.0) & (record.flight.t[..., None] > 0.5)
    return others, floor


def test_rewards_equal_a_recount(record, evaluation):
    offset = goals()[:, None] - record.flight.pos
    others, _ = touching(record)
    smooth = lambda x: np.sqrt((x.astype(float) ** 2).sum(axis=-1) + 1e-6)  # noqa: E731
    reward = -smooth(offset) - 0.5 * smooth(record.flight.vel) - others.sum(axis=-1)
    np.testing.assert_allclose(record.reward, reward, atol=1e-5)
    np.testing.assert_allclose(evaluation.rewards, reward.mean(axis=2).sum(axis=1), rtol=1e-5)
    assert evaluation.reward == pytest.approx(reward.mean(axis=2).sum(axis=1).mean(), rel=1e-5)
    assert evaluation.rewards.std() > 1e-3  # episodes differ


def test_takeoff_and_the_rest_make_the_whole_return_and_equal_a_recount(record, evaluation):
    """Of 40 steps the first 8 are the take-off."""
    reward = record.reward.astype(float).mean(axis=2)
    takeoff, rest = reward[:, :8].sum(axis=1), reward[:, 8:].sum(axis=1)
    assert takeoff_steps(TASK) == 8
    np.testing.assert_allclose(evaluation.takeoff_rewards, takeoff, rtol=1e-5)
    assert evaluation.takeoff_reward == pytest.approx(takeoff.mean(), rel=1e-5)
    assert evaluation.settled_reward == pytest.approx(rest.mean(), rel=1e-5)
    whole = evaluation.takeoff_reward + evaluation.settled_reward
    assert whole == pytest.approx(evaluation.reward, rel=1e-12)
    assert takeoff.mean() > 0.5 * rest.mean()  # it falls and falls


def test_the_worst_decile_is_the_mean_of_the_lowest_tenth_of_all_drones(record, evaluation):
    settled = np.sort(record.reward.astype(float)[:, 8:].sum(axis=1).ravel())
    lowest = settled[: max(1, round(0.1 * len(settled)))]
    assert evaluation.worst_decile == pytest.approx(lowest.mean(), rel=1e-5)
    assert evaluation.worst_decile < evaluation.settled_reward


def test_a_flight_without_numbers_is_no_good_one():
    assert np.isnan(worst_tenth(np.asarray([[1.0, 2.0], [np.nan, 4.0]])))
    error = np.full((1, 5), 0.05)
    error[0, 2:] = np.nan
    np.testing.assert_allclose(settling_times(error), [0.10])


@pytest.mark.parametrize(("horizon", "steps"), [(500, 100), (250, 50), (15, 3), (1, 0)])
def test_takeoff_is_a_fifth_of_any_horizon(horizon, steps):
    assert takeoff_steps(Hold(horizon=horizon)) == steps


def test_settling_time_is_when_the_team_was_last_outside_of_its_band():
    """By hand: settles after two steps, leaves again at the end, never arrives, is always there."""
    error = np.full((4, 5), 0.05)
    error[0, :2] = error[1, [0, 4]] = error[2] = 0.3
    error[2, 2] = 0.05  # passing by is not settling
    np.testing.assert_allclose(settling_times(error), [0.04, 0.10, 0.10, 0.0])


def test_settling_time_equals_a_recount(simulator):
    """Teams that fly to landmarks of their own, some of them further away than others."""
    task = Spread(n_drones=2, horizon=200)
    keys = evaluation_keys(SEED, EPISODES)
    pos = np.asarray(fly(task, simulator, Tracking(task), keys).flight.pos, float)
    times = []
    for key, flown in zip(keys, pos, strict=True):
        landmarks = np.asarray(task.reset(jax.random.split(key)[0])[1], float)
        outside = [
            k for k, at in enumerate(flown) if np.linalg.norm(at - landmarks, axis=1).mean() > 0.1
        ]
        times.append(0.02 * (max(outside) + 1))
    found = evaluate(task, simulator, Tracking(task), SEED, EPISODES).settling_time
    assert found == pytest.approx(np.mean(times), abs=1e-3)
    assert np.ptp(times) > 0.05
    assert 0.5 < found < 3.5


def test_a_team_that_never_arrives_has_not_settled_before_the_end(evaluation):
    assert evaluation.settling_time == pytest.approx(TASK.horizon * 0.02)


def test_crashes_equal_a_recount(record, evaluation):
    others, floor = touching(record)
    contact = others.any(axis=-1) | floor
    np.testing.assert_array_equal(record.contact, contact)
    onsets = sum(
        int(contact[e, k, i] and not (k > 0 and contact[e, k - 1, i]))
        for e in range(EPISODES)
        for k in range(TASK.horizon)
        for i in range(TASK.n_drones)
    )
    assert evaluation.crashes == pytest.approx(onsets / EPISODES)
    assert evaluation.crash_step_rate == pytest.approx(contact.any(axis=2).mean())
    assert onsets >= 2 * EPISODES
    assert 0.0 < evaluation.crash_step_rate < 1.0


def test_position_error_equals_a_recount(record, evaluation):
    """The episode is shorter than 5 s, so all of it counts."""
    distance = np.linalg.norm(goals()[:, None] - record.flight.pos, axis=-1)
    assert evaluation.position_error == pytest.approx(np.median(distance), rel=1e-4)


def test_the_trajectory_is_the_first_episodes(record, evaluation):
    np.testing.assert_allclose(evaluation.trajectory["pos"], record.flight.pos[0], atol=1e-6)
    np.testing.assert_allclose(
        evaluation.trajectory["t"], 0.02 * np.arange(1, TASK.horizon + 1), rtol=1e-5
    )


def test_batched_equals_one_world_at_a_time(simulator, record):
    for i, key in enumerate(evaluation_keys(SEED, EPISODES)):
        alone = fly(TASK, simulator, CONTROLLER, key[None])
        np.testing.assert_allclose(alone.flight.pos[0], record.flight.pos[i], atol=2e-4)
        np.testing.assert_allclose(alone.reward[0].sum(), record.reward[i].sum(), rtol=1e-3)


def test_initial_states_are_the_same_whoever_flies_and_whatever_flies():
    """Level flight leaves x and y as they were drawn."""
    keys = evaluation_keys(SEED, EPISODES)
    spawns = np.stack([np.asarray(TASK.reset(jax.random.split(key)[0])[0]) for key in keys])
    for simulator in SIMULATORS.values():
        for excess in (-0.2, 0.1):
            pos = fly(TASK, simulator, lift(TASK, excess), keys).flight.pos
            np.testing.assert_allclose(pos[:, 0, :, :2], spawns[:, :, :2], atol=1e-6)
    assert np.abs(np.diff(spawns, axis=0)).max() > 0.01


def numbers(seed, n=64):
    """The numbers of the keys, a row each."""
    return np.asarray(jax.random.key_data(evaluation_keys(seed, n)))


def test_all_seeds_that_count_meet_the_same_states_and_tuning_seeds_others():
    counted, tuned = numbers(0), numbers(1000)
    np.testing.assert_array_equal(jax.random.key_data(evaluation_keys()), counted)
    assert len(np.unique(counted, axis=0)) == 64
    for seed in (1, 7, 999):
        np.testing.assert_array_equal(numbers(seed), counted)
    for seed in (1001, 1007, 54321):
        np.testing.assert_array_equal(numbers(seed), tuned)
    assert len(np.unique(np.concatenate([counted, tuned]), axis=0)) == 128


def test_an_evaluation_depends_on_its_seed_only_by_whether_it_is_for_tuning(evaluation, simulator):
    """Those that count repeat exactly."""
    first, last, tuning = (
        evaluate(TASK, simulator, CONTROLLER, seed, EPISODES) for seed in (0, 999, 1000)
    )
    for again in (first, last):
        np.testing.assert_array_equal(again.rewards, evaluation.rewards)
        assert again.crashes == evaluation.crashes
        assert again.position_error == evaluation.position_error
    assert np.abs(tuning.rewards - evaluation.rewards).min() > 1e-4


def test_fewer_episodes_are_the_first_ones():
    np.testing.assert_array_equal(numbers(SEED, 2), numbers(SEED, 32)[:2])


CALM = Hold(n_drones=2, horizon=150, goal=(0.3, 0.0, 0.2), spacing=(2.0, 2.0))


def test_a_heavier_reality_sags_by_the_closed_form_without_training_again(simulator):
    """kp sag = 0.2 g: the controller believes the nominal mass and has no integral."""
    heavy = with_effects(simulator, [Mass(e=0.2)])
    flown = fly(CALM, heavy, Tracking(CALM), evaluation_keys(SEED, 1))
    sag = np.asarray(flown.error)[0, -1]
    np.testing.assert_allclose(sag, 0.2 * GRAVITY / 6.0, atol=0.03)


def test_position_error_is_that_of_the_last_five_seconds():
    """Far from its goal at first, there later: only the settled part counts."""
    task = Hold(n_drones=2, horizon=400, goal=(1.0, 0.0, 0.0), spacing=(3.0, 3.0))
    settled = evaluate(task, PointMass(), Tracking(task), SEED, 2)
    flown = fly(task, PointMass(), Tracking(task), evaluation_keys(SEED, 2))
    assert settled.position_error == pytest.approx(np.median(flown.error[:, -250:]), rel=1e-6)
    assert settled.position_error < 0.02 < np.median(flown.error[:, :50])


def test_followers_fly_in_each_episode_what_their_leader_flies_in_the_nominal_simulator(simulator):
    """Where the leader has come to after 3 s, from starts that differ, the followers come to."""
    task, nominal = Hold(horizon=150, goal=(0.5, 0.1, 0.4), jitter=0.1), SIMULATORS["point_mass"]
    leader = Tracking(task, PDTracker(kp=2.0, kd=2.0))
    keys = evaluation_keys(SEED, EPISODES)
    led = np.asarray(fly(task, nominal, leader, keys).flight.pos)
    team = Followers(task, nominal, leader)
    followed = np.asarray(fly(task, simulator, team, keys).flight.pos)
    assert np.abs(led[0] - led[1]).max() > 0.02
    assert np.linalg.norm(led[:, -1] - led[:, 0], axis=-1).min() > 0.4
    assert np.linalg.norm(led[:, -1] - followed[:, -1], axis=-1).max() < 0.05
    deployed = evaluate(task, simulator, team, SEED, EPISODES)
    alone = evaluate(task, nominal, leader, SEED, EPISODES)
    assert deployed.rewards.std() > 0.0
    assert deployed.reward == pytest.approx(alone.reward, rel=0.2)


# --- A team that stays where it is ------------------------------------------------------------


OURS = [task(n_drones=3, horizon=40) for task in (Circle, Figure8, PitchAndExpand, Spread)]


# Spread draws where its targets are; the others run the same lines as the task of these tests.
@pytest.mark.parametrize(
    "task",
    [
        *(pytest.param(task, marks=pytest.mark.exhaustive) for task in OURS[:3]),
        OURS[3],
        dataclasses.replace(TASK, altitude=0.0),
    ],
    ids=lambda task: type(task).__name__,
)
def test_standing_is_what_a_team_gets_that_does_not_lift_off(task):
    """In the point mass on a floor, motors off; over all steps and the initial states."""
    floor = with_effects(PointMass(), [Floor(height=0.0)])
    off = OpenLoop(jnp.zeros((40, 3, 3)).at[:, :, 2].set(-1.0))
    flown = fly(task, floor, off, evaluation_keys(SEED, EPISODES))
    np.testing.assert_array_equal(flown.flight.pos[..., 2], 0.0)
    found = standing_rewards(task, SEED, EPISODES)
    np.testing.assert_allclose(found, np.asarray(flown.reward).mean(axis=2), rtol=1e-5, atol=1e-6)
    other = standing_rewards(task, 1000, EPISODES)
    assert np.abs(found - other).max() > 1e-3
