"""Two effects as another package would bring them: one with a card, one without."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Shown
from simulators.effects.contract import (
    Number,
    OnsetEffect,
    Parameter,
    PlantEffect,
    WrenchEffect,
    parameter,
)
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class Updraft(WrenchEffect):
    """Air that rises along x: f = k m x e_z; an example, no source."""

    k: Number = parameter("1/s^2", -2.0, 2.0, source="a guess")
    """Gradient of the specific force [1/s^2]."""

    order: ClassVar[int] = 20
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="rising air",
        noun="air that rises on one side",
        physics="Air rises the faster, the further forward the drone flies.",
        more="air that rises by {} with the distance",
        less="air that sinks by {} with the distance",
        shown={"k": Shown("gradient", 100.0, "cm/s² a metre")},
        families=("push of the air",),
        flight="hover at x = -1, 0 and 1 m",
        separated_from={"wind": "hover on both sides of the room: a wind pushes alike on both"},
        drawn=({"k": 0.1}, {"k": 0.3}, {"k": 0.8}),
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        force = jnp.zeros_like(flight.pos)
        force = force.at[:, 2].set(self.k * vehicle.believed_mass * flight.pos[:, 0])
        return None, force, jnp.zeros_like(flight.pos)


class BrokenBlade(PlantEffect, OnsetEffect):
    """Thrust that is lost from a moment on; an example, no source."""

    e: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative loss of thrust [-]."""
    onset: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Time since the reset at which the blade breaks [s]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "e": Parameter(unit="-", low=-0.3, high=0.3, neutral=0.0, source="a guess"),
        "onset": Parameter(unit="s", low=0.0, high=600.0, neutral=0.0, source="a guess"),
    }
    order: ClassVar[int] = 20
    version: ClassVar[str] = "1"

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        part = jnp.clip((flight.t + dt - self.onset) / dt, 0.0, 1.0)
        gain = vehicle.thrust_gain * (1.0 - self.e * part)
        return None, eqx.tree_at(lambda v: v.thrust_gain, vehicle, gain)
