"""Drones that touch in a simulator: what its integrator makes of the contact."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import EFFECTS, HOVER, fly, hold, restore

from simulators import registry
from simulators.contract import with_effects
from simulators.effects.contract import StiffEffect, WrenchEffect
from simulators.flight import Flight
from simulators.vehicle import GRAVITY

NAMES = ("point_mass", "crazyflow", "rotorpy")
every = pytest.mark.parametrize("name", NAMES)


def simulator_of(name, **collision):
    # A point mass that is stepped by 20 ms meets an impact in one or two steps, see below.
    settings = {"dt": 0.004} if name == "point_mass" else {}
    nominal = registry.load("simulator", name)(**settings)
    return with_effects(nominal, [EFFECTS["collision"](**collision)]) if collision else nominal


def approach(simulator, pos, vel, seconds=0.4):
    """Flights of hovering drones that drift, every control step."""
    pos, vel = jnp.asarray(pos, float), jnp.asarray(vel, float)
    n, thrust = len(pos), simulator.spec.mass * GRAVITY
    level = jnp.zeros((n, 4)).at[:, 3].set(1.0)
    zeros = jnp.zeros((n, 3))
    flight = Flight(jnp.asarray(0.0), pos, vel, level, zeros, jnp.full(n, thrust), zeros)
    cmd = [0.0, 0.0, 0.0, thrust]
    state = restore(simulator, flight, hold(cmd, 50, n))
    flight = fly(simulator, state, hold(cmd, 20, n))  # as long always, which is one program
    return jax.tree.map(lambda x: x[: round(seconds / 0.02)], flight)


HEAD_ON = [[0.0, 0.0, 3.0], [0.36, 0.0, 3.0]], [[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]]


def rate(flight):
    return np.asarray(flight.vel[:, 1, 0] - flight.vel[:, 0, 0])


def test_a_point_mass_of_long_steps_loses_part_of_an_elastic_impact():
    """An impact lasts 33 ms, a step 20 ms: the rate that is left depends on where it begins."""
    nominal = registry.load("simulator", "point_mass")()
    effect = EFFECTS["collision"](radius=0.15, restitution=1.0)
    left = [
        rate(approach(with_effects(nominal, [effect]), [[0, 0, 3], [x, 0, 3]], HEAD_ON[1]))[-1]
        for x in (0.36, 0.365, 0.37, 0.375)
    ]
    assert 0.5 < min(left) < max(left) < 1.02


class Unaligned(WrenchEffect):
    """A contact that is no `StiffEffect`: it sees the positions that the integrator keeps."""

    contact: StiffEffect

    parameters: ClassVar[dict] = {}
    order: ClassVar[int] = 6
    version: ClassVar[str] = "1"

    def init(self, n_drones, dt):
        return self.contact.init(n_drones, dt)

    def wrench(self, memory, flight, vehicle, dt):
        return self.contact.wrench(memory, flight, vehicle, dt)


@pytest.mark.parametrize("name", ["point_mass", "crazyflow"])
def test_positions_of_another_instant_would_feed_energy(name):
    """Why the contact is a `StiffEffect`."""
    assert issubclass(EFFECTS["collision"], StiffEffect)
    apart = rate(approach(simulator_of(name), *HEAD_ON))[-1]
    contact = EFFECTS["collision"](radius=0.15, restitution=1.0)
    made = with_effects(simulator_of(name), [Unaligned(contact)])
    bounced = rate(approach(made, *HEAD_ON))[-1]
    assert abs(bounced / apart + 1.0) > 0.05


@every
@pytest.mark.parametrize(("restitution", "tolerance"), [(0.2, 0.04), (0.6, 0.04), (1.0, 0.02)])
def test_an_impact_of_one_metre_a_second_keeps_its_restitution(name, restitution, tolerance):
    """Of the rate of drones that pass through each other: drag takes the same of both."""
    apart = rate(approach(simulator_of(name), *HEAD_ON))[-1]
    made = simulator_of(name, radius=0.15, restitution=restitution)
    left = rate(approach(made, *HEAD_ON))[-1] / -apart
    # Drag slows the drones before they meet, and slower impacts keep more.
    assert left == pytest.approx(restitution, abs=tolerance)


@every
def test_momentum_is_that_of_drones_that_do_not_touch(name):
    pos, vel = HEAD_ON
    pos = [pos[0], [0.34, 0.05, 3.0]]
    free = approach(simulator_of(name), pos, vel, 0.1)
    pushed = approach(simulator_of(name, radius=0.15, friction=0.0), pos, vel, 0.1)
    assert jnp.abs(free.vel - pushed.vel).max() > 0.2
    # Drag and tilt act on other velocities after the impact, which weigh little in 0.1 s.
    total = jnp.sum(pushed.vel - free.vel, axis=1)
    assert jnp.abs(total).max() < 0.02


def test_a_drone_dropped_on_its_clearance_bounces_and_comes_to_rest():
    made = simulator_of("point_mass", clearance=0.1, restitution=0.5)
    pos, zero = jnp.asarray([[0.0, 0.0, 0.4]]), jnp.zeros((1, 3))
    level = jnp.zeros((1, 4)).at[:, 3].set(1.0)
    flight = Flight(jnp.asarray(0.0), pos, zero, level, zero, jnp.zeros(1), zero)
    state = restore(made, flight, hold([0, 0, 0, 0], 5))
    z = np.asarray(fly(made, state, hold([0, 0, 0, 0], 300)).pos[:, 0, 2])
    assert z.min() > 0.05
    assert z[13:40].max() > z[-1] + 0.01
    # At rest the weight presses it in by (m g / k)^(2/3).
    assert z[-1] == pytest.approx(0.1 - (HOVER / 2000.0) ** (2 / 3), abs=1e-3)


@pytest.mark.parametrize("name", ["crazyflow", "rotorpy"])
def test_drones_that_graze_each_other_are_turned_by_friction(name):
    pos, vel = [[0.0, 0.0, 3.0], [0.28, -0.05, 3.0]], [[0.2, -0.8, 0.0], [-0.2, 0.8, 0.0]]
    smooth = approach(simulator_of(name, radius=0.15, friction=0.0), pos, vel, 0.06)
    rough = approach(simulator_of(name, radius=0.15, friction=0.5), pos, vel, 0.06)
    assert jnp.abs(smooth.ang_vel[..., 2]).max() < 0.1
    yaw_rate = rough.ang_vel[..., 2]
    assert jnp.abs(yaw_rate).max() > 1.0
    assert jnp.abs(yaw_rate).max() < 0.8 / 0.15 * 1.2  # no faster than rolling


# `make test` has gradients of RotorPy in `test_rotorpy.py`.
@pytest.mark.parametrize(
    "name", ["crazyflow", pytest.param("rotorpy", marks=pytest.mark.exhaustive)]
)
def test_derivatives_through_an_impact_equal_finite_differences(name):
    if name == "rotorpy":
        jax.clear_caches()  # of single precision, which JAX hands to double precision within it
    with jax.enable_x64(True):
        made = simulator_of(name, radius=0.15, restitution=0.5, friction=0.3)
        pos, vel = jnp.asarray([[0.0, 0.0, 3.0], [0.32, 0.08, 3.05]]), jnp.asarray(HEAD_ON[1])

        @jax.jit
        @jax.value_and_grad
        def end(change):
            flown = approach(made, pos + change, vel, 0.1)
            return jnp.sum(jnp.cos(jnp.arange(6.0)).reshape(2, 3) * flown.pos[-1])

        unit = jnp.asarray([[0.3, -0.2, 0.1], [0.5, 0.4, -0.6]])
        _, slope = end(jnp.zeros((2, 3)))
        exact = float(jnp.sum(slope * unit))
        h = 1e-6
        numeric = float((end(h * unit)[0] - end(-h * unit)[0]) / (2.0 * h))
        assert exact == pytest.approx(numeric, rel=1e-5)
        assert abs(exact - float(jnp.sum(jnp.cos(jnp.arange(6.0)).reshape(2, 3) * unit))) > 0.1
