"""RotorPy as a simulator: it is the package's own vehicle, and keeps our contract."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import KEY, fly, hold, hover_flight
from rotorpy.vehicles.crazyfliebrushless_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

from simulators.contract import with_effects
from simulators.effects.mass import Mass
from simulators.effects.motor_lag import MotorLag
from simulators.rotorpy import FRICTION, Rotorpy, RotorpyState
from simulators.rotorpy_vehicle import (
    AIRFRAME,
    SPEC,
    airframe_of,
    derivative,
    hover_speed,
    make_multirotor,
    motor_speeds,
)
from simulators.vehicle import CONTROL_DT, GRAVITY

HOVER = SPEC.mass * GRAVITY
HOVER_SPEED = (HOVER / 4.0 / AIRFRAME["k_eta"]) ** 0.5


def random_body(seed):
    """Position, velocity, quaternion, angular velocity and rotor speeds."""
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=4) * [0.3, 0.3, 0.3, 1.0]
    speeds = HOVER_SPEED * rng.uniform(0.8, 1.2, 4)
    return np.concatenate(
        [rng.normal(size=6), quat / np.linalg.norm(quat), rng.normal(size=3), speeds]
    )


def state_of(body):
    """One drone at 3 m, as the simulator keeps it."""
    body = jnp.asarray(body)[None].at[:, 2].set(3.0)
    parts = (body[:, :3], body[:, 3:6], body[:, 6:10], body[:, 10:13], body[:, 13:])
    return RotorpyState(jnp.zeros((), jnp.int32), *parts, memory=())


def standing(pos=(0.0, 0.0, 0.0)):
    return Rotorpy().reset(jnp.asarray([pos]), KEY)


@pytest.mark.parametrize("seed", range(3))
def test_the_derivative_is_the_packages_own(seed):
    body, still = random_body(seed), np.zeros(3)
    own = Multirotor(AIRFRAME, control_abstraction="cmd_ctatt")
    speeds = np.linspace(0.9, 1.1, 4) * HOVER_SPEED
    expected = own._s_dot_fn(0.0, np.concatenate([body[:13], still, body[13:]]), speeds)
    with jax.enable_x64(True):
        none = jnp.zeros(3)
        found = derivative(make_multirotor(AIRFRAME), *map(jnp.asarray, (body, speeds, none, none)))
    np.testing.assert_allclose(found, np.delete(expected, [13, 14, 15]), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_attitude_loop_is_the_packages_own(seed):
    body = random_body(seed)
    own = Multirotor(AIRFRAME, control_abstraction="cmd_ctatt")
    yaw = 0.3
    control = {"cmd_thrust": 0.45, "cmd_q": np.asarray([0, 0, np.sin(yaw / 2), np.cos(yaw / 2)])}
    expected = own.get_cmd_motor_speeds({"q": body[6:10], "w": body[10:13]}, control)
    with jax.enable_x64(True):
        cmd = jnp.asarray([0.0, 0.0, yaw, 0.45])
        found = motor_speeds(make_multirotor(AIRFRAME), jnp.asarray(body), cmd)
    expected = np.clip(expected, quad_params["rotor_speed_min"], quad_params["rotor_speed_max"])
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_control_step_is_the_packages_own_integrator(seed):
    """Four steps of `Multirotor.step`, which integrates by SciPy's RK45, tightened."""
    body = random_body(seed)
    body[2] = 3.0
    tight = {"method": "RK45", "rtol": 1e-11, "atol": 1e-12}
    own = Multirotor(AIRFRAME, control_abstraction="cmd_ctatt", integrator_kwargs=tight)
    state = {"x": body[:3], "v": body[3:6], "q": body[6:10], "w": body[10:13]}
    state |= {"wind": np.zeros(3), "rotor_speeds": body[13:]}
    control = {"cmd_thrust": 0.45, "cmd_q": np.asarray([0.0, 0.0, 0.0, 1.0])}
    for _ in range(4):
        state = own.step(state, control, CONTROL_DT / 4)
    with jax.enable_x64(True):
        found = fly(Rotorpy(), state_of(body), hold([0.0, 0.0, 0.0, 0.45], 1))
    for name, key in (("pos", "x"), ("vel", "v"), ("quat", "q"), ("ang_vel", "w")):
        np.testing.assert_allclose(getattr(found, name)[0, 0], state[key], atol=2e-5, err_msg=name)


def test_the_nominal_airframe_is_the_file():
    with jax.enable_x64(True):
        found = airframe_of(SPEC.vehicle(drag=False))
    assert set(found) == set(AIRFRAME)
    for name, value in AIRFRAME.items():
        if name == "rotor_pos":
            for rotor, place in value.items():
                np.testing.assert_allclose(found[name][rotor], place, rtol=1e-12)
        else:
            np.testing.assert_allclose(found[name], value, rtol=1e-12, err_msg=name)


def test_drones_stand_on_the_floor_until_the_rotors_carry_them():
    low, high = (
        fly(Rotorpy(), standing(), hold([0.0, 0.0, 0.0, share * HOVER], 50)).pos[-1]
        for share in (0.5, 1.5)
    )
    np.testing.assert_array_equal(low, 0.0)
    assert float(high[0, 2]) > 0.5


def test_a_drone_that_slides_on_the_floor_is_level_and_slows():
    state = state_of(random_body(0))
    low = jnp.asarray([[0.0, 0.0, -0.1]])
    state = Rotorpy().with_motion(state, low, jnp.asarray([[1.0, 0.0, -1.0]]))
    after = Rotorpy().step_cmd(state, jnp.zeros((1, 4)), 0.005)
    np.testing.assert_allclose(after.vel[0, 2], 0.0)
    assert 0.5 < float(after.vel[0, 0]) < 1.0 - FRICTION + 0.1
    np.testing.assert_allclose(after.quat[0, :2], 0.0)
    np.testing.assert_array_equal(np.asarray(after.ang_vel), 0.0)


def test_rotors_are_warmed_up_by_the_commands_before():
    flight = Rotorpy().flight(state_of(random_body(0)))
    cmds = (
        jnp.zeros((100, 1, 4)).at[:, :, 3].set(jnp.where(jnp.arange(100) < 90, 0.3, 0.5)[:, None])
    )
    state = Rotorpy().restore(flight, cmds, KEY)
    low, high = (float(hover_speed(jnp.asarray(x))) for x in (0.3, 0.5))
    expected = high + (low - high) * np.exp(-10 * CONTROL_DT / SPEC.rotor_lag)
    np.testing.assert_allclose(state.rotor_vel[0], expected, rtol=1e-5)


def test_a_heavier_drone_sinks_and_slow_motors_follow_late():
    hover, start = [0.0, 0.0, 0.0, HOVER], state_of(random_body(0))
    start = RotorpyState(
        start.steps,
        start.pos,
        jnp.zeros((1, 3)),
        jnp.asarray([[0.0, 0.0, 0.0, 1.0]]),
        jnp.zeros((1, 3)),
        jnp.full((1, 4), HOVER_SPEED),
        (None,),
    )
    heavy = with_effects(Rotorpy(), [Mass(e=0.1)])
    fallen = fly(heavy, start, hold(hover, 5)).vel[-1, 0, 2]
    damped = 4.0 * HOVER_SPEED * AIRFRAME["k_z"] / (1.1 * SPEC.mass)  # by the rotors' inflow [1/s]
    expected = -GRAVITY * (1.0 - 1.0 / 1.1) * (1.0 - np.exp(-0.1 * damped)) / damped
    np.testing.assert_allclose(fallen, expected, rtol=0.01)
    more = [0.0, 0.0, 0.0, 1.2 * HOVER]
    slow, normal = (
        fly(with_effects(Rotorpy(), [MotorLag(scale=s)]), start, hold(more, 3)).vel[-1, 0, 2]
        for s in (3.0, 1.0)
    )
    assert float(slow) < float(normal)


@jax.jit
@functools.partial(jax.value_and_grad, argnums=1)
def far(start, cmds):
    """A number that depends on where commands lead to, and its gradient in the commands."""
    flight = fly(Rotorpy(), start, cmds)
    return jnp.sum(flight.pos[-1] ** 2) + jnp.sum(flight.vel[-1])


# `make test` has the longer flight.
@pytest.mark.parametrize("steps", [pytest.param(2, marks=pytest.mark.exhaustive), 25])
def test_gradients_equal_finite_differences(steps):
    with jax.enable_x64(True):
        start = state_of(random_body(1))
        rng = np.random.default_rng(2)
        cmds = jnp.asarray(rng.normal(size=(steps, 1, 4)) * [0.2, 0.2, 0.1, 0.02])
        cmds = cmds + jnp.asarray([0.0, 0.0, 0.0, HOVER])
        slope = np.asarray(far(start, cmds)[1])
        assert np.isfinite(slope).all()
        for place in [(0, 0, 0), (0, 0, 1), (0, 0, 3), (steps - 1, 0, 3)]:
            h = np.zeros(cmds.shape)
            h[place] = 1e-6
            rough = (far(start, cmds + h)[0] - far(start, cmds - h)[0]) / 2e-6
            np.testing.assert_allclose(slope[place], rough, rtol=1e-5, atol=1e-9)


def test_no_thrust_at_all_has_a_finite_gradient():
    """The root of a rotor's squared speed has no finite slope at zero."""
    with jax.enable_x64(True):
        _, slope = far(standing((0.0, 0.0, 3.0)), hold([0.0, 0.0, 0.0, 0.0], 25))
        assert np.isfinite(slope).all()


def test_a_hovering_drone_loses_speed_at_the_rate_that_it_says():
    """Along and across the rotors' axis, small against the 50 Hz of a replay's nodes."""
    simulator, own = Rotorpy(freq=500), HOVER
    vel = jnp.asarray([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    flight = hover_flight(jnp.asarray([[i, 0.0, 1.0] for i in range(3)]), vel)
    flight = eqx.tree_at(lambda f: f.thrust, flight, jnp.full(3, own))
    start = simulator.restore(flight, hold([0.0, 0.0, 0.0, own], 50, 3), KEY)
    after = fly(simulator, start, hold([0.0, 0.0, 0.0, own], 1, 3), 0.02).vel[0]
    lost = -np.log(np.diag(after) / 0.1) / 0.02
    np.testing.assert_allclose(lost, simulator.braking, rtol=0.02)
    assert simulator.braking[2] > 1.5
