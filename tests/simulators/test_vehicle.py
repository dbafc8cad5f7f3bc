"""The airframes' constants are those of crazyflow, and the action space is one for all."""

import dataclasses
import importlib.util
import pathlib
import tomllib

import jax.numpy as jnp
import numpy as np
import pytest
from flying import SPEC, attached, fly, hold, hover_flight, positions, restore

from simulators.crazyflow import Crazyflow
from simulators.vehicle import GRAVITY, VEHICLES, ActionSpace

PACKAGE = pathlib.Path(importlib.util.find_spec("crazyflow").submodule_search_locations[0])


def parameters(path):
    return tomllib.loads((PACKAGE / path).read_text())


every_vehicle = pytest.mark.parametrize("name", VEHICLES)


@every_vehicle
def test_the_rotors_lag_is_crazyflows_in_hover(name):
    spec, ours = parameters("dynamics/first_principles/params.toml")[name], VEHICLES[name]
    c, b, a = spec["rpm2thrust"]
    each = GRAVITY * spec["mass"] / 4.0
    hover = (-b + np.sqrt(b**2 - 4.0 * a * (c - each))) / (2.0 * a)
    linear, quadratic, *_ = spec["rotor_dyn_coef"]
    assert ours.rotor_lag == pytest.approx(1.0 / (linear + 2.0 * quadratic * hover), rel=1e-6)


@every_vehicle
def test_the_thrust_range_is_that_of_the_attitude_controller(name):
    core, ours = parameters("control/mellinger/params.toml")[name]["core"], VEHICLES[name]
    idle = core["pwm_min"] / core["pwm_max"]
    assert ours.thrust_min == pytest.approx(4 * idle * core["thrust_max"], rel=1e-12)
    assert ours.thrust_min == pytest.approx(4 * core["thrust_min"], rel=1e-12)
    assert ours.thrust_max == pytest.approx(4 * core["thrust_max"], rel=1e-12)


def test_gravity_is_crazyflows():
    assert parameters("dynamics/params.toml")["gravity_vec"] == [0.0, 0.0, -GRAVITY]


@every_vehicle
def test_the_nominal_plant_has_no_fault(name):
    vehicle = VEHICLES[name].vehicle(drag=False)
    assert not vehicle.drag.any()
    assert not vehicle.center_of_mass.any()
    assert float(vehicle.thrust_gain) == float(vehicle.motor_lag_scale) == 1.0
    np.testing.assert_allclose(VEHICLES[name].vehicle(drag=True).drag, VEHICLES[name].drag)


def test_the_corners_of_the_action_space_are_the_limits_of_the_command():
    space = ActionSpace()
    low, high = space.to_cmd(jnp.asarray([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]))
    np.testing.assert_allclose(low, [-0.5, -0.5, 0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(high, [0.5, 0.5, 0.0, 0.8])


def test_to_action_inverts_to_cmd():
    action = jnp.asarray([[0.3, -0.8, 0.1], [-1.0, 0.0, 0.9], [1.4, 0.2, -1.0]])
    space = ActionSpace()
    np.testing.assert_allclose(space.to_action(space.to_cmd(action)), action, atol=1e-6)


@every_vehicle
def test_the_hover_action_carries_the_weight(name):
    space, mass = ActionSpace(thrust_max=VEHICLES[name].thrust_max), VEHICLES[name].mass
    cmd = space.to_cmd(jnp.asarray([[0.0, 0.0, space.hover(mass)]]))
    np.testing.assert_allclose(cmd, [[0.0, 0.0, 0.0, mass * GRAVITY]], rtol=1e-6)


def test_crazyflow_weighs_what_its_airframe_says():
    """Also without any effect, which is then the same as a neutral one."""
    nominal = Crazyflow(spec=dataclasses.replace(SPEC, mass=0.06))
    carrying, pos = [0.0, 0.0, 0.0, 0.06 * GRAVITY], positions(1)
    flown, neutral = (
        fly(made, restore(made, hover_flight(pos), hold(carrying, 50)), hold(carrying, 10))
        for made in (nominal, attached(nominal, mass={}))
    )
    assert np.abs(flown.vel[-1, 0, 2]) < 1e-3
    np.testing.assert_array_equal(flown.vel, neutral.vel)
