"""Commands that come late: u_eff(t) = u(t - d(t)), linear between integration steps.

A buffer of fixed length holds the last commands and their ages; the delayed one is interpolated
between the two entries around the age d, so the output is differentiable in d everywhere but at
whole steps. Commands that follow each other faster than the buffer's step share its newest entry.
"""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import CommandEffect
from simulators.flight import Flight

LONGEST_DELAY_S = 0.1
"""Longest delay that the buffer holds [s]."""

Memory = tuple[Float[Array, "steps drones 4"], Float[Array, " steps"], Float[Array, ""]]


class LateEffect(CommandEffect):
    """Commands that come late; each effect says by how much."""

    @abc.abstractmethod
    def late(self, t: Float[Array, "*n"]) -> Float[Array, "..."]:
        """How old the commands are that take effect at some times after the reset [s]."""

    def init(self, n_drones: int, dt: float) -> Memory:
        """Past commands, newest first, their ages [s], and whether there was a command yet."""
        length = round(LONGEST_DELAY_S / dt) + 2
        age = jnp.arange(length) * (LONGEST_DELAY_S / (length - 2))
        return jnp.zeros((length, n_drones, 4)), age, jnp.asarray(0.0)

    def command(
        self, memory: Memory, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[Memory, Float[Array, "drones 4"]]:
        past, age, started = memory
        past, age = jnp.where(started > 0, past, cmd), age + dt
        early = age[1] < 1.001 * LONGEST_DELAY_S / (len(age) - 2)
        past = jnp.concatenate([cmd[None], jnp.where(early, past[1:], past[:-1])])
        age = jnp.concatenate([jnp.zeros(1), jnp.where(early, age[1:], age[:-1])])
        seconds = self.late(flight.t)
        older = jnp.clip(jnp.searchsorted(age, seconds, side="right"), 1, len(age) - 1)
        part = (seconds - age[older - 1]) / (age[older] - age[older - 1])
        part = jnp.minimum(part, 1.0)  # beyond the buffer, its oldest command
        delayed = past[older - 1] * (1.0 - part) + past[older] * part
        return (past, age, jnp.ones_like(started)), delayed
