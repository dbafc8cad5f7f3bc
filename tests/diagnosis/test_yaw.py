"""Flights whose yaw passes +-pi, where both the log and the command wrap."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flights_for_tests import SIGMA, noisy
from scipy.spatial.transform import Rotation

from diagnosis.decide.prepared import make_likelihood
from diagnosis.logs.flights import FlightLog
from diagnosis.replay.library import make_library
from diagnosis.replay.replay import make_replay
from simulators import registry
from simulators.contract import replayable_class
from simulators.vehicle import CONTROL_DT, GRAVITY

SECONDS = 6.0
RATE = 1.2
"""Rate of the yaw command [rad/s]: once around."""


def nominal(name):
    """A simulator in the steps of its replay."""
    own = {"dt": replayable_class(name).replay_dt} if name == "point_mass" else {}
    return registry.load("simulator", name)(**own)


@functools.cache
def turning(name):
    """A hover that turns, flown under commands that wrap, with noise."""
    simulator = nominal(name)
    t = CONTROL_DT * np.arange(round(SECONDS / CONTROL_DT))
    cmd = np.zeros((len(t), 1, 4))
    cmd[:, 0, 2] = np.angle(np.exp(1j * (2.0 + RATE * t)))
    cmd[:, 0, 3] = simulator.spec.mass * GRAVITY
    state = simulator.reset(jnp.asarray([[0.0, 0.0, 2.0]]), jax.random.key(0))
    held = jnp.repeat(jnp.asarray(cmd[:1]), 200, axis=0)
    state = jax.lax.scan(lambda s, u: (simulator.step_cmd(s, u, CONTROL_DT), None), state, held)[0]

    def step(state, cmd):
        return simulator.step_cmd(state, cmd, CONTROL_DT), simulator.flight(state)

    _, flown = jax.jit(lambda state: jax.lax.scan(step, state, jnp.asarray(cmd)))(state)
    return FlightLog("turning", (noisy(flown, cmd, np.random.default_rng(0)),))


@pytest.mark.parametrize("name", ["point_mass", "crazyflow"])
def test_a_turn_through_pi_is_replayed_within_noise(name):
    flight = turning(name)
    yaw = Rotation.from_quat(flight.drones[0].quat).as_euler("xyz")[:, 2]
    assert np.sum(np.abs(np.diff(yaw)) > 3.0) >= 1
    # The neutral vector alone is flown, so that the program needs no effect.
    library = make_library(nominal(name), registry.names("effect"))
    replay = make_replay(library, replayable_class(name).replay_dt)
    normal = make_likelihood(replay, [flight], SIGMA).normal(replay.library.neutral)
    assert normal.chi2 / normal.dof.sum() == pytest.approx(1.0, abs=0.15)


def test_effects_on_the_command_see_no_jump_where_it_wraps(replay):
    """Slopes of all effects, a delay's too, are those of a log whose yaw command goes on."""
    flight = turning("point_mass")
    (drone,) = flight.drones
    cmd = np.column_stack([drone.cmd[:, :2], np.unwrap(drone.cmd[:, 2]), drone.cmd[:, 3]])
    on = dataclasses.replace(flight, drones=(dataclasses.replace(drone, cmd=cmd),))
    wrapped, straight = (
        make_likelihood(replay, [log], SIGMA).normal(replay.library.neutral) for log in (flight, on)
    )
    np.testing.assert_allclose(wrapped.g, straight.g, rtol=1e-6, atol=1e-6)
    (delay,) = replay.library.indices["delay"]
    # A jump by two pi in a command that is held for 0.02 s would be a hundred times as steep.
    assert wrapped.H[:, delay, delay].max() < 20.0 * np.median(wrapped.H[:, delay, delay])
