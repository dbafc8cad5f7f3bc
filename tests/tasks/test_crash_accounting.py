"""Crashes and contact steps of an episode, counted again from stored positions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import KEY, SIMULATORS, TASKS

from simulators.tracking import PDTracker
from simulators.vehicle import CONTROL_DT
from tasks.contract import TaskState
from tasks.rollout import episode, record

HORIZON = 250
# All counting is in `tasks/`: `make test` has it in the point mass.
TWINS = ["point_mass", pytest.param("crazyflow", marks=pytest.mark.exhaustive)]


class Choreography(eqx.Module):
    """Drones 0 and 1 swing through each other, drone 2 hovers and is dropped after `drop` [s]."""

    drop: float = 3.0

    def __call__(self, state: TaskState):
        time = CONTROL_DT * state.step
        swing = jnp.cos(2.5 * time)
        goal = jnp.stack(
            [
                jnp.stack([0.8 * swing, 0 * swing, 0 * swing + 1.0]),
                jnp.stack([-0.8 * swing, 0 * swing, 0 * swing + 1.0]),
                jnp.asarray([0.0, 3.0, 0.5]),
            ]
        )
        zero = jnp.zeros_like(goal)
        action, _ = PDTracker().action(state.flight, goal, zero, zero)
        return action.at[2, 2].set(jnp.where(time > self.drop, -1.0, action[2, 2]))


@pytest.fixture(scope="module", params=TWINS)
def flown(request):
    """Sums and record of the same episode."""
    task, simulator = TASKS["spread"](n_drones=3, horizon=HORIZON), SIMULATORS[request.param]()
    fly = [eqx.filter_jit(f)(task, simulator, Choreography(), KEY) for f in (episode, record)]
    return request.param, *fly


def recount(pos):
    """(crashes per drone, steps with any contact), by the words of `tasks/contact.py`."""
    touched, crashes, contact_steps = [False] * pos.shape[1], np.zeros(pos.shape[1], int), 0
    for k in range(len(pos)):
        now = []
        for i, here in enumerate(pos[k]):
            others = [np.linalg.norm(here - p) for j, p in enumerate(pos[k]) if j != i]
            on_floor = here[2] <= 0.0 and round((k + 1) * CONTROL_DT, 6) > 0.5
            now.append(min(others) < 0.30 or on_floor)
        crashes += [is_now and not before for is_now, before in zip(now, touched, strict=True)]
        contact_steps += any(now)
        touched = now
    return crashes, contact_steps


def test_the_episodes_sums_equal_a_recount_from_positions(flown):
    _, sums, rec = flown
    crashes, contact_steps = recount(np.asarray(rec.flight.pos, float))
    assert float(sums.crashes) == crashes.sum()
    assert float(sums.contact_steps) == contact_steps


def test_the_choreography_crashes_as_it_was_made_to(flown):
    """The pair meets every half turn and both count; the dropped drone crashes once."""
    _, _, rec = flown
    crashes, contact_steps = recount(np.asarray(rec.flight.pos, float))
    assert crashes[0] == crashes[1] >= 2
    assert crashes[2] == 1
    assert 20 < contact_steps < HORIZON


def test_the_records_rewards_sum_to_the_episodes_return(flown):
    _, sums, rec = flown
    assert float(sums.reward) == pytest.approx(float(rec.reward.mean(axis=1).sum()), rel=1e-4)


def test_entry_k_of_a_record_is_the_state_after_action_k(flown):
    """Replaying the recorded actions gives the recorded flight."""
    name, _, rec = flown
    task, simulator = TASKS["spread"](n_drones=3, horizon=HORIZON), SIMULATORS[name]()

    @eqx.filter_jit
    def replay(actions):
        state = simulator.reset(task.reset(jax.random.split(KEY)[0])[0], KEY)

        def step(state, action):
            state = simulator.step(state, action)
            return state, simulator.flight(state).pos

        return jax.lax.scan(step, state, actions)[1]

    np.testing.assert_allclose(replay(rec.action), rec.flight.pos, atol=1e-3)


@pytest.mark.parametrize("name", TWINS)
def test_standing_on_the_ground_is_a_crash_only_after_the_grace_time(name):
    """Nobody lifts off: every drone crashes once, at the first step after 0.5 s."""
    task, simulator = TASKS["circle"](n_drones=2, horizon=50), SIMULATORS[name]()
    stay = lambda state: jnp.zeros((2, 3)).at[:, 2].set(-1.0)  # noqa: E731
    rec = eqx.filter_jit(lambda key: record(task, simulator, stay, key))(KEY)
    first = np.argmax(np.asarray(rec.contact), axis=0)
    np.testing.assert_array_equal(first, 25)
    assert np.asarray(rec.contact)[25:].all()
