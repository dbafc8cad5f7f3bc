"""The generator's disturbances obey their equations, and do nothing where they are neutral."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from blind.fly.disturbances import (
    ROTOR_RADIUS,
    CommandDisturbance,
    PlantDisturbance,
    WrenchDisturbance,
)
from simulators.effects.rotor_drag import RotorDrag
from simulators.effects.translational_lift import TranslationalLift
from simulators.flight import Flight
from simulators.vehicle import GRAVITY, VEHICLES

DT = 0.002
VEHICLE = VEHICLES["cf21B_500"].vehicle(drag=True)
HOVER = VEHICLE.mass * GRAVITY


def flight(
    pos=((0.0, 0.0, 1.0),), vel=None, quat=(0.0, 0.0, 0.0, 1.0), thrust=0.4, t=0.0, torque=None
):
    pos = jnp.asarray(pos)
    vel = jnp.zeros_like(pos) if vel is None else jnp.asarray(vel)
    quats = jnp.broadcast_to(jnp.asarray(quat), (len(pos), 4))
    still = jnp.zeros_like(pos)
    turning = still if torque is None else jnp.asarray(torque)
    return Flight(jnp.asarray(t), pos, vel, quats, still, jnp.full(len(pos), thrust), turning)


def respond(effect, cmds):
    """Commands after `effect`, one a physics step."""

    def step(memory, cmd):
        return effect.command(memory, flight(), cmd[None], DT)

    return jax.lax.scan(step, effect.init(1, DT), jnp.asarray(cmds))[1][:, 0]


def push(effect, now, vehicle=VEHICLE):
    return effect.wrench(effect.init(len(now.pos), DT), now, vehicle, DT)[1:]


def ramp():
    """Commands that all rise by one a second."""
    return np.arange(200)[:, None] * DT * np.ones(4)


def test_neutral_disturbances_change_nothing():
    cmds = np.random.default_rng(0).normal(size=(50, 4)).astype(np.float32)
    np.testing.assert_array_equal(respond(CommandDisturbance(), cmds), cmds)
    now = flight(vel=[[1.0, -2.0, 0.5]])
    np.testing.assert_array_equal(np.concatenate(push(WrenchDisturbance(), now)), 0.0)
    _, vehicle = PlantDisturbance().plant(None, now, VEHICLE, DT)
    jax.tree.map(np.testing.assert_array_equal, vehicle, VEHICLE)


@pytest.mark.parametrize("delay", [0.01, 0.013, 0.05])
def test_a_delay_shifts_a_ramp_by_itself(delay):
    out = respond(CommandDisturbance(delay=delay), ramp())
    np.testing.assert_allclose(out[60:], ramp()[60:] - delay, atol=1e-5)


def test_a_lag_approaches_a_step_exponentially_and_leaves_the_thrust_alone():
    cmds = np.concatenate([np.zeros((1, 4)), np.ones((100, 4))])
    out = respond(CommandDisturbance(lag=0.03), cmds)
    expected = 1.0 - np.exp(-np.arange(101) * DT / 0.03)
    np.testing.assert_allclose(out[:, :3], np.tile(expected[:, None], 3), atol=1e-5)
    np.testing.assert_array_equal(out[:, 3], cmds[:, 3])


def test_play_follows_a_rising_thrust_from_below_and_a_falling_one_from_above():
    thrust = np.concatenate([np.linspace(0.3, 0.5, 101), np.linspace(0.5, 0.3, 101)])
    cmds = np.zeros((202, 4))
    cmds[:, 3] = thrust
    out = respond(CommandDisturbance(play=0.02), cmds)[:, 3]
    np.testing.assert_allclose(out[20:101], thrust[20:101] - 0.02, atol=1e-6)
    np.testing.assert_allclose(out[125:], thrust[125:] + 0.02, atol=1e-6)
    np.testing.assert_allclose(out[:8], 0.3, atol=1e-6)


def test_gain_trim_and_yaw_offset_act_on_their_angles():
    effect = CommandDisturbance(tilt_gain=-0.1, trim=jnp.asarray([0.01, 0.02]), yaw_offset=0.3)
    out = respond(effect, [[0.2, -0.1, 0.5, 0.4]])[0]
    np.testing.assert_allclose(out, [0.19, -0.07, 0.8, 0.4], atol=1e-6)


def test_a_plant_scales_each_of_its_constants():
    effect = PlantDisturbance(0.1, 0.3, 1.7, -0.05, 0.01)
    _, vehicle = effect.plant(None, flight(t=4.0), VEHICLE, DT)
    np.testing.assert_allclose(vehicle.mass, 1.1 * VEHICLE.mass)
    np.testing.assert_allclose(vehicle.inertia, 1.3 * VEHICLE.inertia)
    np.testing.assert_allclose(vehicle.motor_lag_scale, 1.7)
    np.testing.assert_allclose(vehicle.thrust_gain, 0.95 * 0.96, rtol=1e-6)


def test_drags_oppose_the_motion():
    now = flight(vel=[[3.0, 0.0, 4.0]])
    force, _ = push(WrenchDisturbance(drag=0.2, quadratic_drag=0.1), now)
    np.testing.assert_allclose(force[0] / VEHICLE.mass, [-2.1, 0.0, -2.8], rtol=1e-5)


def test_a_gust_waits_for_its_onset():
    effect = WrenchDisturbance(gust=jnp.asarray([0.5, 0.0, 0.0]), gust_onset=2.0)
    before, after = (push(effect, flight(t=t))[0][0, 0] / VEHICLE.mass for t in (1.99, 2.0))
    np.testing.assert_allclose([before, after], [0.0, 0.5], rtol=1e-6)


def test_ground_effect_adds_its_share_along_the_thrust():
    h = 0.05
    force, _ = push(WrenchDisturbance(ground_effect=8.0), flight([[0.0, 0.0, h]], thrust=0.4))
    np.testing.assert_allclose(force[0, 2], 0.4 * 8.0 * (ROTOR_RADIUS / (4 * h)) ** 2, rtol=1e-5)


def test_downwash_pushes_only_what_flies_below():
    above = [[0.0, 0.0, 1.5], [0.1, 0.0, 1.0]]
    force, _ = push(WrenchDisturbance(downwash=2.0, downwash_width=0.1), flight(above))
    expected = [0.0, -2.0 * np.exp(-0.5)]
    np.testing.assert_allclose(force[:, 2] / VEHICLE.mass, expected, rtol=1e-5)


def test_rotors_drag_and_lift():
    """Drag grows with the speed of the rotors, the root of thrust over gain; lift does not."""
    half, vel = 0.25, np.asarray([1.0, -0.5, 2.0])
    up = np.asarray([np.sin(2 * half), 0.0, np.cos(2 * half)])
    quat = (0.0, np.sin(half), 0.0, np.cos(half))
    now = flight(vel=[vel], quat=quat, thrust=1.44 * HOVER)
    climb = vel @ up
    drags = WrenchDisturbance(axial_drag=0.7, lateral_drag=0.3)
    braked = 0.7 * climb * up + 0.3 * (vel - climb * up)
    force, _ = push(drags, now)
    np.testing.assert_allclose(force[0] / VEHICLE.mass, -1.2 * braked, rtol=1e-5)
    weak = PlantDisturbance(excess_thrust=-0.19).plant(None, now, VEHICLE, DT)[1]
    force, _ = push(drags, now, weak)
    np.testing.assert_allclose(force[0] / VEHICLE.mass, -1.2 / 0.9 * braked, rtol=1e-5)
    spinning = dataclasses.replace(flight(thrust=1.44 * HOVER), ang_vel=jnp.asarray([[3.0, 2, 1]]))
    _, torque = push(drags, spinning)
    damping = 1.2 * VEHICLE.mass * float(VEHICLE.arm) ** 2 * np.asarray([0.7 * 3, 0.7 * 2, 2 * 0.3])
    np.testing.assert_allclose(torque[0], -damping, rtol=1e-5)
    force, _ = push(WrenchDisturbance(lift=0.12), now)
    across = vel @ vel - climb**2
    np.testing.assert_allclose(force[0] / VEHICLE.mass, 0.12 * across * up, rtol=1e-5)


def test_rotors_that_thrust_more_are_braked_more():
    """What the library's effect, linear in the differences, says of the same flight."""
    drags = WrenchDisturbance(axial_drag=1.7, lateral_drag=0.4)
    effect = RotorDrag(axial=1.7, lateral=0.4)
    vel, quat, torque = [[1.0, -0.5, 2.0]], (0.1, -0.2, 0.3, 0.927), [[4e-4, -3e-4, 0.0]]
    quat = tuple(np.asarray(quat) / np.linalg.norm(quat))
    level, turning = (flight(vel=vel, quat=quat, torque=t) for t in (None, torque))
    gained = [
        np.asarray(of(turning)) - np.asarray(of(level))
        for of in (
            lambda now: push(drags, now)[1],
            lambda now: effect.wrench(None, now, VEHICLE, DT)[2],
        )
    ]
    assert np.abs(gained[0]).max() > 3e-5
    np.testing.assert_allclose(gained[0], gained[1], atol=0.02 * np.abs(gained[0]).max())


def test_rotors_lift_as_the_library_says_while_the_drone_turns():
    """Four rotors of their own velocity here, sums over them written out there."""
    quat = np.asarray([0.1, -0.2, 0.3, 0.927])
    now = flight(vel=[[1.5, -0.5, 0.7]], quat=quat / np.linalg.norm(quat))
    now = dataclasses.replace(now, ang_vel=jnp.asarray([[0.5, -1.0, 4.0]]))
    force, torque = push(WrenchDisturbance(lift=0.25), now)
    _, told_force, told_torque = TranslationalLift(k=0.25).wrench(None, now, VEHICLE, DT)
    np.testing.assert_allclose(force, told_force, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(torque, told_torque, rtol=1e-4, atol=1e-9)
    assert np.abs(torque).max() > 5e-5


def test_thrust_turns_a_vehicle_around_its_centre_of_mass():
    """With the centre of mass ahead, the thrust behind it pushes the nose down: +y."""
    _, torque = push(WrenchDisturbance(offset=jnp.asarray([0.002, 0.0])), flight(thrust=0.4))
    np.testing.assert_allclose(torque[0], [0.0, 0.0008, 0.0], atol=1e-9)


def test_what_pushes_rotors_turns_a_vehicle_around_its_centre_of_mass():
    """Lift of 0.5 m/s^2 and lateral drag of 0.6 m/s^2 of a drone at 2 m/s, 2 mm off its centre."""
    effect = WrenchDisturbance(offset=jnp.asarray([0.002, 0.0]), lift=0.125, lateral_drag=0.3)
    mass = float(VEHICLE.mass)
    _, torque = push(effect, flight(vel=[[0.0, 2.0, 0.0]], thrust=HOVER))
    expected = [0.0, 0.002 * mass * (GRAVITY + 0.5), 0.002 * mass * 0.6]
    np.testing.assert_allclose(torque[0], expected, rtol=1e-4)


def test_turbulence_has_its_size_and_correlation_time():
    effect = WrenchDisturbance(turbulence=0.8, turbulence_time=0.3, seed=4)

    def step(memory, i):
        memory, force, _ = effect.wrench(memory, flight(t=i * DT), VEHICLE, DT)
        return memory, force[0] / VEHICLE.mass

    air = np.asarray(jax.lax.scan(step, effect.init(1, DT), jnp.arange(100_000))[1])[5000:]
    lag = round(0.3 / DT)
    kept = np.mean(air[lag:] * air[:-lag]) / np.mean(air**2)
    np.testing.assert_allclose(np.std(air), 0.8, rtol=0.15)
    np.testing.assert_allclose(kept, np.exp(-1.0), atol=0.12)


def test_a_load_weighs_what_it_weighs_and_nothing_in_free_fall():
    effect = WrenchDisturbance(load=0.004, cable=0.5)
    carrying = (VEHICLE.mass + 0.004) * GRAVITY
    hanging, _ = push(effect, flight(thrust=carrying))
    falling, _ = push(effect, flight(thrust=0.0))
    np.testing.assert_allclose(hanging[0], [0.0, 0.0, -0.004 * GRAVITY], rtol=1e-4)
    np.testing.assert_allclose(falling, 0.0, atol=1e-7)


def test_a_load_under_a_heavy_vehicle_swings_like_a_pendulum():
    heavy = VEHICLES["cf21B_500"].vehicle(drag=False)
    heavy = PlantDisturbance(excess_mass=1e4).plant(None, flight(), heavy, DT)[1]
    effect = WrenchDisturbance(load=0.004, cable=0.5)
    now = flight(thrust=float(heavy.mass) * GRAVITY)
    air, _, spin = effect.init(1, DT)
    tilted = jnp.asarray([[np.sin(0.05), 0.0, -np.cos(0.05)]])

    def step(memory, _):
        memory, _, _ = effect.wrench(memory, now, heavy, DT)
        return memory, memory[1][0, 0]

    x = np.asarray(jax.lax.scan(step, (air, tilted, spin), None, length=3000)[1])
    crossings = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
    period = np.mean(np.diff(crossings)) * DT
    np.testing.assert_allclose(period, 2 * np.pi * np.sqrt(0.5 / GRAVITY), rtol=0.01)
