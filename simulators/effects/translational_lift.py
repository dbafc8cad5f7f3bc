"""Translational lift: f = k m |v across b|^2 b along the rotor axis b, amid the rotors."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import Parameter, WrenchEffect
from simulators.flight import Flight
from simulators.rotation import along, body_z
from simulators.vehicle import Vehicle


class TranslationalLift(WrenchEffect):
    """Thrust gained by flying forward. Source: RotorPy (2023), its k_h; Svacha et al. (2017)."""

    k: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Lift over mass and squared speed across the axis [1/m]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "k": Parameter(
            unit="1/m",
            low=-0.1,
            high=0.6,
            neutral=0.0,
            source="0.10 in RotorPy's Crazyflie Brushless; the bounds are a guess",
        )
    }
    door: ClassVar[str] = "wrench"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 8
    version: ClassVar[str] = "3"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        up = body_z(flight.quat)
        across = flight.vel - along(up, flight.vel)
        squared = jnp.sum(across**2, axis=-1, keepdims=True)
        force = self.k * vehicle.believed_mass * squared * up
        return None, force, vehicle.at_center(flight.quat, force)
