"""Mass: m = m_nominal (1 + e), with the inertia about the centre of mass unchanged."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import Parameter, PlantEffect
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class Mass(PlantEffect):
    """A vehicle heavier or lighter than believed. Source: paper, Sec. V-C (+20 %)."""

    e: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess mass [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "e": Parameter(
            unit="-",
            low=-0.3,
            high=0.6,
            neutral=0.0,
            factor=True,
            source="27 g (URDF) to 32.8 g (crazyflow) for one airframe, payloads of 5 to 10 g",
        )
    }
    door: ClassVar[str] = "plant"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 0
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        mass = vehicle.mass * (1.0 + self.e)
        return None, eqx.tree_at(lambda v: v.mass, vehicle, mass)
