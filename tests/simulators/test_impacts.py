"""Balls that touch: MuJoCo with the linear law, closed forms and derivatives with ours."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq

from simulators.algebra import impacts
from simulators.algebra.impacts import Balls, Surface, damping_of, push

MASS, RADIUS, INERTIA = 0.0434, 0.15, 3e-5
STIFFNESS = 2000.0
# MuJoCo's stiffness and damping over the mass, as `solref = "-k -b"` takes them: 1/s^2 and 1/s.
LINEAR = (20000.0, 60.0)
GRAVITY = 9.81


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def surface(restitution=0.5, friction=0.0, clearance=0.0):
    return Surface(
        *(jnp.asarray(x, float) for x in (RADIUS, clearance, STIFFNESS)),
        damping_of(jnp.asarray(restitution)),
        jnp.asarray(friction),
    )


def balls(pos, vel):
    pos, vel = jnp.asarray(pos, float).T, jnp.asarray(vel, float).T
    n = pos.shape[1]
    turning = jnp.broadcast_to(jnp.eye(3)[:, :, None] / INERTIA, (3, 3, n))
    return Balls(pos, vel, jnp.zeros((3, n)), jnp.full(n, 1.0 / MASS), turning)


@eqx.filter_jit
def follow(start, made, dt, steps, law=None, gravity=0.0):
    """Teams after each step."""

    def step(now, _):
        force, torque = push(now, made, dt, law)
        acc = now.inverse_mass * force - gravity * jnp.asarray([[0.0], [0.0], [1.0]])
        vel = now.vel + dt * acc
        turned = now.ang_vel + dt * jnp.sum(now.inverse_inertia * torque, axis=1)
        pos = now.pos + 0.5 * dt * (now.vel + vel)
        now = dataclasses.replace(now, pos=pos, vel=vel, ang_vel=turned)
        return now, now

    return jax.lax.scan(step, start, length=steps)[1]


def linear(gravity=0.0):
    """MuJoCo's law where its impedance is 1: the acceleration along the normal is -k r - b r'."""

    def law(depth, rate, inverse_mass, step):
        acc = LINEAR[0] * depth + LINEAR[1] * rate + gravity
        return jnp.where(depth > 0.0, jnp.maximum(acc, 0.0) / inverse_mass, 0.0)

    return law


def in_mujoco(pos, vel, dt, steps, gravity=0.0, floor=False):
    """Positions and velocities after each step in MuJoCo C."""
    contact = f'solref="{-LINEAR[0]} {-LINEAR[1]}" solimp="0.9999 0.9999 0.001 0.5 2" condim="1"'
    bodies = "".join(
        f'<body pos="{x} {y} {z}"><freejoint/>'
        f'<geom type="sphere" size="{RADIUS}" mass="{MASS}" {contact}/></body>'
        for x, y, z in pos
    )
    plane = f'<geom type="plane" size="9 9 1" {contact}/>' if floor else ""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt}" gravity="0 0 {-gravity}" iterations="100" '
        f'tolerance="1e-12"/><worldbody>{plane}{bodies}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qvel.reshape(-1, 6)[:, :3] = vel
    found = []
    for _ in range(steps):
        mujoco.mj_step(model, data)
        rows = data.qpos.reshape(-1, 7), data.qvel.reshape(-1, 6)
        found.append(tuple(x[:, :3].copy() for x in rows))
    return tuple(np.stack(x) for x in zip(*found, strict=True))


@pytest.mark.parametrize(("speed", "aside"), [(0.5, 0.0), (2.0, 0.1), (1.0, 0.2)])
def test_the_linear_law_gives_mujocos_impacts(speed, aside):
    """Head on and oblique: positions to 1e-3 of the radius, velocities to 1e-3 of the speed."""
    pos = [[0.0, 0.0, 1.0], [0.35, aside, 1.0]]
    vel = [[speed, 0.0, 0.0], [-0.2 * speed, 0.0, 0.0]]
    dt = 2e-5
    steps = round(0.3 / speed / dt)
    theirs = in_mujoco(pos, vel, dt, steps)
    ours = follow(balls(pos, vel), surface(), dt, steps, linear())
    assert np.abs(theirs[1][-1] - vel).max() > 0.3 * speed
    np.testing.assert_allclose(ours.pos[-1].T, theirs[0][-1], atol=1e-3 * RADIUS)
    np.testing.assert_allclose(ours.vel[-1].T, theirs[1][-1], atol=1e-3 * speed)


def test_the_linear_law_gives_mujocos_drop_on_the_floor():
    """More than once: the second impact shows what the first has left."""
    dt, drop = 2e-5, 0.2
    steps = round(0.7 / dt)
    theirs = in_mujoco([[0, 0, RADIUS + drop]], [[0, 0, 0]], dt, steps, GRAVITY, floor=True)
    start = balls([[0, 0, RADIUS + drop]], [[0, 0, 0]])
    made = surface(clearance=RADIUS)
    ours = follow(start, made, dt, steps, linear(GRAVITY), GRAVITY)
    up = np.diff(np.sign(theirs[1][:, 0, 2])) > 0
    assert up.sum() >= 2
    np.testing.assert_allclose(ours.pos[:, 2, 0], theirs[0][:, 0, 2], atol=1e-3 * drop)


def test_cradles_and_piles_differ_from_mujoco():
    """The figures of docs/contact.md: MuJoCo solves all contacts of a step at once."""
    dt, apart = 2e-5, 2.0 * RADIUS
    pos = [[0.05 * (i > 0) + i * apart, 0.0, 1.0] for i in range(4)]
    vel = [[1.0, 0.0, 0.0], *[[0.0, 0.0, 0.0]] * 3]
    theirs = in_mujoco(pos, vel, dt, 12_500)[1][-1][:, 0]
    ours = follow(balls(pos, vel), surface(), dt, 12_500, linear()).vel[-1, 0]
    np.testing.assert_allclose(theirs, [-0.167, 0.389, 0.389, 0.389], atol=2e-3)
    np.testing.assert_allclose(ours, [-0.016, 0.070, 0.330, 0.616], atol=2e-3)
    np.testing.assert_allclose([theirs.sum(), ours.sum()], 1.0, atol=1e-9)  # momentum

    # One ball falls 0.1 m onto three that lie on the floor, 1 mm between them.
    a = apart + 1e-3
    low = np.array([[0.0, 0.0, RADIUS], [a, 0.0, RADIUS], [a / 2, a * np.sqrt(0.75), RADIUS]])
    top = np.array([0.0, 0.0, a * np.sqrt(2 / 3) + 0.1])
    pile = [*low, low.mean(axis=0) + top]
    theirs = in_mujoco(pile, np.zeros((4, 3)), dt, 10_000, GRAVITY, floor=True)[1][-1]
    start = balls(pile, np.zeros((4, 3)))
    made = surface(clearance=RADIUS)
    ours = follow(start, made, dt, 10_000, linear(GRAVITY), GRAVITY).vel[-1].T
    aside = [np.linalg.norm(np.asarray(x)[:3, :2], axis=1) for x in (theirs, ours)]
    np.testing.assert_allclose(aside[0], 0.496, atol=2e-3)
    np.testing.assert_allclose(aside[1], 0.441, atol=2e-3)
    np.testing.assert_allclose([theirs[3, 2], ours[3, 2]], [0.060, -0.150], atol=2e-3)


def closed_form(restitution, rate):
    """Share of the rate that is left of an impact, whose damping keeps `restitution` at 1 m/s."""
    left = lambda y, e: y - np.log1p(y) + e * y + np.log1p(-e * y)  # noqa: E731
    c = brentq(lambda y: left(y, restitution), 1e-6, (1.0 - 1e-12) / restitution)
    return brentq(lambda e: left(c * rate, e), 1e-6, min(1.0, (1.0 - 1e-12) / (c * rate)))


@pytest.mark.parametrize("rate", [0.4, 1.0, 3.0])
@pytest.mark.parametrize("restitution", [0.1, 0.3, 0.6, 0.95])
def test_restitution_follows_the_closed_form(restitution, rate):
    start = balls([[0, 0, 1], [0.301, 0, 1]], [[rate, 0, 0], [0, 0, 0]])
    end = follow(start, surface(restitution), 1e-4, 3000).vel[-1]
    assert float(end[0, 1] - end[0, 0]) == pytest.approx(
        closed_form(restitution, rate) * rate, rel=2e-3
    )


def test_an_elastic_impact_keeps_its_speed():
    start = balls([[0, 0, 1], [0.301, 0, 1]], [[1.0, 0, 0], [0, 0, 0]])
    end = follow(start, surface(1.0), 1e-3, 200).vel[-1]
    np.testing.assert_allclose(end[0], [0.0, 1.0], atol=1e-3)


def heap():
    """Six balls that fly at each other and spin."""
    keys = jax.random.split(jax.random.key(0), 3)
    pos = jax.random.uniform(keys[0], (6, 3), minval=-0.5, maxval=0.5) + 3.0
    start = balls(pos, -3.0 * (pos - 3.0))
    return eqx.tree_at(lambda b: b.ang_vel, start, jax.random.normal(keys[1], (3, 6)))


def momentum(now):
    """Linear and angular momentum, kg m/s and kg m^2/s."""
    linear = MASS * now.vel
    angular = jnp.cross(now.pos, linear, axis=-2) + INERTIA * now.ang_vel
    return jnp.sum(linear, axis=-1), jnp.sum(angular, axis=-1)


def energy(now, made):
    """Of motion and of what is pressed, J."""
    motion = 0.5 * MASS * jnp.sum(now.vel**2, axis=(-2, -1))
    motion += 0.5 * INERTIA * jnp.sum(now.ang_vel**2, axis=(-2, -1))
    apart = jnp.linalg.norm(now.pos[..., :, None] - now.pos[..., None, :], axis=-3)
    n = apart.shape[-1]
    depth = jnp.where(jnp.eye(n, dtype=bool), 0.0, jnp.maximum(2.0 * made.radius - apart, 0.0))
    return motion + 0.5 * 0.4 * made.stiffness * jnp.sum(depth**2.5, axis=(-2, -1))


def test_momentum_is_kept_to_rounding():
    start, made = heap(), surface(0.5, 0.4)
    flown = follow(start, made, 1e-3, 400)
    assert jnp.abs(flown.vel[-1] - start.vel).max() > 0.5
    before, after = momentum(start), momentum(flown)
    np.testing.assert_allclose(after[0], jnp.broadcast_to(before[0], (400, 3)), atol=1e-14)
    np.testing.assert_allclose(after[1], jnp.broadcast_to(before[1], (400, 3)), atol=1e-13)


@pytest.mark.parametrize(("restitution", "friction"), [(0.1, 0.0), (0.6, 0.4), (0.95, 0.0)])
def test_energy_never_grows(restitution, friction):
    """Beyond the step's own error, which falls with its square."""
    made, growth = surface(restitution, friction), []
    for dt in (4e-4, 1e-4):
        start = heap()
        now = energy(follow(start, made, dt, round(0.4 / dt)), made)
        run = jnp.concatenate([energy(start, made)[None], now])
        lost = 1.0 - float(run[-1] / run[0])
        growth.append(float(jnp.max(run[1:] - jax.lax.cummin(run)[:-1]) / run[0]))
        assert lost > (0.02 if restitution > 0.9 else 0.2)
    assert growth[0] < 2e-4
    assert growth[1] < 2e-5


def left_of(distance, dt, law=None):
    """Velocity of the ball that is hit from `distance` away [m]."""
    start = balls([[0, 0, 1], [0.3, 0, 1]], [[1.0, 0, 0], [0, 0, 0]])
    start = eqx.tree_at(lambda b: b.pos, start, start.pos.at[0, 1].add(distance))
    return follow(start, surface(0.7), dt, round(0.15 / dt), law).vel[-1, 0, 1]


def rms_slope(dt, law=None):
    """Of the velocity by the distance, over places in two steps; the truth is 0."""
    places = 0.005 + jnp.linspace(0.0, 2.0 * dt, 37)[:-1]
    slopes = jax.jit(jax.vmap(jax.grad(lambda x: left_of(x, dt, law))))(places)
    return float(jnp.sqrt(jnp.mean(slopes**2)))


def test_the_slope_by_the_distance_vanishes_with_the_step():
    ours = [rms_slope(dt) for dt in (2e-3, 1e-4)]
    assert ours[0] < 3.0
    assert ours[1] < 0.25 * ours[0]
    # A damper that acts in full at touch gives slopes that no step improves.
    theirs = [rms_slope(dt, linear()) for dt in (2e-3, 1e-4)]
    assert min(theirs) > 10.0 * ours[0]


def test_derivatives_equal_finite_differences():
    """By places and velocities, through oblique impacts with friction."""
    n, made = 4, surface(0.5, 0.4, clearance=0.05)
    keys = jax.random.split(jax.random.key(3), 3)
    pos = 0.4 * jax.random.uniform(keys[0], (n, 3)) + jnp.asarray([0.0, 0.0, 0.2])
    first = jnp.concatenate([pos, -3.0 * (pos - pos.mean(axis=0))]).at[n:, 2].add(-1.0)
    weights = jax.random.normal(keys[2], (2, 3, n))

    def end(start):
        last = jax.tree.map(lambda x: x[-1], follow(balls(start[:n], start[n:]), made, 1e-3, 250))
        return jnp.sum(weights * jnp.stack([last.pos, last.vel]))

    exact = jax.jit(jax.grad(end))(first)
    value, h = jax.jit(end), 1e-6
    for i, j in np.ndindex(first.shape):
        unit = jnp.zeros_like(first).at[i, j].set(h)
        numeric = (value(first + unit) - value(first - unit)) / (2.0 * h)
        assert float(exact[i, j]) == pytest.approx(float(numeric), rel=1e-4, abs=1e-4)


def test_friction_stops_a_slip_and_never_turns_it_round():
    """Two balls pass with strong friction: their surfaces come to rest on each other."""
    start = balls([[0, 0, 1], [0.29, 0, 1]], [[0.5, 1.0, 0], [-0.5, -1.0, 0]])
    end = follow(start, surface(0.5, 1.0), 2e-3, 30)
    normal = jnp.asarray([-1.0, 0.0, 0.0])
    rolling = RADIUS * jnp.cross(end.ang_vel.sum(axis=-1), normal)
    slip = end.vel[:, 1, 0] - end.vel[:, 1, 1] - rolling[:, 1]
    assert float(slip.min()) > -0.1
    assert float(jnp.abs(slip[-1])) < 0.3


def test_balls_at_one_place_give_finite_forces_and_slopes():
    def force(pos):
        return jnp.sum(push(balls(pos, jnp.zeros((2, 3))), surface(), 2e-3)[0] ** 2)

    pos = jnp.ones((2, 3))
    assert jnp.isfinite(jax.jit(jax.value_and_grad(force))(pos)[1]).all()


# `MANY` is patched to the number of balls, so that both run the same lines.
@pytest.mark.parametrize("n", [64, pytest.param(150, marks=pytest.mark.exhaustive)])
def test_sweeps_find_what_all_pairs_show(monkeypatch, n):
    """Forces, torques and slopes of crowds in which each drone touches up to twelve others."""
    pos = 0.3 * n ** (1 / 3) * jax.random.uniform(jax.random.key(1), (2, n, 3))
    vel = jax.random.normal(jax.random.key(2), (2, n, 3))
    made = surface(0.5, 0.4, clearance=0.05)

    def seen(pos, vel):
        both = lambda pos: push(balls(pos, vel), made, 5e-3)  # noqa: E731
        return both(pos), jax.grad(lambda pos: jnp.sum(both(pos)[0][0] ** 2))(pos)

    apart = np.linalg.norm(np.asarray(pos)[:, :, None] - np.asarray(pos)[:, None], axis=-1)
    assert 6 <= (apart < 2 * RADIUS).sum(axis=-1).max() - 1 <= impacts.NEIGHBOURS
    monkeypatch.setattr(impacts, "MANY", n)
    swept = jax.jit(jax.vmap(seen))(pos, vel)
    monkeypatch.setattr(impacts, "MANY", n + 1)
    paired = jax.jit(jax.vmap(lambda pos, vel: seen(pos, vel)))(pos, vel)
    for one, other in zip(jax.tree.leaves(swept), jax.tree.leaves(paired), strict=True):
        assert float(jnp.abs(other).max()) > 0.0
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
