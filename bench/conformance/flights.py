"""Short flights in which a plug-in is watched; one compiled program for each of its shapes."""

from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bench.conformance.suite import close, demand, shapes
from simulators.contract import AbstractSimulator
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, GRAVITY

N_DRONES, STEPS, HISTORY = 3, 25, 10
KEY = jax.random.key(0)


def apart(n_drones: int = N_DRONES) -> Float[Array, "drones 3"]:
    """Distinct places about 1 m apart and well above the floor [m]."""
    i = jnp.arange(n_drones, dtype=float)
    return jnp.stack([i, 0.3 * i**2, 3.0 + 0.1 * i], axis=-1)


def crowded() -> Float[Array, "drones 3"]:
    """A team within each other's downwash, low, the first drone nearly on the floor [m]."""
    return (apart() * jnp.asarray([0.1, 0.1, 1.0])).at[:, 2].add(-2.5).at[0, 2].set(0.06)


def hover_thrust(simulator: AbstractSimulator) -> float:
    """Thrust that carries the nominal vehicle [N]."""
    return simulator.spec.mass * GRAVITY


def wild_cmds(simulator: AbstractSimulator, seed: int = 0) -> Float[Array, "time drones 4"]:
    """A new command around hover at every step; the first drone sinks."""
    noise = jax.random.uniform(jax.random.key(seed), (STEPS, N_DRONES, 4), minval=-1.0)
    hover = hover_thrust(simulator)
    cmds = noise * jnp.asarray([0.2, 0.2, 0.3, 0.15 * hover]) + jnp.asarray([0.0, 0.0, 0.0, hover])
    return cmds.at[:, 0, 3].multiply(0.5)


def hover_flight(simulator: AbstractSimulator, pos: Float[Array, "drones 3"]) -> Flight:
    """A level flight at rest that carries its weight."""
    zeros = jnp.zeros_like(pos)
    return Flight(
        t=jnp.asarray(0.0, pos.dtype),
        pos=pos,
        vel=zeros,
        quat=jnp.zeros((len(pos), 4), pos.dtype).at[:, 3].set(1.0),
        ang_vel=zeros,
        thrust=jnp.full(len(pos), hover_thrust(simulator), pos.dtype),
        torque=zeros,
    )


def hovering(simulator: AbstractSimulator, pos: Float[Array, "drones 3"]) -> object:
    """The state of a team that has hovered at `pos`."""
    hover = jnp.asarray([0.0, 0.0, 0.0, hover_thrust(simulator)], pos.dtype)
    history = jnp.broadcast_to(hover, (HISTORY, len(pos), 4))
    return simulator.restore(hover_flight(simulator, pos), history, KEY)


def flown(
    simulator: AbstractSimulator, pos: Float[Array, "drones 3"], cmds: Float[Array, "time drones 4"]
) -> Flight:
    """Flights after each command, from hover, with a leading time axis."""

    def step(state: object, cmd: Array) -> tuple[object, Flight]:
        state = simulator.step_cmd(state, cmd, CONTROL_DT)
        return state, simulator.flight(state)

    return jax.lax.scan(step, hovering(simulator, pos), cmds)[1]


fly = eqx.filter_jit(flown)
"""`flown` as one compiled program."""
fly_worlds = eqx.filter_jit(eqx.filter_vmap(flown, in_axes=(None, 0, 0)))
"""The same in many worlds at once."""


def demand_structure(simulator: AbstractSimulator, what: str) -> None:
    """Demands that a step and a restore give what a reset gives; `what` they would change."""
    pos, cmd = apart(), wild_cmds(simulator)[0]
    state = jax.eval_shape(lambda: simulator.reset(pos, KEY))
    stepped = jax.eval_shape(lambda s: simulator.step_cmd(s, cmd, CONTROL_DT), state)
    restored = jax.eval_shape(lambda: hovering(simulator, pos))
    for done, other in (("step", stepped), ("restore", restored)):
        demand(
            jax.tree.structure(other) == jax.tree.structure(state)
            and shapes(other) == shapes(state),
            f"a {done} changes {what} (structure, shapes or types): {shapes(state)} becomes "
            f"{shapes(other)}",
        )


def demand_worlds(simulator: AbstractSimulator) -> None:
    """Demands that each of two worlds flies as it does alone."""
    pos = jnp.stack([apart(), crowded()])
    cmds = jnp.stack([wild_cmds(simulator, seed=seed) for seed in range(2)])
    together = fly_worlds(simulator, pos, cmds)
    for i in range(2):
        demand(
            close(jax.tree.map(lambda x, i=i: x[i], together), fly(simulator, pos[i], cmds[i])),
            f"world {i} of two flies differently than alone; write for one world and keep nothing "
            "outside the state",
        )


def demand_renumbering(
    simulator: AbstractSimulator, pos: Float[Array, "drones 3"], names: Iterable[str]
) -> None:
    """Demands that these parts of a flight from `pos` do not depend on the drones' numbers."""
    cmds, order = wild_cmds(simulator), np.array([2, 0, 1])
    straight, turned = fly(simulator, pos, cmds), fly(simulator, pos[order], cmds[:, order])
    for name in names:
        demand(
            close(getattr(turned, name), getattr(straight, name)[:, order]),
            f"`flight().{name}` depends on the numbers of the drones, not only on where they are",
        )
