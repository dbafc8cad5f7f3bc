"""Gust: a constant specific force from an onset on, f = m a for t >= onset, world frame.

The step [t, t + dt] that contains the onset carries the part of the force that lies after it,

    f = m a clip((t + dt - onset) / dt, 0, 1),

so the impulse depends on the onset continuously and differentiably.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Shown
from simulators.effects.contract import (
    Number,
    OnsetEffect,
    Parameter,
    WrenchEffect,
    declared,
    parameter,
)
from simulators.flight import Flight
from simulators.vehicle import Vehicle

_HORIZONTAL = Parameter(
    unit="m/s^2", low=-3.0, high=3.0, neutral=0.0, source="as steady wind: 1.5, twice is a guess"
)
_VERTICAL = Parameter(unit="m/s^2", low=-1.0, high=1.0, neutral=0.0, source="a guess")


class Gust(WrenchEffect, OnsetEffect):
    """Wind that sets in during a flight. Source: a step, the simplest onset; a guess."""

    x: Number = declared(_HORIZONTAL)
    """Specific force along world x [m/s^2]."""
    y: Number = declared(_HORIZONTAL)
    """Specific force along world y [m/s^2]."""
    z: Number = declared(_VERTICAL)
    """Specific force along world z [m/s^2]."""
    onset: Number = parameter("s", 0.0, 600.0, source="any time in a battery's flight")
    """Time since the reset at which it sets in [s]; without effect while the force is zero."""

    order: ClassVar[int] = 3
    version: ClassVar[str] = "2"
    card: ClassVar[EffectCard] = EffectCard(
        label="gust",
        noun="a wind push that sets in during the flight",
        physics="A push of the air in a fixed direction of the world, from a certain moment on.",
        shown={"x": Shown("x"), "y": Shown("y"), "z": Shown("z")},
        families=("push of the air",),
        special_cases=("wind",),  # from the start
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        part = jnp.clip((flight.t + dt - self.onset) / dt, 0.0, 1.0)
        force = vehicle.believed_mass * part * jnp.stack([self.x, self.y, self.z])
        return None, jnp.broadcast_to(force, flight.pos.shape), jnp.zeros_like(flight.pos)
