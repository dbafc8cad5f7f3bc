"""Steady wind as a constant specific force: f = m a, in the world frame."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Probe, Shown
from simulators.effects.contract import Number, Parameter, WrenchEffect, declared
from simulators.flight import Flight
from simulators.vehicle import Vehicle

_HORIZONTAL = Parameter(
    unit="m/s^2", low=-3.0, high=3.0, neutral=0.0, source="paper 1.5; twice that is a guess"
)
_VERTICAL = Parameter(unit="m/s^2", low=-1.0, high=1.0, neutral=0.0, source="a guess")


class Wind(WrenchEffect):
    """A persistent directional acceleration. Source: paper, Sec. V-C (1.5 m/s^2)."""

    x: Number = declared(_HORIZONTAL)
    """Specific force along world x [m/s^2]."""
    y: Number = declared(_HORIZONTAL)
    """Specific force along world y [m/s^2]."""
    z: Number = declared(_VERTICAL)
    """Specific force along world z [m/s^2]."""

    order: ClassVar[int] = 1
    version: ClassVar[str] = "2"
    card: ClassVar[EffectCard] = EffectCard(
        label="wind",
        noun="a steady wind push",
        physics="A steady push of the air in a fixed direction of the world.",
        shown={"x": Shown("x"), "y": Shown("y"), "z": Shown("z")},
        families=("push of the air",),
        local=True,
        separated_from={
            "gust": "10 s of hover that begin well before the disturbance does",
        },
        paths={"gust": "hover"},
        probe=Probe("wrench", {"x": 3.0, "y": -2.0}),
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        force = vehicle.believed_mass * jnp.stack([self.x, self.y, self.z])
        return None, jnp.broadcast_to(force, flight.pos.shape), jnp.zeros_like(flight.pos)
