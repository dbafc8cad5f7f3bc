"""The second reality is RotorPy's own, and is disturbed through RotorPy's own parameters."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotorpy.vehicles.crazyfliebrushless_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

from blind.draw import cases, catalogue
from blind.draw.catalogue import Withheld
from blind.fly import rotorpy_reality as rp
from blind.fly.realities import DT
from blind.score.identifiable import ROTORPY_INERTIA, seen
from simulators import rotorpy_vehicle as rotorpy
from simulators.effects.translational_lift import TranslationalLift
from simulators.flight import Flight
from simulators.vehicle import GRAVITY, VEHICLES

HOVER_SPEED = (rotorpy.AIRFRAME["mass"] * GRAVITY / 4 / rotorpy.AIRFRAME["k_eta"]) ** 0.5
HOVER = rotorpy.AIRFRAME["mass"] * GRAVITY


def disturbance(name=None, **parameters):
    effects = () if name is None else (Withheld(name, parameters),)
    made = catalogue.make_disturbance(effects, 1, np.random.default_rng(0))
    return jax.tree.map(lambda x: x[0], made)


def hover_body():
    return jnp.zeros((1, 17)).at[0, 9].set(1.0).at[0, 13:].set(HOVER_SPEED)


@eqx.filter_jit
def stepped(made, state, cmd):
    """The state one step later, compiled once for all tests, as in flights of the study."""
    return rp.RotorpyReality().step(made, state, cmd)


def acceleration(made, body=None, t=0.0):
    """Mean acceleration over one step under the hover command."""
    reality = rp.RotorpyReality()
    body = hover_body() if body is None else body
    state = reality.start(made, jnp.zeros((1, 3)))
    state = dataclasses.replace(state, body=body, steps=jnp.asarray(round(t / DT)))
    after = stepped(made, state, jnp.asarray([[0.0, 0.0, 0.0, HOVER]]))
    return np.asarray(after.body[0, 3:6] - body[0, 3:6]) / DT


def test_the_undisturbed_vehicle_hovers():
    np.testing.assert_allclose(acceleration(disturbance()), 0.0, atol=1e-3)


def test_wind_pushes_a_hovering_vehicle_with_its_specific_force():
    found = acceleration(disturbance("wind", x=0.5, y=-0.2, z=0.0))
    np.testing.assert_allclose(found, [0.5, -0.2, 0.0], rtol=0.01, atol=1e-3)


def test_a_gust_sets_in_at_its_time():
    made = disturbance("gust", x=0.8, y=0.0, z=0.0, onset=4.0)
    before, after = (acceleration(made, t=t)[0] for t in (3.9, 4.0))
    np.testing.assert_allclose([before, after], [0.0, 0.8], atol=0.01)


@pytest.mark.parametrize(
    ("name", "parameters", "change"),
    [
        ("drag", {"c": 0.4}, -0.4 * 1.5),
        ("quadratic_drag", {"k": 0.3}, -0.3 * 1.5**2),
    ],
)
def test_drag_slows_a_level_vehicle(name, parameters, change):
    body = hover_body().at[0, 3].set(1.5)
    change_found = acceleration(disturbance(name, **parameters), body)[0]
    change_found = change_found - acceleration(disturbance(), body)[0]
    np.testing.assert_allclose(change_found, change, rtol=0.02)


@pytest.mark.parametrize(
    ("name", "parameters", "expected"),
    [
        ("rotor_drag", {"axial": 0.7, "lateral": 0.3}, [-0.3 * 1.5, 0.0, -0.7 * 0.8]),
        ("translational_lift", {"k": 0.12}, [0.0, 0.0, 0.12 * 1.5**2]),
    ],
)
def test_rotors_drag_and_lift(name, parameters, expected):
    body = hover_body().at[0, 3].set(1.5).at[0, 5].set(0.8)
    found = acceleration(disturbance(name, **parameters), body) - acceleration(disturbance(), body)
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=2e-3)


@pytest.mark.parametrize("vel", [[2.0, 0.0, 0.0], [-0.7, 1.1, 0.0]])
def test_lift_turns_a_yawing_vehicle_as_the_library_says(vel):
    """RotorPy's own wrench at four rotors beside `TranslationalLift` on the same arm."""
    k, ang_vel, rotors = 0.25, np.asarray([0.0, 0.0, 1.5]), np.full(4, 1500.0)
    wrenches = []
    for lift in (k, 0.0):
        made = disturbance("translational_lift", k=lift)
        own = Multirotor(
            jax.tree.map(np.asarray, rp.disturbed_airframe(made, jnp.zeros(()))),
            control_abstraction="cmd_ctatt",
        )
        wrenches.append(own.compute_body_wrench(ang_vel, rotors, np.asarray(vel)))
    force, torque = (np.asarray(a) - np.asarray(b) for a, b in zip(*wrenches, strict=True))
    vehicle = eqx.tree_at(
        lambda v: (v.arm, v.believed_mass),
        VEHICLES["cf21B_500"].vehicle(drag=False),
        (jnp.asarray(quad_params["rotor_pos"]["r1"][0]), jnp.asarray(quad_params["mass"])),
    )
    still = jnp.zeros((1, 3))
    level = jnp.asarray([[0.0, 0.0, 0.0, 1.0]])
    turning = jnp.asarray([ang_vel])
    now = Flight(jnp.zeros(()), still, jnp.asarray([vel]), level, turning, jnp.zeros(1), still)
    _, told_force, told_torque = TranslationalLift(k=k).wrench(None, now, vehicle, DT)
    np.testing.assert_allclose(force, told_force[0], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(torque, told_torque[0], rtol=1e-3, atol=1e-8)
    assert np.abs(torque).max() > 1e-5


@pytest.mark.parametrize(
    ("name", "parameters", "lift"),
    [
        ("mass", {"e": 0.25}, 1 / 1.25),
        ("thrust_gain", {"e": -0.1}, 0.9),
        ("battery", {"rate": 0.01}, 0.95),
    ],
)
def test_thrust_over_mass_changes_as_labelled(name, parameters, lift):
    found = acceleration(disturbance(name, **parameters), t=5.0)[2]
    np.testing.assert_allclose(found, (lift - 1.0) * GRAVITY, rtol=0.01)


def test_the_controller_does_not_know_of_a_lost_thrust():
    """Motor speeds are asked for as if the vehicle were undisturbed."""
    reality, cmd = rp.RotorpyReality(), jnp.asarray([[0.0, 0.0, 0.0, HOVER]])
    made = disturbance("thrust_gain", e=-0.2)
    state = reality.start(made, jnp.zeros((1, 3)))
    for _ in range(3):
        state = stepped(made, state, cmd)
    speeds = state.body[0, 13:]
    reference = reality.start(disturbance(), jnp.zeros((1, 3)))
    for _ in range(3):
        reference = stepped(disturbance(), reference, cmd)
    np.testing.assert_allclose(speeds, reference.body[0, 13:], rtol=1e-5)


def test_a_centre_of_mass_ahead_pitches_the_nose_down():
    """As in crazyflow: torque offset x thrust over the inertia, +y for an offset along +x."""
    made = disturbance("center_of_mass", x=0.002, y=0.0)
    reality = rp.RotorpyReality()
    state = dataclasses.replace(reality.start(made, jnp.zeros((1, 3))), body=hover_body())
    state = stepped(made, state, jnp.asarray([[0.0, 0.0, 0.0, HOVER]]))
    expected = 0.002 * HOVER / quad_params["Iyy"] * DT
    np.testing.assert_allclose(state.body[0, 11], expected, rtol=0.05)


def test_cases_fly_and_stay_near_their_targets():
    case = cases.make_case("clean", [], np.random.default_rng(1), reality="rotorpy", n_flights=2)
    for one in cases.fly_case(dataclasses.replace(case, drones=1)):
        assert np.abs(one.true[["pos_x", "pos_y"]].to_numpy()).max() < 1.6
        assert one.true["pos_z"].between(0.5, 1.6).all()


def test_offset_inertia_and_arms_that_grow_together_turn_a_drone_alike():
    """Which is why an offset of the centre of mass counts in crazyflow's inertia."""
    assert (quad_params["Ixx"], quad_params["Iyy"]) == ROTORPY_INERTIA
    offset, speeds = np.asarray([3e-3, -2e-3, 0.0]), HOVER_SPEED * np.asarray([1.1, 0.9, 1.0, 1.2])
    body = jnp.zeros(17).at[9].set(1.0).at[13:].set(speeds)
    turned = []
    for grown in (1.0, 1.3):
        places = {n: grown * (r - offset) for n, r in quad_params["rotor_pos"].items()}
        own = {"rotor_pos": places, "Ixx": grown * 3.3e-5, "Iyy": grown * 3.6e-5}
        vehicle = rotorpy.make_multirotor({**rotorpy.AIRFRAME, **own})
        nothing = jnp.zeros(3)
        turned.append(
            rotorpy.derivative(vehicle, body, jnp.asarray(speeds), nothing, nothing)[10:12]
        )
    assert float(jnp.abs(turned[0]).max()) > 1.0
    np.testing.assert_allclose(turned[0], turned[1], rtol=1e-4)
    told = seen(Withheld("center_of_mass", {"x": 3e-3, "y": -2e-3}), "rotorpy").parameters
    inertia = VEHICLES["cf21B_500"].inertia
    assert told["x"] == pytest.approx(3e-3 * inertia[1] / 3.6e-5)
    assert told["y"] == pytest.approx(-2e-3 * inertia[0] / 3.3e-5)
    assert seen(Withheld("wind", {"x": 0.1}), "rotorpy").parameters == {"x": 0.1}
    assert seen(Withheld("center_of_mass", {"x": 3e-3}), "crazyflow").parameters == {"x": 3e-3}
