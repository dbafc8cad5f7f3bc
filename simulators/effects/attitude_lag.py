"""First-order lag of commanded roll and pitch, ahead of the simulator's own attitude loop.

tau x' = u - x by backward Euler, h the step:

    x_k+1 = u + tau / (tau + h) (x_k - u),

which is u exactly at tau = 0, with the derivative (x_k - u) / h there: unlike exp(-h / tau), whose
derivatives all vanish at 0, so that a lag could not be told from none by its first derivative.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import CommandEffect, Parameter
from simulators.flight import Flight


class AttitudeLag(CommandEffect):
    """An autopilot that smooths its setpoints. Source: first-order model, a guess."""

    tau: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Time constant [s]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "tau": Parameter(unit="s", low=0.0, high=0.3, neutral=0.0, source="a guess")
    }
    door: ClassVar[str] = "command"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 0
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> Float[Array, "drones 2"]:
        """Lagged roll and pitch [rad], level."""
        return jnp.zeros((n_drones, 2))

    def command(
        self,
        memory: Float[Array, "drones 2"],
        flight: Flight,
        cmd: Float[Array, "drones 4"],
        dt: float,
    ) -> tuple[Float[Array, "drones 2"], Float[Array, "drones 4"]]:
        tilt = cmd[:, :2] + self.tau / (self.tau + dt) * (memory - cmd[:, :2])
        return tilt, jnp.concatenate([tilt, cmd[:, 2:]], axis=-1)
