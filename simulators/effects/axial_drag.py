"""Linear drag along the rotor axis b only: f = -c m (v . b) b, what makes drag anisotropic."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import Parameter, WrenchEffect
from simulators.flight import Flight
from simulators.rotation import rotate
from simulators.vehicle import Vehicle


class AxialDrag(WrenchEffect):
    """Thrust lost to inflow through climbing rotors. Source: RotorPy (2023), its k_z."""

    c: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Drag coefficient along the axis, beyond that of all directions, over mass [1/s]."""

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
        return None, -self.c * vehicle.mass * along * up, jnp.zeros_like(flight.vel)
