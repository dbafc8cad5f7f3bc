"""Deployment: every number against a recount from the stored flights, any controller, effects."""

import equinox as eqx
import jax
import numpy as np
import pytest
from cells import SPEC, Hold, fresh, leaning, lift

from methods.evaluate import evaluate, evaluation_keys, fly
from methods.policy import PolicyController
from methods.reference_paths import Followers
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.mass import Mass
from simulators.point_mass import PointMass
from simulators.tracking import PDTracker
from simulators.vehicle import GRAVITY
from tasks.contract import AbstractTask

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


def test_initial_states_belong_to_the_seed_alone():
    """Level flight leaves x and y as they were drawn, whoever flies and whatever flies."""
    keys = evaluation_keys(SEED, EPISODES)
    spawns = np.stack([np.asarray(TASK.reset(jax.random.split(key)[0])[0]) for key in keys])
    for simulator in SIMULATORS.values():
        for excess in (-0.2, 0.1):
            pos = fly(TASK, simulator, lift(TASK, excess), keys).flight.pos
            np.testing.assert_allclose(pos[:, 0, :, :2], spawns[:, :, :2], atol=1e-6)
    assert np.abs(np.diff(spawns, axis=0)).max() > 0.01
    other = evaluation_keys(SEED + 1, EPISODES)
    assert not np.array_equal(jax.random.key_data(keys), jax.random.key_data(other))


def test_fewer_episodes_are_the_first_ones():
    few, many = (jax.random.key_data(evaluation_keys(SEED, n)) for n in (2, 32))
    np.testing.assert_array_equal(few, many[:2])


def test_evaluations_repeat_exactly(simulator, evaluation):
    again = evaluate(TASK, simulator, CONTROLLER, SEED, EPISODES)
    np.testing.assert_array_equal(again.rewards, evaluation.rewards)
    assert (again.crashes, again.position_error) == (evaluation.crashes, evaluation.position_error)


CALM = Hold(n_drones=2, horizon=150, goal=(0.3, 0.0, 0.2), spacing=(2.0, 2.0))


def test_a_tracking_controller_deploys_in_both_simulators(simulator):
    flown = fly(CALM, simulator, Tracking(CALM), evaluation_keys(SEED, 1))
    assert float(np.asarray(flown.error)[:, -1].max()) < 0.05
    assert not np.asarray(flown.contact).any()


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


def test_a_trained_policy_is_judged_in_worlds_it_was_not_trained_in():
    controller = PolicyController(TASK, fresh(TASK))
    worlds = [PointMass(), with_effects(PointMass(), [Mass(e=0.2)])]
    nominal, heavy = (evaluate(TASK, world, controller, SEED, EPISODES) for world in worlds)
    drop = nominal.trajectory["pos"][-1, :, 2] - heavy.trajectory["pos"][-1, :, 2]
    # Less acceleration by the nominal thrust over 6 m, for 0.8 s, the policy's reaction aside.
    assert (drop > 0.2).all()
    assert SPEC.mass == worlds[1].spec.mass  # what the controller believes stays nominal


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
