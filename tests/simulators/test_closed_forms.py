"""Flights whose solution is known."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import (
    DT,
    HOVER,
    OWN_DRAG,
    SIMULATORS,
    SPEC,
    attached,
    both,
    fly,
    fly_from_rest,
    hold,
    hovering,
    positions,
)

N, STEPS, H = 3, 50, 0.02
T = H * np.arange(1, STEPS + 1)
LEVEL = hold([0.0, 0.0, 0.0, HOVER], STEPS, N)


def hovering_flight(simulator, speed=0.0, cmds=LEVEL):
    vel = jnp.zeros((N, 3)).at[:, 0].set(speed)
    return fly(simulator, hovering(simulator, positions(N), vel), cmds)


def pushed_flight(name, speed=0.0, **effects):
    """A hover under some of the effects; all are attached, so that a simulator is one program."""
    neutral = {key: {} for key in ("wind", "drag", "mass")}
    return hovering_flight(attached(SIMULATORS[name](), **neutral | effects), speed)


def test_free_fall_matches_closed_form():
    """v_k = -g h k and z_k = -g h^2 k (k + 1) / 2, the sums of semi-implicit Euler."""
    flight = fly_from_rest(SIMULATORS["point_mass"](), positions(N), jnp.zeros((STEPS, N, 4)))
    k = np.arange(1, STEPS + 1)
    fallen = flight.pos[:, 0, 2] - positions(N)[0, 2]
    np.testing.assert_allclose(flight.vel[:, 0, 2], -9.81 * H * k, rtol=1e-5)
    np.testing.assert_allclose(fallen, -9.81 * H**2 * k * (k + 1) / 2, rtol=1e-4)


def test_the_point_mass_hovers_without_any_drift():
    flight = fly_from_rest(SIMULATORS["point_mass"](), positions(N), LEVEL)
    np.testing.assert_allclose(flight.pos[-1], positions(N), atol=1e-5)


@pytest.mark.parametrize("tau", [0.02, 0.05, 0.2])
def test_the_attitude_lag_matches_closed_form_at_every_step(tau):
    """Angle c (1 - exp(-t / tau)), exact at all multiples of h: sin of half of it in quat."""
    simulator = SIMULATORS["point_mass"](attitude_tau=tau)
    quat = hovering_flight(simulator, cmds=hold([0.0, 0.4, 0.0, HOVER], STEPS, N)).quat
    pitch = 2 * np.arcsin(quat[:, 0, 1])
    np.testing.assert_allclose(pitch, 0.4 * (1 - np.exp(-T / tau)), atol=1e-6)


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.4), (0.4, 0.0), (-0.3, 0.2)])
def test_a_constant_tilt_ends_in_the_papers_acceleration(roll, pitch):
    """Paper, Sec. IV-A, with psi = 0."""
    cmds = hold([roll, pitch, 0.0, 0.5], STEPS, N)
    simulator = SIMULATORS["point_mass"](attitude_tau=0.05)
    vel = np.asarray(hovering_flight(simulator, cmds=cmds).vel[:, 0])
    thrust = 0.5 / SPEC.mass
    expected = [
        thrust * np.sin(pitch) * np.cos(roll),
        -thrust * np.sin(roll),
        thrust * np.cos(pitch) * np.cos(roll) - 9.81,
    ]
    np.testing.assert_allclose((vel[-1] - vel[-6]) / (5 * H), expected, atol=2e-4)


def test_semi_implicit_euler_converges_with_order_one():
    """A pitch step; halving the step halves the error of the position after 1 s."""
    with jax.enable_x64(True):
        exact = pitched_position(H / 256)
        errors = [float(jnp.linalg.norm(pitched_position(H / n) - exact)) for n in (1, 2, 4, 8)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 1.0, atol=0.06)


def pitched_position(dt):
    simulator = SIMULATORS["point_mass"]()

    @jax.jit
    def end():
        state = simulator.reset(jnp.zeros((1, 3)), jax.random.key(0))
        cmd = jnp.asarray([[0.1, 0.3, 0.0, HOVER]])

        def step(state, _):
            return simulator.step_cmd(state, cmd, dt), None

        return jax.lax.scan(step, state, None, length=round(1.0 / dt))[0].pos

    return end()


def test_crazyflow_coasts_to_a_stop_as_its_own_drag_says():
    """v = exp(-c0 t); explicit Euler at 2 ms errs by c0^2 h t / 2, 0.03 %."""
    vel = hovering_flight(SIMULATORS["crazyflow"](), speed=1.0).vel[:, 0, 0]
    np.testing.assert_allclose(vel, np.exp(-OWN_DRAG["crazyflow"][0] * T), rtol=5e-4)


def test_crazyflow_in_wind_approaches_its_terminal_speed():
    """v = (a / c0) (1 - exp(-c0 t)) with the wind's a = 1.5 m/s^2 of the paper."""
    vel = pushed_flight("crazyflow", wind={"x": 1.5}).vel[:, 0, 0]
    c0 = OWN_DRAG["crazyflow"][0]
    np.testing.assert_allclose(vel, 1.5 / c0 * (1 - np.exp(-c0 * T)), rtol=2e-3)


def test_wind_is_a_constant_acceleration_of_the_point_mass():
    wind = {"x": 1.5, "y": -0.5, "z": 0.2}
    vel = pushed_flight("point_mass", wind=wind).vel[:, 0]
    np.testing.assert_allclose(vel, T[:, None] * np.asarray([1.5, -0.5, 0.2]), atol=1e-5)


@both
@pytest.mark.parametrize("c", [-0.3, 2.0])
def test_excess_drag_adds_to_the_vehicles_own(name, c):
    """v = exp(-(c + c0) t); Euler at step h errs by (c + c0)^2 h t / 2."""
    vel = pushed_flight(name, speed=1.0, drag={"c": c}).vel[:, 0, 0]
    rate = c + OWN_DRAG[name][0]
    error = 0.6 * rate**2 * DT[name] * T[-1]
    np.testing.assert_allclose(vel, np.exp(-rate * T), rtol=error + 1e-4)


@both
@pytest.mark.parametrize("e", [-0.2, 0.2])
def test_excess_mass_changes_the_acceleration_at_hover_thrust(name, e):
    """dv/dt = g / (1 + e) - g - c0 / (1 + e) v; the controller's thrust stays nominal."""
    vel = pushed_flight(name, mass={"e": e}).vel[:, 0, 2]
    pull = 9.81 / (1 + e) - 9.81
    drag = OWN_DRAG[name][2] / (1 + e)
    expected = pull * T if drag == 0 else pull / drag * (1 - np.exp(-drag * T))
    np.testing.assert_allclose(vel, expected, rtol=2e-3)


def test_the_attitude_loop_matches_a_damped_oscillator():
    """Step response of w_n = 12.5 rad/s, z = 0.65 at a fine step: backward Euler errs by O(h)."""
    natural, damping, dt = 12.5, 0.65, 0.0005
    made = attached(
        SIMULATORS["point_mass"](attitude_tau=1e-6, dt=dt),
        attitude_loop={"natural_freq": natural, "damping": damping},
    )
    cmds = hold([0.0, 0.3, 0.0, HOVER], 800)
    quat = fly(made, hovering(made, positions(1)), cmds, dt).quat
    t = dt * np.arange(1, 801)
    fast = natural * np.sqrt(1 - damping**2)
    decay = np.exp(-damping * natural * t)
    wave = np.cos(fast * t) + damping * natural / fast * np.sin(fast * t)
    np.testing.assert_allclose(2 * np.arcsin(quat[:, 0, 1]), 0.3 * (1 - decay * wave), atol=2e-3)


@pytest.mark.parametrize("height", [0.0, 0.5])
def test_a_floor_stops_the_fall_of_a_point_mass(height):
    made = attached(SIMULATORS["point_mass"](), floor={"height": height})
    flight = fly_from_rest(made, positions(N), jnp.zeros((STEPS, N, 4)))
    assert (flight.pos[:, :, 2] >= height).all()
    np.testing.assert_array_equal(flight.pos[-1, :, 2], height)
    assert not flight.vel[-1].any()


def test_crazyflow_rests_on_its_floor_until_the_rotors_lift_it():
    """Half of the weight never lifts it; full thrust does within 0.24 s."""
    simulator = SIMULATORS["crazyflow"]()
    ground = positions(N).at[:, 2].set(0.0)
    weak = fly_from_rest(simulator, ground, hold([0.0, 0.0, 0.0, 0.5 * HOVER], STEPS, N))
    strong = fly_from_rest(simulator, ground, hold([0.0, 0.0, 0.0, 0.8], STEPS, N))
    np.testing.assert_allclose(weak.pos[:, :, 2], -0.001, atol=1e-6)
    assert not weak.vel.any()
    assert (strong.pos[12, :, 2] > 0.05).all()


@pytest.mark.parametrize(
    ("changes", "asked", "tolerance"),
    [
        *(({}, asked, 1e-3) for asked in (0.0, 0.05, 1.0)),
        *(({"thrust_min": 0.01, "thrust_max": 1.5}, x, 5e-3) for x in (0.005, 0.05, 0.6, 1.0, 1.7)),
        # One that `VEHICLES` does not know, whose file allows other thrusts.
        *(({"name": "cf2x_P250"}, asked, 5e-3) for asked in (0.4, 1.0)),
    ],
)
def test_crazyflow_clips_thrust_to_the_range_of_its_spec(changes, asked, tolerance):
    """The rotors never stand still, not even at a thrust of zero."""
    spec = dataclasses.replace(SPEC, **changes)
    made, given = (
        SIMULATORS["crazyflow"](spec=spec),
        np.clip(asked, spec.thrust_min, spec.thrust_max),
    )
    thrust = hovering_flight(made, cmds=hold([0.0, 0.0, 0.0, asked], STEPS, N)).thrust[-1]
    np.testing.assert_allclose(thrust, given, rtol=tolerance)
    state = made.with_thrust(hovering(made, positions(N)), jnp.full(N, asked))
    np.testing.assert_allclose(made.flight(state).thrust, given, rtol=1e-3)


def test_a_wider_range_of_thrust_leaves_attitude_control_as_it_was():
    """Where no motor comes to its limit."""
    cmds = hold([0.02, -0.01, 0.01, HOVER], STEPS, N)
    wide = dataclasses.replace(SPEC, thrust_min=0.0, thrust_max=2.0 * SPEC.thrust_max)
    flown = [hovering_flight(SIMULATORS["crazyflow"](spec=s), cmds=cmds).quat for s in (SPEC, wide)]
    np.testing.assert_allclose(*flown, atol=1e-5)


def test_the_derivative_of_clipped_thrust_is_zero():
    simulator = SIMULATORS["crazyflow"]()
    state = hovering(simulator, positions(N))

    def height(thrust):
        return fly(simulator, state, hold([0.0, 0.0, 0.0, 1.0], STEPS, N) * thrust).pos[-1, 0, 2]

    slope = jax.jit(lambda thrust: jax.jvp(height, (thrust,), (jnp.ones(()),))[1])
    slopes = [slope(jnp.asarray(thrust)) for thrust in (0.05, 0.5, 1.0)]
    assert slopes[0] == slopes[2] == 0.0
    assert slopes[1] > 1.0
