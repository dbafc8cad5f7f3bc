"""What turns a drone: gains of the autopilot, rotors and their arms, gyroscopic torques."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, SIMULATORS, SPEC, attached, fly, hold, hovering, positions

from simulators.algebra.rotation import quat_to_rpy
from simulators.effects.gyro_compensation import GyroCompensation

LEVEL = hold([0.0, 0.0, 0.0, HOVER], 1)


TURNING = (
    *("inertia", "roll_pitch_gains", "yaw_gains"),
    *("rotor_inertia", "rotor_arm", "rotor_torque", "gyro_compensation"),
)
"""Effects on what turns a drone."""


def _made(**effects):
    """Crazyflow with some of these effects; all are attached, so that it is one program."""
    return attached(SIMULATORS["crazyflow"](), **{name: {} for name in TURNING} | effects)


def _first_rate(made, state):
    """Angular velocity [rad/s] after the first integration step of a hover from `state`."""
    return np.asarray(fly(made, state, LEVEL, 0.002).ang_vel[0, 0])


def _turning(axis, angle, **effects):
    """Roll, pitch or yaw [rad] after a small step of its command at hover."""
    made = _made(**effects)
    cmd = [0.0, 0.0, 0.0, HOVER]
    cmd[axis] = angle
    return quat_to_rpy(fly(made, hovering(made, positions(1)), hold(cmd, 25)).quat)[:, 0, axis]


@pytest.mark.parametrize(
    ("axis", "effect", "gains", "share"),
    [
        *((x, "roll_pitch_gains", ("stiffness", "damping", "acceleration"), 0.01) for x in (0, 1)),
        (2, "yaw_gains", ("stiffness", "integral", "damping"), 0.02),
    ],
)
def test_gains_that_grow_with_the_inertia_turn_a_drone_as_before(axis, effect, gains, share):
    """J w' = torque: (1 + e) on both sides; with the inertia alone the response overshoots."""
    e, angle = 0.5, 0.02
    nominal = _turning(axis, angle)
    scaled = _turning(axis, angle, **{"inertia": {"e": e}, effect: dict.fromkeys(gains, e)})
    alone = _turning(axis, angle, inertia={"e": e})
    np.testing.assert_allclose(scaled, nominal, atol=share * angle)
    assert np.abs(alone - nominal).max() > (0.02 + share) * angle


@pytest.mark.parametrize("e", [-1.0, 0.5])
def test_rotors_that_speed_up_turn_the_drone_by_their_inertia(e):
    """First step of a yaw command: no rotor has another speed yet, so all torque is theirs."""
    cmds = hold([0.0, 0.0, 0.2, HOVER], 1)
    rates = [
        fly(made, hovering(made, positions(1)), cmds, 0.002).ang_vel[0, 0, 2]
        for made in (_made(), _made(rotor_inertia={"e": e}))
    ]
    assert float(rates[0]) > 1e-3
    assert float(rates[1]) == pytest.approx((1.0 + e) * float(rates[0]), rel=1e-3, abs=1e-6)


@pytest.mark.parametrize(
    ("effect", "e", "speeds", "axis"),
    [
        *(("rotor_arm", e, (1.05, 1.05, 1.0, 1.0), 0) for e in (-0.3, 0.0, 0.5)),
        *(("rotor_torque", e, (1.05, 1.0, 1.05, 1.0), 2) for e in (-0.5, 0.0, 2.0)),
    ],
)
def test_rotors_of_different_speeds_turn_the_drone_by_their_arm_and_torque(effect, e, speeds, axis):
    """First step from two faster rotors, those of one side or of a pair that turns one way.

    Speeding up does nothing: rotors without inertia.
    """
    rates = []
    for size in (0.0, e):
        made = _made(**{"rotor_inertia": {"e": -1.0}, effect: {"e": size}})
        state = hovering(made, positions(1))
        faster = state.rotor_vel * jnp.asarray([speeds])
        state = eqx.tree_at(lambda s: s.rotor_vel, state, faster)
        if effect == "rotor_arm":
            assert float(made.flight(state).torque[0, axis]) != 0.0
        rates.append(float(_first_rate(made, state)[axis]))
    assert abs(rates[0]) > (1e-2, 0.0, 1e-3)[axis]
    assert rates[1] == pytest.approx((1.0 + e) * rates[0], rel=1e-3)


def test_gyro_compensation_takes_away_what_turning_about_two_axes_does():
    """Its part of the first step is J^-1 (w x J w) dt, and it leaves w as it is without torques."""
    turning = jnp.asarray([[3.0, -2.0, 4.0]])
    inertia = np.asarray(SPEC.vehicle(drag=True).inertia)
    expected = np.linalg.solve(inertia, np.cross(turning[0], inertia @ turning[0])) * 0.002
    rates = []
    for share in (0.0, 0.5, 1.0):
        made = _made(gyro_compensation={"share": share})
        state = hovering(made, positions(1))
        state = eqx.tree_at(lambda s: (s.ang_vel, s.prev_ang_vel), state, (turning, turning))
        rates.append(_first_rate(made, state))
    assert np.abs(expected).min() > 1e-4
    np.testing.assert_allclose(rates[1] - rates[0], 0.5 * expected, rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(rates[2] - rates[0], expected, rtol=0.01, atol=1e-6)


def test_gyro_compensation_of_another_inertia_is_that_of_the_believed_one():
    """With twice the inertia the same torque turns half as fast."""
    turning, rates = jnp.asarray([[3.0, -2.0, 4.0]]), {}
    for e in (0.0, 1.0):
        for share in (0.0, 1.0):
            made = _made(inertia={"e": e}, gyro_compensation={"share": share})
            state = hovering(made, positions(1))
            state = eqx.tree_at(lambda s: (s.ang_vel, s.prev_ang_vel), state, (turning, turning))
            rates[e, share] = _first_rate(made, state)
    alone, doubled = (rates[e, 1.0] - rates[e, 0.0] for e in (0.0, 1.0))
    np.testing.assert_allclose(doubled, 0.5 * alone, rtol=0.02, atol=1e-6)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_gyro_compensation_comes_as_late_as_the_rotors_follow(scale):
    """After a turn that begins at once, m / J w x w = 1 - exp(-t / tau) to first order in dt."""
    vehicle = eqx.tree_at(
        lambda v: v.motor_lag_scale, SPEC.vehicle(drag=True), jnp.asarray(scale, float)
    )
    effect, dt = GyroCompensation(share=1.0), 0.001
    state = hovering(SIMULATORS["crazyflow"](), positions(1))
    still = SIMULATORS["crazyflow"]().flight(state)
    turning = eqx.tree_at(lambda f: f.ang_vel, still, jnp.asarray([[3.0, -2.0, 4.0]]))
    memory, _, torque = effect.wrench(effect.init(1, dt), turning, vehicle, dt)
    whole = np.asarray(torque)
    assert np.abs(whole).max() > 0.0
    memory, *_ = effect.wrench(effect.init(1, dt), still, vehicle, dt)
    found = []
    for _ in range(200):
        memory, _, torque = effect.wrench(memory, turning, vehicle, dt)
        found.append(np.asarray(torque)[0] / whole[0])
    t = dt * np.arange(1, 201)
    expected = 1.0 - np.exp(-t / (scale * SPEC.rotor_lag))
    np.testing.assert_allclose(found, np.repeat(expected[:, None], 3, axis=1), atol=0.01)


def test_only_the_chosen_drones_rotors_are_faster():
    made = SIMULATORS["crazyflow"]()
    state = hovering(made, positions(2))
    faster = jnp.asarray([[0.1, 0.0, -0.1, 0.2]] * 2)
    spun = made.with_faster_rotors(state, faster, jnp.asarray([False, True]))
    np.testing.assert_allclose(spun.rotor_vel[0], state.rotor_vel[0])
    np.testing.assert_allclose(spun.rotor_vel[1] / state.rotor_vel[1], 1.0 + faster[1], rtol=1e-6)
    point = SIMULATORS["point_mass"]()
    still = hovering(point, positions(2))
    assert eqx.tree_equal(point.with_faster_rotors(still, faster, jnp.asarray([True, True])), still)


def test_a_prescribed_attitude_leaves_a_weaker_thrust_and_its_lag_alone():
    made = attached(SIMULATORS["point_mass"](dt=0.005), thrust_lag={"up": 0.1, "down": 0.1})
    weaker = attached(made, thrust_gain={"e": -0.1})
    level, still = jnp.asarray([[0.0, 0.0, 0.0, 1.0]]), jnp.zeros((1, 3))
    cmd, found = jnp.asarray([[0.0, 0.0, 0.0, 1.2 * HOVER]]), []
    for simulator in (made, weaker):
        state = hovering(simulator, positions(1))
        for _ in range(40):
            state = simulator.with_attitude(state, level, still, jnp.ones(1, bool))
            state = simulator.step_cmd(state, cmd, 0.005)
        found.append(float(state.thrust[0]) / HOVER)
    risen = 0.2 * (1.0 - 1.05**-40)
    assert found[0] == pytest.approx(1.0 + risen, rel=1e-4)
    # It starts at a measured thrust, which the gain has made already.
    start = 1.0 / 0.9
    assert found[1] == pytest.approx(0.9 * (1.2 + (start - 1.2) * 1.05**-40), rel=1e-4)
