"""A state restored from a flight record continues that flight."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import (
    HOVER,
    SIMULATORS,
    assert_near,
    attached,
    fly,
    hold,
    hovering,
    positions,
    random_cmds,
    restore,
)

N, STEPS, CUT = 3, 50, 25


def continued(simulator, cmds):
    """A flight after `CUT` steps, and the same restored from its record there."""
    whole = fly(simulator, hovering(simulator, positions(N)), cmds)
    record = jax.tree.map(lambda x: x[CUT - 1], whole)
    state = restore(simulator, record, cmds[:CUT])
    return jax.tree.map(lambda x: x[CUT:], whole), fly(simulator, state, cmds[CUT:])


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_the_point_mass_continues_to_the_rounding(delay):
    """Its only hidden state is the delay's buffer, which the command history fills."""
    simulator = attached(SIMULATORS["point_mass"](), delay={"seconds": delay})
    whole, rest = continued(simulator, random_cmds(3, STEPS, N, yaw=0.3))
    assert_near(whole, rest, atol=1e-5)


def test_crazyflow_continues_to_the_rounding_without_turning():
    """With equal rotors, the command history tells the rotor speeds exactly."""
    upright = random_cmds(3, STEPS, N) * jnp.asarray([0.0, 0.0, 0.0, 1.0])
    whole, rest = continued(SIMULATORS["crazyflow"](), upright)
    np.testing.assert_allclose(rest.pos, whole.pos, atol=2e-5)
    np.testing.assert_allclose(rest.thrust, whole.thrust, rtol=2e-4)


def test_crazyflow_continues_a_smooth_flight_within_a_millimetre():
    """Differences between rotors and the yaw integral are not in the record; the attitude loop
    forgets them within 0.1 s. Roll, pitch and yaw swing by up to 0.2, 0.2 and 0.3 rad.
    """
    swing = jnp.sin(2 * jnp.pi * jnp.arange(STEPS) / STEPS)[:, None, None]
    cmds = random_cmds(3, 1, N, yaw=0.3) * swing * jnp.asarray([1.0, 1.0, 1.0, 0.0])
    cmds = cmds + jnp.asarray([0.0, 0.0, 0.0, HOVER])
    whole, rest = continued(SIMULATORS["crazyflow"](), cmds)
    assert jnp.abs(whole.pos[-1] - whole.pos[0]).max() > 0.1
    np.testing.assert_allclose(rest.pos, whole.pos, atol=1e-3)
    np.testing.assert_allclose(rest.quat, whole.quat, atol=2e-3)


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_crazyflow_continues_a_violent_flight_within_two_centimetres(delay):
    """A new tilt of up to 0.2 rad every 20 ms keeps the rotors far apart, which is the worst case
    for a record without rotor speeds.
    """
    simulator = attached(SIMULATORS["crazyflow"](), delay={"seconds": delay})
    whole, rest = continued(simulator, random_cmds(3, STEPS, N, yaw=0.3))
    assert jnp.abs(rest.pos - whole.pos).max() < 0.02


@pytest.mark.parametrize("name", SIMULATORS)
def test_time_goes_on_where_the_record_stopped(name):
    whole, rest = continued(SIMULATORS[name](), hold([0.0, 0.0, 0.0, HOVER], STEPS, N))
    np.testing.assert_allclose(rest.t, whole.t, atol=1e-5)


@pytest.mark.parametrize("name", SIMULATORS)
def test_a_yaw_command_turns_the_drone(name):
    """Both end at the commanded heading; crazyflow's yaw loop is the slower one."""
    simulator = SIMULATORS[name]()
    cmds = hold([0.0, 0.0, 0.3, HOVER], STEPS, N)
    quat = fly(simulator, hovering(simulator, positions(N)), cmds).quat[-1]
    np.testing.assert_allclose(2 * jnp.arcsin(quat[:, 2]), 0.3, atol=0.06)


@pytest.mark.parametrize("name", SIMULATORS)
def test_a_tilt_acts_in_the_direction_of_the_heading(name):
    """Pitched at a yaw of 90 degrees, a drone flies to +y."""
    simulator = SIMULATORS[name]()
    half, yaw = 0.5**0.5, jnp.pi / 2
    flight = simulator.flight(hovering(simulator, positions(N)))
    quat = jnp.tile(jnp.asarray([0.0, 0.0, half, half]), (N, 1))
    turned = eqx.tree_at(lambda f: f.quat, flight, quat)
    state = restore(simulator, turned, hold([0.0, 0.0, yaw, HOVER], CUT, N))
    vel = fly(simulator, state, hold([0.0, 0.1, yaw, HOVER], STEPS, N)).vel[-1]
    assert (vel[:, 1] > 0.5).all()
    assert (jnp.abs(vel[:, 0]) < 0.05).all()
