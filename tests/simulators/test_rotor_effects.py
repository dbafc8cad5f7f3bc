"""Air on the rotors: drag along and across their axis and translational lift, in closed form."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from flying import (
    DT,
    HOVER,
    SIMULATORS,
    attached,
    both,
    fly,
    hold,
    hover_flight,
    hovering,
    positions,
    restore,
)

from simulators.algebra.rotation import rotate, rpy_to_quat
from simulators.effects.rotor_drag import RotorDrag
from simulators.effects.translational_lift import TranslationalLift
from simulators.vehicle import GRAVITY

STEPS = 50
T = 0.02 * np.arange(1, STEPS + 1)
LEVEL = hold([0.0, 0.0, 0.0, HOVER], STEPS)


@both
@pytest.mark.parametrize("gain", [0.0, -0.19])
def test_rotor_drag_follows_the_rotor_axis_and_the_rotors_speed(name, gain):
    """A drone that leans by 0.3 rad at 2 m/s; weaker rotors turn faster for the same thrust."""
    axial, lateral, dt, tilt = 0.8, 0.3, DT[name], 0.3
    weak = {"thrust_gain": {"e": gain}}
    made = attached(SIMULATORS[name](), rotor_drag={"axial": axial, "lateral": lateral}, **weak)
    gained = []
    for simulator in (made, attached(SIMULATORS[name](), **weak)):
        flight = hover_flight(positions(1))
        leaning = rpy_to_quat(jnp.asarray([[0.0, tilt, 0.0]]))
        flight = eqx.tree_at(
            lambda f: (f.quat, f.vel), flight, (leaning, jnp.asarray([[2.0, 0.0, 0.0]]))
        )
        told = [0.0, tilt, 0.0, HOVER]
        state = restore(simulator, flight, hold(told, 50))
        gained.append(np.asarray(fly(simulator, state, hold(told, 1), dt).vel[0, 0]))
    up, vel = np.asarray([np.sin(tilt), 0.0, np.cos(tilt)]), np.asarray([2.0, 0.0, 0.0])
    along = vel @ up * up
    # Commanded hover thrust comes out smaller; the rotors turn as fast as they would without it.
    expected = -dt * (axial * along + lateral * (vel - along))
    np.testing.assert_allclose(gained[0] - gained[1], expected, rtol=0.02, atol=1e-6)


@pytest.mark.parametrize(("axis", "braked"), [(0, 0.8), (1, 0.8), (2, 2 * 0.3)])
def test_rotor_drag_damps_rotation(axis, braked):
    """J w' = -m l^2 k w in the first step, each rotor having its own velocity."""
    made = attached(SIMULATORS["crazyflow"](), rotor_drag={"axial": 0.8, "lateral": 0.3})
    turning = jnp.zeros((1, 3)).at[0, axis].set(1.0)
    rates = []
    for simulator in (made, SIMULATORS["crazyflow"]()):
        flight = eqx.tree_at(lambda f: f.ang_vel, hover_flight(positions(1)), turning)
        state = restore(simulator, flight, hold([0.0, 0.0, 0.0, HOVER], 50))
        told = hold([0.0, 0.0, 0.0, HOVER], 1)
        rates.append(float(fly(simulator, state, told, DT["crazyflow"]).ang_vel[0, 0, axis]))
    spec = made.spec
    expected = -spec.mass * spec.arm**2 * braked / spec.inertia[axis] * DT["crazyflow"]
    np.testing.assert_allclose(rates[0] - rates[1], expected, rtol=0.03)


def test_rotors_that_thrust_more_are_braked_more():
    """Four rotors summed one by one, two of which turn 3 % faster than they would in hover."""
    made, spec = SIMULATORS["crazyflow"](), SIMULATORS["crazyflow"]().spec
    arm, quat, gain = spec.arm, rpy_to_quat(jnp.asarray([[0.2, -0.3, 0.4]])), 0.9
    where = arm * np.asarray([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]])
    speed = 1.1 * np.asarray([1.03, 1.0, 0.97, 1.01])
    each = gain * HOVER / 4.0 * speed**2
    turn = np.asarray(rotate(jnp.repeat(quat, 3, axis=0), jnp.eye(3))).T
    vel, ang_vel = np.asarray([1.0, -0.5, 2.0]), np.asarray([2.0, -1.0, 0.5])
    air = turn.T @ vel + np.cross(ang_vel, where)
    braked = -spec.mass / 4.0 * speed[:, None] * air * [0.4, 0.4, 1.7]
    flight = eqx.tree_at(
        lambda f: (f.vel, f.quat, f.ang_vel, f.thrust, f.torque),
        hover_flight(positions(1)),
        tuple(
            jnp.asarray(x)[None]
            for x in (
                vel,
                quat[0],
                ang_vel,
                each.sum(),
                np.cross(where, each[:, None] * [0, 0, 1]).sum(0),
            )
        ),
    )
    vehicle = eqx.tree_at(lambda v: v.thrust_gain, made.spec.vehicle(drag=True), gain)
    effect = RotorDrag(axial=1.7, lateral=0.4)
    _, force, torque = effect.wrench(None, flight, vehicle, 0.002)
    moment = np.cross(where, braked).sum(0)
    near = 5e-3 * np.linalg.norm(braked.sum(0)), 5e-3 * np.linalg.norm(moment)
    np.testing.assert_allclose(force[0], turn @ braked.sum(0), atol=near[0])
    np.testing.assert_allclose(turn.T @ torque[0], moment, atol=near[1])


@both
def test_translational_lift_grows_with_the_square_of_forward_speed(name):
    """First step of a level drone: v_z' = k v^2, none of it from climbing."""
    k, dt = 0.1, DT[name]
    made = attached(SIMULATORS[name](), translational_lift={"k": k})
    for forward in (1.0, 2.0):
        vel = jnp.asarray([[forward, 0.0, 0.0], [0.0, 0.0, forward]])
        lift = [
            fly(s, hovering(s, positions(2), vel), LEVEL[:1].repeat(2, axis=1), dt).vel[0, :, 2]
            for s in (made, SIMULATORS[name]())
        ]
        np.testing.assert_allclose(lift[0] - lift[1], [k * forward**2 * dt, 0.0], rtol=0.02)


@pytest.mark.parametrize(
    ("effect", "values", "vel", "force"),
    [
        ("translational_lift", {"k": 0.2}, [2.0, 0.0, 0.0], [0.0, 0.0, 0.8]),
        ("rotor_drag", {"axial": 1.0, "lateral": 0.5}, [2.0, 0.0, 1.0], [-1.0, 0.0, -1.0]),
    ],
)
def test_air_on_the_rotors_acts_amid_them(effect, values, vel, force):
    """Torque of the force that a level drone feels about a centre of mass at (2, 3) mm."""
    made, mass = RotorDrag if effect == "rotor_drag" else TranslationalLift, HOVER / GRAVITY
    vehicle = SIMULATORS["crazyflow"]().spec.vehicle(drag=True)
    vehicle = eqx.tree_at(lambda v: v.center_of_mass, vehicle, jnp.asarray([2e-3, 3e-3, 0.0]))
    flight = hover_flight(positions(1), jnp.asarray([vel]))
    _, pushed, torque = made(**values).wrench(None, flight, vehicle, 0.002)
    np.testing.assert_allclose(pushed[0] / mass, force, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(torque[0], np.cross([-2e-3, -3e-3, 0.0], pushed[0]), rtol=1e-4)
