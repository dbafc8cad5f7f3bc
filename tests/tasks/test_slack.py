"""Near a centre or an axis: nobody is paid for being there, and slopes stay bounded."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import KEY, TASKS, hover_flight

from tasks import contact
from tasks.circle import Circle
from tasks.contract import CORE, TaskState
from tasks.figure8 import Figure8
from tasks.pitchandexpand import PitchAndExpand

SMOOTH = 1e-3
"""What the tasks' norm makes of zeros [m]; within `CORE` it counts radius / CORE times."""
STEPS = (0, 60, 137)
CENTERED = ("circle", "figure8", "pitchandexpand")
"""Tasks whose target is a ring or a sphere around a centre."""
CASES = [
    # `make test` has a team of two.
    pytest.param(name, n_drones, marks=[pytest.mark.exhaustive] if n_drones == 18 else [])
    for name in CENTERED
    for n_drones in (2, 18)
]
every_case = pytest.mark.parametrize(("name", "n_drones"), CASES)


def make(name, n_drones, vel_weight=0.5):
    return TASKS[name](n_drones=n_drones, vel_weight=vel_weight)


def geometry(task, goal, step):
    """Centre, radius [m], and the velocity [m/s] asked for as a function of the unit vectors."""
    t = 0.02 * step
    if isinstance(task, Circle):
        tangent = lambda u: task.speed * np.stack([-u[:, 1], u[:, 0], 0.0 * u[:, 0]], axis=-1)  # noqa: E731
        return np.array([0.0, 0.0, task.altitude]), task.radius, tangent
    s = 2.0 * np.pi * t / task.period + float(goal)
    if isinstance(task, Figure8):
        a, rate = task.amplitude, 2.0 * np.pi / task.period
        center = np.array([a * np.sin(s), 0.5 * a * np.sin(2.0 * s), task.altitude])
        vel = rate * a * np.array([np.cos(s), np.cos(2.0 * s), 0.0])
        return center, task.radius, lambda u: np.broadcast_to(vel, u.shape)
    center = np.array([0.0, 0.0, task.radius + task.amplitude + task.clearance])
    growth = 2.0 * np.pi / task.period * task.amplitude * np.cos(s)
    return center, task.radius + task.amplitude * np.sin(s), lambda u: growth * u


def is_sphere(task):
    return isinstance(task, PitchAndExpand)


def units(task, relative):
    """Unit vectors away from the centre or axis; at it itself, the first axis as good as any."""
    flat = relative if is_sphere(task) else relative * np.array([1.0, 1.0, 0.0])
    size = np.linalg.norm(flat, axis=-1, keepdims=True)
    first = np.array([1.0, 0.0, 0.0])
    return np.where(size > 0.0, flat / np.where(size > 0.0, size, 1.0), first)


def true_distance(task, relative, radius):
    """From the drone to the ring or sphere [m]."""
    if is_sphere(task):
        return np.abs(radius - np.linalg.norm(relative, axis=-1))
    flat = np.linalg.norm(relative[:, :2], axis=-1)
    return np.hypot(radius - flat, relative[:, 2])


def places(task):
    """Places relative to the centre [m]: anywhere, and within `CORE` of it, itself included."""
    rng = np.random.default_rng(0)
    far = rng.normal(size=(60, 3)) * [1.5, 1.5, 0.8]
    near = rng.normal(size=(60, 3))
    near = units(task, near) * CORE * rng.uniform(size=(60, 1))
    if not is_sphere(task):
        near[30:, 2] = rng.normal(size=30)  # around the axis, above and below the plane
    return np.concatenate([far, near, np.zeros((1, 3)), [[0.0, 0.0, 1e-3]]])


@eqx.filter_jit
def looked_at(task, goal, step, pos, vel):
    """(rewards without the collision penalty, errors, offsets) of one drone at each of the places.

    The rest of the team is far away and at rest.
    """

    def one(pos, vel):
        others = 50.0 + 10.0 * jnp.arange(task.n_drones - 1)
        team = jnp.zeros((task.n_drones, 3)).at[1:, 0].set(others).at[0].set(pos)
        flight = hover_flight(team, jnp.zeros_like(team).at[0].set(vel))
        state = TaskState(flight, goal, step)
        paid = task.rewards(state)[0] + contact.penalty(team)
        return paid[0], task.error(state)[0], task.target(state).offset[0]

    return jax.vmap(one)(pos, vel)


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def paid_and_reported(name, n_drones, step, relative, vel=None):
    """The task, its geometry, and distances paid and reported, velocity errors paid."""
    task, unpaid = make(name, n_drones), make(name, n_drones, vel_weight=0.0)
    goal = task.reset(KEY)[1]
    center, radius, asked = geometry(task, goal, step)
    relative = relative(task)
    vel = np.zeros_like(relative) if vel is None else vel
    given = (goal, jnp.asarray(step), jnp.asarray(center + relative), jnp.asarray(vel))
    reward, error, _ = looked_at(task, *given)
    distance = -looked_at(unpaid, *given)[0]
    lost = np.asarray(-distance - reward) / task.vel_weight  # what the velocity costs
    vel_error = -np.log1p(-lost) if is_sphere(task) else lost
    return task, (relative, radius, asked), np.asarray(distance), np.asarray(error), vel_error


@every_case
@pytest.mark.parametrize("step", STEPS)
def test_nobody_is_paid_for_less_than_the_true_distance(name, n_drones, step):
    task, (relative, radius, _), paid, reported, _ = paid_and_reported(name, n_drones, step, places)
    true = true_distance(task, relative, radius)
    tolerance = SMOOTH * max(1.0, radius / CORE)
    np.testing.assert_allclose(paid, reported, rtol=1e-12)
    assert (reported >= true - tolerance).all()
    in_plane = np.ones(len(true), bool) if is_sphere(task) else relative[:, 2] == 0.0
    assert in_plane.sum() >= 30
    np.testing.assert_allclose(reported[in_plane], true[in_plane], atol=tolerance)
    outside = np.linalg.norm(relative[:, : 3 if is_sphere(task) else 2], axis=-1) > CORE
    np.testing.assert_allclose(reported[outside], true[outside], atol=1.1 * SMOOTH)


@every_case
@pytest.mark.parametrize("step", STEPS)
def test_nobody_is_paid_for_less_than_the_true_velocity_error(name, n_drones, step):
    """Against the unit vector away from the centre, at the centre against any."""
    vel = np.random.default_rng(1).normal(size=(122, 3))
    task, (relative, _, asked), _, _, found = paid_and_reported(
        name, n_drones, step, places, vel=vel
    )
    wanted = asked(units(task, relative))
    tolerance = SMOOTH * (1.0 + np.linalg.norm(wanted, axis=-1) / CORE)
    assert (found >= np.linalg.norm(wanted - vel, axis=-1) - tolerance).all()
    around = np.random.default_rng(2).normal(size=(40, 3))
    for u in units(task, around):
        at_center = np.linalg.norm(asked(u[None])[0] - vel[120])
        assert found[120] >= at_center - tolerance[120]


@every_case
@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "as asked"])
def test_pay_rises_all_the_way_from_the_centre_to_the_ring(name, n_drones, step, moving):
    def way(task):
        radius = geometry(task, task.reset(KEY)[1], step)[1]
        return np.linspace(0.0, radius, 122)[:, None] * np.array([[0.6, -0.8, 0.0]])

    task, (relative, radius, asked), distance, _, _ = paid_and_reported(name, n_drones, step, way)
    goal = task.reset(KEY)[1]
    vel = asked(np.broadcast_to([0.6, -0.8, 0.0], relative.shape)) * moving
    center = geometry(task, goal, step)[0]
    reward, *_ = looked_at(
        task, goal, jnp.asarray(step), jnp.asarray(center + relative), jnp.asarray(vel)
    )
    assert (np.diff(reward) > 0.0).all()
    assert reward[-1] - reward[0] > 0.98 * radius
    assert distance[0] > 0.98 * radius


@every_case
def test_slopes_near_the_centre_are_finite_bounded_and_those_of_differences(name, n_drones):
    """A direction turns by 1 / CORE a metre at most; so do the slacks."""
    task = make(name, n_drones)
    goal, step = task.reset(KEY)[1], jnp.asarray(60)
    center, radius, asked = geometry(task, goal, 60)
    u = units(task, np.random.default_rng(3).normal(size=(8, 3)))
    sizes = np.array([0.0, 1e-4, 1e-3, 1e-2, 0.1, 0.25, 0.29, 0.31])
    pos, vel = jnp.asarray(center + sizes[:, None] * u), jnp.asarray(0.7 * u[::-1])
    speed = np.linalg.norm(asked(u), axis=-1).max()

    @eqx.filter_jit
    def total(pos):
        return jnp.sum(looked_at(task, goal, step, pos, vel)[0])

    found, h = np.asarray(jax.grad(total)(pos)), 1e-7
    shifts = h * jnp.eye(pos.size).reshape(-1, *pos.shape)
    differences = (jax.vmap(total)(pos + shifts) - jax.vmap(total)(pos - shifts)) / (2.0 * h)
    np.testing.assert_allclose(found, differences.reshape(pos.shape), atol=1e-5)
    most = 1.0 + 2.0 * radius / CORE + task.vel_weight * 2.0 * speed / CORE
    assert np.linalg.norm(found, axis=-1).max() <= most

    def offset(pos):
        return looked_at(task, goal, step, pos[None], vel[:1])[2][0]

    turns = np.linalg.norm(jax.vmap(jax.jacrev(offset))(pos), ord=2, axis=(-2, -1))
    assert np.isfinite(turns).all()
    assert turns.max() <= 1.0 + radius / CORE


@pytest.mark.parametrize(
    ("name", "field"),
    [*((name, "vel_weight") for name in CENTERED), ("spread", "coverage_weight")],
)
def test_a_negative_weight_is_refused_by_name(name, field):
    with pytest.raises(ValueError, match=f"`{field}` must be at least 0, got -0.1"):
        TASKS[name](**{field: -0.1})
    assert getattr(TASKS[name](**{field: 0.0}), field) == 0.0
