"""Crazyflow as a reality; the disturbances are attached through the simulators' contract."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from blind.fly.realities import DT, HOVER, AbstractReality, Disturbance
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.crazyflow_state import CrazyflowState
from simulators.flight import Flight


class CrazyflowReality(AbstractReality):
    """The simulator that the diagnosis calls nominal, disturbed."""

    def start(self, disturbance: Disturbance, pos: Float[Array, "drones 3"]) -> CrazyflowState:
        """A hover of half a second lies behind the drones."""
        n_drones = len(pos)
        still = jnp.zeros((n_drones, 3))
        level = jnp.zeros((n_drones, 4)).at[:, 3].set(1.0)
        thrust = jnp.full(n_drones, HOVER)
        flight = Flight(jnp.asarray(0.0), pos, still, level, still, thrust, still)
        hover = jnp.zeros((25, n_drones, 4)).at[:, :, 3].set(HOVER)
        return _disturbed(disturbance).restore(flight, hover, jax.random.key(0))

    def truth(self, state: CrazyflowState) -> Float[Array, "drones 13"]:
        """As the state has it."""
        return jnp.concatenate([state.pos, state.vel, state.quat, state.ang_vel], axis=1)

    def step(
        self, disturbance: Disturbance, state: CrazyflowState, cmd: Float[Array, "drones 4"]
    ) -> CrazyflowState:
        """One physics step of crazyflow."""
        return _disturbed(disturbance).step_cmd(state, cmd, DT)


def _disturbed(disturbance: Disturbance) -> Crazyflow:
    *own, borrowed = disturbance
    return with_effects(Crazyflow(), [*own, *borrowed])
