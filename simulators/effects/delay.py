"""Transport delay of the command: u_eff(t) = u(t - d), linear between integration steps.

A buffer of fixed length holds the last commands; the delayed one is interpolated between the two
entries around d / dt, so the output is differentiable in d everywhere but at whole steps.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import CommandEffect, Parameter
from simulators.flight import Flight

LONGEST = 0.1
"""Longest delay that the buffer holds [s]."""


class Delay(CommandEffect):
    """Latency between the policy and the autopilot. Source: 0 to 60 ms in radio-linked fleets."""

    seconds: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Delay [s], at most `LONGEST`."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "seconds": Parameter(
            unit="s", low=0.0, high=LONGEST, neutral=0.0, source="published 0 to 60 ms"
        )
    }
    door: ClassVar[str] = "command"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 9
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> tuple[Float[Array, "steps drones 4"], Array]:
        """Past commands, newest first, and whether the buffer holds a first command yet."""
        return jnp.zeros((round(LONGEST / dt) + 2, n_drones, 4)), jnp.asarray(0.0)

    def command(
        self,
        memory: tuple[Float[Array, "steps drones 4"], Array],
        flight: Flight,
        cmd: Float[Array, "drones 4"],
        dt: float,
    ) -> tuple[tuple[Float[Array, "steps drones 4"], Array], Float[Array, "drones 4"]]:
        past, started = memory
        past = jnp.where(started > 0, jnp.roll(past, 1, axis=0).at[0].set(cmd), cmd)
        lag = self.seconds / dt
        whole = jnp.clip(jnp.floor(lag).astype(int), 0, past.shape[0] - 2)
        part = lag - whole
        delayed = past[whole] * (1.0 - part) + past[whole + 1] * part
        return (past, jnp.ones_like(started)), delayed
