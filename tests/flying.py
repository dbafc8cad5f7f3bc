"""Flights that several test modules share; one compiled program per simulator and shape."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from simulators import registry
from simulators.contract import with_effects
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, GRAVITY, VEHICLES

SPEC = VEHICLES["cf21B_500"]
HOVER = SPEC.mass * GRAVITY
SIMULATORS = {name: registry.load("simulator", name) for name in ("point_mass", "crazyflow")}
"""The twins, which believe the same airframe; RotorPy flies another (`test_rotorpy.py`)."""
EFFECTS = registry.load_all("effect")
TASKS = registry.load_all("task")
KEY = jax.random.key(0)
DT = {"point_mass": 0.02, "crazyflow": 0.002}
"""Integration step [s]."""
OWN_DRAG = {"point_mass": np.zeros(3), "crazyflow": np.asarray(SPEC.drag) / SPEC.mass}
"""Decay rates of velocity [1/s] without any effect."""
both = pytest.mark.parametrize("name", SIMULATORS)


@eqx.filter_jit
def fly(simulator, state, cmds, duration=CONTROL_DT):
    """Flights after each of `cmds` [steps, drones, 4], with a leading time axis."""

    def step(state, cmd):
        state = simulator.step_cmd(state, cmd, duration)
        return state, simulator.flight(state)

    return jax.lax.scan(step, state, cmds)[1]


def fly_from_rest(simulator, pos, cmds):
    """Flights of a team that starts at rest at `pos`."""
    return fly(simulator, simulator.reset(pos, KEY), cmds)


def hover_flight(pos, vel=None):
    """A level flight that carries its weight, moving at `vel` [m/s]."""
    level = jnp.zeros((len(pos), 4)).at[:, 3].set(1.0)
    return Flight(
        t=jnp.asarray(0.0),
        pos=pos,
        vel=jnp.zeros_like(pos) if vel is None else vel,
        quat=level,
        ang_vel=jnp.zeros_like(pos),
        thrust=jnp.full(len(pos), HOVER),
        torque=jnp.zeros_like(pos),
    )


@eqx.filter_jit
def hovering(simulator, pos, vel=None):
    """The state of a team that has hovered at `pos`, rotors spun up."""
    history = hold([0.0, 0.0, 0.0, HOVER], 50, len(pos))
    return simulator.restore(hover_flight(pos, vel), history, KEY)


@eqx.filter_jit
def restore(simulator, flight, cmd_history):
    """The state at a recorded flight."""
    return simulator.restore(flight, cmd_history, KEY)


def hold(cmd, steps, n_drones=1):
    """The same command for all drones over `steps` control steps."""
    return jnp.broadcast_to(jnp.asarray(cmd, float), (steps, n_drones, 4))


def random_cmds(seed, steps, n_drones, yaw=0.0):
    """Commands around hover, a new one at every step: tilts in +-0.2 rad, thrust +-15 %."""
    noise = jax.random.uniform(jax.random.key(seed), (steps, n_drones, 4), minval=-1.0)
    return noise * jnp.asarray([0.2, 0.2, yaw, 0.15 * HOVER]) + jnp.asarray([0, 0, 0, HOVER])


def positions(n_drones):
    """Distinct places 1 m apart and well above the floor."""
    i = jnp.arange(n_drones, dtype=float)
    return jnp.stack([i, 0.3 * i**2, 3.0 + 0.1 * i], axis=-1)


def doors_of(simulator, effect):
    """Whether a simulator has every hook that an effect needs."""
    return {effect.door, *effect.needs} <= set(simulator.doors)


def attached(simulator, **parameters):
    """`simulator` with effects by name, each given as a dictionary of its parameters."""
    return with_effects(simulator, [EFFECTS[name](**p) for name, p in parameters.items()])


def assert_near(a, b, **tolerance):
    """Fails unless two trees, such as flights, are alike within the tolerance of NumPy."""
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, **tolerance), a, b)
