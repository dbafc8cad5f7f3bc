"""The contract of every registered simulator, and what ours promise beyond it."""

import jax.numpy as jnp
import numpy as np
import pytest
from flying import (
    HOVER,
    SIMULATORS,
    SPEC,
    both,
    fly,
    fly_from_rest,
    hold,
    hovering,
    positions,
    random_cmds,
)

from bench.conformance.command import findings
from simulators import registry
from simulators.vehicle import ActionSpace


@pytest.mark.parametrize("name", registry.names("simulator"))
def test_it_keeps_the_contract(name):
    found = findings("simulator", registry.load("simulator", name), {}, {})
    assert [x for x in found if x.problem] == []


@both
def test_drones_do_not_act_on_each_other(name):
    cmds = random_cmds(0, 50, 3)
    crowd = fly_from_rest(SIMULATORS[name](), jnp.zeros((3, 3)).at[:, 2].set(3.0), cmds)
    apart = fly_from_rest(SIMULATORS[name](), positions(3).at[:, 2].set(3.0), cmds)
    np.testing.assert_allclose(crowd.vel, apart.vel, rtol=1e-4, atol=2e-5)


@both
def test_the_airframe_and_its_actions_are_those_that_controllers_believe(name):
    assert SIMULATORS[name]().spec == SPEC
    assert SIMULATORS[name]().action_space == ActionSpace()


@both
def test_hover_thrust_holds_the_height(name):
    """From spun-up rotors; what remains is the rounding of the rotor speed."""
    simulator = SIMULATORS[name]()
    flight = fly(simulator, hovering(simulator, positions(3)), hold([0, 0, 0, HOVER], 50, 3))
    np.testing.assert_allclose(flight.pos[-1], positions(3), atol=1e-3)
    np.testing.assert_allclose(flight.thrust, HOVER, rtol=1e-4)
