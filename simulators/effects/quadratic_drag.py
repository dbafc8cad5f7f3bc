"""Quadratic drag, isotropic: f = -k m |v| v, in the world frame; for k < 0, |v| <= `FASTEST`."""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Shown
from simulators.effects.contract import BrakingEffect, Number, WrenchEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle

FASTEST = 20.0
"""Speed up to which a coefficient below 0 takes drag away in proportion to the speed squared [m/s].

Flights here are slower. Beyond it the push grows in proportion to the speed: with the square, a
drone would be at infinity within an episode. A policy with one such episode is never updated,
because the gradient of the mean is not finite.
"""


class QuadraticDrag(WrenchEffect, BrakingEffect):
    """Drag of a bluff body, beside the linear drag of the rotors. Source: Rayleigh's equation."""

    k: Number = parameter(
        "1/m",
        -0.2,
        1.5,
        source="a guess: 1/2 1.2 kg/m^3 of 0.01 m^2 give 0.14 at 43 g; below 0: a simulator "
        "that drags too much",
    )
    """Drag coefficient over mass [1/m]."""

    order: ClassVar[int] = 1
    version: ClassVar[str] = "2"
    card: ClassVar[EffectCard] = EffectCard(
        label="quadratic drag",
        noun="another quadratic air drag",
        physics="Air brakes the drone in proportion to its speed squared.",
        more="{} more quadratic air drag than {base}",
        less="{} less quadratic air drag than {base}",
        shown={"k": Shown("coefficient k")},
        families=("drag of the air",),
        flight="straight lines at 3 m/s",
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        square = jnp.sum(flight.vel**2, axis=-1, keepdims=True)
        moving = square > 0.0  # the root has no derivative where a drone stands still
        speed = jnp.where(moving, jnp.sqrt(jnp.where(moving, square, 1.0)), 0.0)
        speed = jnp.where(self.k < 0.0, jnp.minimum(speed, FASTEST), speed)
        force = -self.k * vehicle.believed_mass * speed * flight.vel
        return None, force, jnp.zeros_like(flight.vel)

    @staticmethod
    def braking(
        vel: Float[np.ndarray, "*n 3"], values: Mapping[str, float]
    ) -> Float[np.ndarray, "*n 3"]:
        speed = np.maximum(np.linalg.norm(vel, axis=-1, keepdims=True), 1e-6)
        return values["k"] * (speed + vel**2 / speed)
