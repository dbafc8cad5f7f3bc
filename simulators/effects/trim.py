"""Trim: constant angles on top of commanded roll and pitch."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import CommandEffect, Parameter
from simulators.flight import Flight

_ANGLE = Parameter(
    unit="rad",
    low=-0.1,
    high=0.1,
    neutral=0.0,
    source="published 0 to 2 degrees (0.035); the bounds are a guess",
)


class Trim(CommandEffect):
    """A level that is not level: a tilted sensor or mount. Source: constant bias."""

    roll: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Added to commanded roll [rad]."""
    pitch: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Added to commanded pitch [rad]."""

    parameters: ClassVar[dict[str, Parameter]] = {"roll": _ANGLE, "pitch": _ANGLE}
    door: ClassVar[str] = "command"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 2
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def command(
        self, memory: None, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[None, Float[Array, "drones 4"]]:
        tilt = cmd[:, :2] + jnp.stack([self.roll, self.pitch])
        return None, jnp.concatenate([tilt, cmd[:, 2:]], axis=-1)
