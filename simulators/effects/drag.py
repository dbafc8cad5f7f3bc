"""Linear drag, isotropic: f = -c m v, in the world frame, on top of the simulator's own drag.

Drag that differs along and across the rotors' axis is `rotor_drag`.

Here and in all effects like it m is the mass that the operator believes: a payload does not
change the force of the air.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import Parameter, WrenchEffect
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class Drag(WrenchEffect):
    """Excess aerodynamic drag. Source: paper, Sec. V-C (c = 2.0 1/s)."""

    c: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Drag coefficient over mass [1/s]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "c": Parameter(
            unit="1/s",
            low=-0.5,
            high=3.0,
            neutral=0.0,
            source="real logs 0.33 to 0.44, crazyflow 0.46 and 0.50, paper 2.0; below 0: a "
            "simulator that drags too much",
        )
    }
    door: ClassVar[str] = "wrench"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 0
    version: ClassVar[str] = "2"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        return None, -self.c * vehicle.believed_mass * flight.vel, jnp.zeros_like(flight.vel)
