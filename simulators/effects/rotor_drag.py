"""Drag along the rotor axis b: f = -c m sqrt(T / m g) (v . b) b with the thrust T.

What makes linear drag anisotropic. It grows with rotor speed, hence with the root of the thrust.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import Parameter, WrenchEffect
from simulators.flight import Flight
from simulators.rotation import rotate
from simulators.vehicle import GRAVITY, Vehicle


class AxialDrag(WrenchEffect):
    """Thrust lost to inflow through climbing rotors. Source: RotorPy (2023), its k_z."""

    c: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Drag along the axis in hover, beyond that of all directions, over mass [1/s]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "c": Parameter(
            unit="1/s",
            low=-0.5,
            high=4.0,
            neutral=0.0,
            source="1.77 along and 0.75 across the axis in RotorPy's Crazyflie Brushless; the "
            "bounds are a guess",
        )
    }
    door: ClassVar[str] = "wrench"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 7
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        up = rotate(flight.quat, jnp.zeros_like(flight.vel).at[:, 2].set(1.0))
        along = jnp.sum(up * flight.vel, axis=-1, keepdims=True)
        turning = flight.thrust > 0.0  # the root has no derivative where the rotors stand still
        lift = jnp.where(turning, flight.thrust, 1.0) / (vehicle.mass * GRAVITY)
        speed = jnp.where(turning, jnp.sqrt(lift), 0.0)[:, None]
        return None, -self.c * vehicle.mass * speed * along * up, jnp.zeros_like(flight.vel)
