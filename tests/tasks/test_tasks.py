"""The contract of every registered task."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import (
    KEY,
    SIMULATORS,
    TASKS,
    assert_near,
    fly,
    hovering,
    positions,
    random_cmds,
    restore,
)

from simulators.algebra.rotation import quat_to_rpy, rpy_to_quat
from simulators.flight import Flight
from tasks.contact import in_contact
from tasks.contract import TaskState

SIZES = [2, 3, 5, 18]
every_task = pytest.mark.parametrize("name", TASKS)
every_size = pytest.mark.parametrize("n_drones", SIZES)


@eqx.filter_jit
def random_state(task, key=KEY):
    """A team in flight, nobody near a tie of distances or the singular middle of a task."""
    keys = jax.random.split(key, 4)
    n = task.n_drones
    turn, out, up = jax.random.uniform(keys[2], (3, n), maxval=2.0)
    angle = jnp.pi * turn
    pos = jnp.stack([(2 + out) * jnp.cos(angle), (2 + out) * jnp.sin(angle), up], axis=-1)
    rpy = jax.random.uniform(keys[1], (n, 3), minval=-0.3, maxval=0.3)
    flight = Flight(
        t=jnp.asarray(2.0),
        pos=pos,
        vel=jax.random.normal(keys[3], (n, 3)),
        quat=rpy_to_quat(rpy),
        ang_vel=jnp.zeros((n, 3)),
        thrust=jnp.full(n, 0.4),
        torque=jnp.zeros((n, 3)),
    )
    return TaskState(flight, task.reset(keys[0])[1], jnp.asarray(100))


@eqx.filter_jit
def everything(task, state):
    """Observations, both rewards and errors."""
    return task.observe(state), task.rewards(state), task.error(state)


assert_close = functools.partial(assert_near, rtol=1e-4, atol=1e-5)


@every_task
@every_size
@pytest.mark.parametrize("observe_attitude", [False, True])
def test_every_quantity_has_one_row_per_drone(name, n_drones, observe_attitude):
    task = TASKS[name](n_drones=n_drones, observe_attitude=observe_attitude)
    state = eqx.filter_eval_shape(random_state, task)
    shape = lambda fn: jax.tree.map(lambda x: x.shape, jax.eval_shape(fn, state))  # noqa: E731
    assert shape(task.observe) == (n_drones, task.obs_size)
    target = shape(lambda s: jax.tree.map(jnp.asarray, vars(task.target(s))))
    slacks = {target.pop(name) for name in ("slack", "vel_slack")}
    assert target == dict.fromkeys(("offset", "vel", "acc"), (n_drones, 3))
    assert slacks <= {(), (n_drones,)}
    assert shape(task.error) == (n_drones,)
    assert shape(task.rewards) == ((n_drones,), (n_drones,))
    assert task.obs_size == TASKS[name]().obs_size + 2 * observe_attitude


@every_task
def test_jit_equals_eager(name):
    task = TASKS[name](n_drones=5)
    state = random_state(task)
    eager = task.observe(state), task.rewards(state), task.error(state)
    assert_close(everything(task, state), eager)


@every_task
def test_vmap_over_worlds_equals_a_loop(name):
    task = TASKS[name](n_drones=5)
    states = [random_state(task, jax.random.key(seed)) for seed in range(3)]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *states)
    batched = eqx.filter_jit(eqx.filter_vmap(everything, in_axes=(None, 0)))(task, stacked)
    for i, state in enumerate(states):
        assert_close(jax.tree.map(lambda x, i=i: x[i], batched), everything(task, state))


@every_task
def test_the_same_key_gives_the_same_episode_and_another_key_another(name):
    task = TASKS[name]()
    same = [jax.tree.leaves(task.reset(KEY)) for _ in range(2)]
    assert eqx.tree_equal(same[0], same[1])
    assert not eqx.tree_equal(same[0], jax.tree.leaves(task.reset(jax.random.key(1))))


@every_task
@pytest.mark.parametrize("crowding", [1.0, 0.1])
def test_renumbering_the_drones_renumbers_observations_rewards_and_errors(name, crowding):
    """Apart, and so close together that they touch."""
    task = TASKS[name](n_drones=5)
    state, order = random_state(task), jnp.asarray([3, 0, 4, 2, 1])
    state = eqx.tree_at(lambda s: s.flight.pos, state, crowding * state.flight.pos)
    flight = jax.tree.map(lambda x: x[order] if x.ndim else x, state.flight)
    goal = state.goal[order] if name == "spread" else state.goal
    renumbered = TaskState(flight, goal, state.step)
    expected = jax.tree.map(lambda x: x[order], everything(task, state))
    assert_close(everything(task, renumbered), expected)
    assert bool(in_contact(state.flight.pos, state.flight.t).any()) == (crowding < 1)


@every_task
@every_size
def test_teams_spawn_on_the_ground_out_of_contact(name, n_drones):
    task = TASKS[name](n_drones=n_drones)
    pos = jax.jit(jax.vmap(lambda k: task.reset(k)[0]))(jax.random.split(KEY, 100))
    apart = jnp.linalg.norm(pos[:, :, None] - pos[:, None], axis=-1)
    apart = apart + 10.0 * jnp.eye(n_drones)
    assert pos.shape == (100, n_drones, 3)
    assert not pos[..., 2].any()
    assert float(apart.min()) > 0.30
    assert float(jnp.abs(pos.mean(axis=(0, 1))).max()) < 0.2


@every_task
def test_a_drone_at_its_target_gets_the_largest_task_reward(name):
    task = TASKS[name](n_drones=3)
    best = task.task_reward(jnp.zeros(3), jnp.zeros(3))
    np.testing.assert_allclose(best, 0.0, atol=1e-6)
    for distance, vel_error in ((0.5, 0.0), (0.0, 0.5), (0.5, 0.5)):
        worse = task.task_reward(jnp.full(3, distance), jnp.full(3, vel_error))
        assert (worse <= best).all()
    assert (task.task_reward(jnp.full(3, 0.5), jnp.zeros(3)) < -0.4).all()


@every_task
def test_moving_by_the_offset_satisfies_the_task(name):
    """The offset points to the nearest right place: from there it is zero."""
    task = TASKS[name](n_drones=3)
    state = random_state(task)
    there = state.flight.pos + task.target(state).offset
    moved = eqx.tree_at(lambda s: s.flight.pos, state, there)
    np.testing.assert_allclose(task.error(moved), 1e-3, atol=5e-4)
    steps = jnp.linalg.norm(task.target(state).offset, axis=-1)
    np.testing.assert_allclose(task.error(state), steps, atol=2e-3)


@pytest.mark.parametrize("name", ["figure8", "pitchandexpand"])
def test_the_targets_velocity_is_the_rate_of_its_motion(name):
    """Against the change of the offset of a drone that stands still, along its direction."""
    task = TASKS[name](n_drones=3)
    state = random_state(task)
    later = eqx.tree_at(lambda s: s.step, state, state.step + 1)
    moved = (task.target(later).offset - task.target(state).offset) / 0.02
    target = task.target(state)
    away = target.offset / jnp.linalg.norm(target.offset, axis=-1, keepdims=True)
    if name == "figure8":  # the ring's nearest point slides along the ring: project onto the offset
        moved, expected = ((x * away).sum(-1) for x in (moved, target.vel))
    else:
        expected = target.vel
    np.testing.assert_allclose(moved, expected, atol=0.08)


@every_task
def test_the_targets_acceleration_is_the_rate_of_its_velocity(name):
    """That of a drone which is where it should be, a step earlier and a step later."""
    task = TASKS[name](n_drones=3)
    state = random_state(task)
    there = state.flight.pos + task.target(state).offset
    on = eqx.tree_at(lambda s: s.flight.pos, state, there)
    target = task.target(on)

    def vel(steps):
        pos = there + 0.02 * steps * target.vel
        at = (pos, state.step + steps)
        return task.target(eqx.tree_at(lambda s: (s.flight.pos, s.step), state, at)).vel

    np.testing.assert_allclose((vel(1) - vel(-1)) / 0.04, target.acc, atol=0.03)


@pytest.mark.parametrize("name", ["circle"])
def test_the_targets_velocity_is_tangential(name):
    task = TASKS[name](n_drones=3)
    state = random_state(task)
    vel, pos = task.target(state).vel, state.flight.pos
    np.testing.assert_allclose((vel[:, :2] * pos[:, :2]).sum(-1), 0.0, atol=1e-6)
    np.testing.assert_allclose(jnp.linalg.norm(vel, axis=-1), 1.0, atol=1e-4)
    assert (pos[:, 0] * vel[:, 1] - pos[:, 1] * vel[:, 0] > 0).all()


@pytest.mark.parametrize("n_drones", SIZES)
def test_landmarks_of_spread_are_on_a_circle_and_out_of_contact(n_drones):
    task = TASKS["spread"](n_drones=n_drones)
    landmarks = task.reset(KEY)[1]
    np.testing.assert_allclose(jnp.linalg.norm(landmarks[:, :2], axis=-1), task.radius, rtol=1e-5)
    apart = jnp.linalg.norm(landmarks[:, None] - landmarks[None], axis=-1)
    assert float((apart + 10 * jnp.eye(n_drones)).min()) > 0.6


@every_task
def test_neighbours_are_the_nearest_in_order(name):
    task = TASKS[name](n_drones=5, n_neighbors=2)
    state = random_state(task)
    pos, vel = np.asarray(state.flight.pos), np.asarray(state.flight.vel)
    seen = np.asarray(task.observe(state))[:, -12:].reshape(5, 2, 6)
    for i in range(5):
        squared = ((pos - pos[i]) ** 2).sum(-1)
        for slot, j in enumerate(np.argsort(squared)[1:3]):
            expected = np.concatenate([pos[j] - pos[i], vel[j] - vel[i]]) / (0.25 + squared[j])
            np.testing.assert_allclose(seen[i, slot], expected, rtol=1e-4, atol=1e-6)


@every_task
def test_places_of_neighbours_that_a_small_team_lacks_are_zero(name):
    task = TASKS[name](n_drones=2, n_neighbors=3)
    obs = task.observe(random_state(task))
    assert obs[:, -18:-12].all()
    assert not obs[:, -12:].any()


@every_task
def test_observations_start_with_the_way_to_the_target(name):
    """Offset, velocity error, own velocity; then, if asked for, roll and pitch of the attitude."""
    task = TASKS[name](n_drones=3, observe_attitude=True, n_neighbors=0)
    state = random_state(task)
    target, flight, obs = task.target(state), state.flight, task.observe(state)
    np.testing.assert_allclose(obs[:, :3], target.offset, rtol=1e-6)
    np.testing.assert_allclose(obs[:, 3:6], target.vel - flight.vel, rtol=1e-6)
    np.testing.assert_allclose(obs[:, 6:9], flight.vel)
    np.testing.assert_allclose(obs[:, 9:12], target.acc, rtol=1e-6)
    np.testing.assert_allclose(obs[:, -2:], quat_to_rpy(flight.quat)[:, :2], rtol=1e-5)


@every_task
def test_observations_do_not_depend_on_the_simulator(name):
    """A flight of crazyflow, and the same flight put into the point mass."""
    task = TASKS[name](n_drones=3, observe_attitude=True)
    high, low = SIMULATORS["crazyflow"](), SIMULATORS["point_mass"]()
    flown = fly(high, hovering(high, positions(3)), random_cmds(0, 50, 3))
    record = jax.tree.map(lambda x: x[-1], flown)
    same = low.flight(restore(low, record, random_cmds(0, 50, 3)))
    state = random_state(task)
    seen = [everything(task, eqx.tree_at(lambda s: s.flight, state, f)) for f in (record, same)]
    assert_close(seen[0], seen[1])


@every_task
@pytest.mark.parametrize(
    ("field", "value", "low"), [("n_drones", 1, 2), ("horizon", 0, 1), ("n_neighbors", -1, 0)]
)
def test_a_field_below_its_least_value_is_refused(name, field, value, low):
    with pytest.raises(ValueError, match=f"`{field}` must be at least {low}, got {value}."):
        TASKS[name](**{field: value})


@every_task
def test_episodes_last_10_s(name):
    assert TASKS[name]().horizon == 500
