"""Quadratic drag, isotropic: f = -k m |v| v, in the world frame."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import Parameter, WrenchEffect
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class QuadraticDrag(WrenchEffect):
    """Drag of a bluff body, beside the linear drag of the rotors. Source: Rayleigh's equation."""

    k: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Drag coefficient over mass [1/m]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "k": Parameter(
            unit="1/m",
            low=-0.2,
            high=1.5,
            neutral=0.0,
            source="a guess: 1/2 1.2 kg/m^3 of 0.01 m^2 give 0.14 at 43 g; below 0: a simulator "
            "that drags too much",
        )
    }
    door: ClassVar[str] = "wrench"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 1
    version: ClassVar[str] = "2"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        square = jnp.sum(flight.vel**2, axis=-1, keepdims=True)
        moving = square > 0.0  # the root has no derivative where a drone stands still
        speed = jnp.where(moving, jnp.sqrt(jnp.where(moving, square, 1.0)), 0.0)
        force = -self.k * vehicle.believed_mass * speed * flight.vel
        return None, force, jnp.zeros_like(flight.vel)
