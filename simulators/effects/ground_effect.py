"""Ground effect: rotors push harder close to the ground at z = 0, along the body's z axis.

With T the thrust, h the height and r the rotor's radius,

    T (1 + c (r / 4 h)^2),    h = max(z, r).
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.algebra.rotation import body_z
from simulators.effects.card import EffectCard, Shown
from simulators.effects.contract import Number, WrenchEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle

ROTOR_RADIUS = 0.0231
"""Radius of a Crazyflie's rotor [m]; source: gym-pybullet-drones, arXiv 2103.02142."""


class GroundEffect(WrenchEffect):
    """Source: Cheeseman and Bennett (1955) to first order, with their 1 left free as `c`."""

    c: Number = parameter(
        "-", 0.0, 20.0, source="published 4 to 16, 11.4 in gym-pybullet-drones (arXiv 2103.02142)"
    )
    """Strength [-]; 1 for a single rotor in theory."""

    order: ClassVar[int] = 4
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="ground effect",
        noun="a ground effect",
        physics="The rotors make more thrust close to the ground.",
        more="a ground effect of strength {}",
        less="a negative ground effect of strength {}",
        shown={"c": Shown("strength c")},
        flight="hover below 0.1 m",
        separated_from={
            "thrust_gain": "hover at 0.05, 0.1, 0.3 and 1 m: ground effect vanishes with height",
            "mass": "hover at 0.05, 0.1, 0.3 and 1 m: ground effect vanishes with height",
        },
        paths={"thrust_gain": "heights", "mass": "heights"},
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        height = jnp.maximum(flight.pos[:, 2], ROTOR_RADIUS)
        extra = self.c * (ROTOR_RADIUS / (4.0 * height)) ** 2 * flight.thrust
        return None, extra[:, None] * body_z(flight.quat), jnp.zeros_like(flight.pos)
