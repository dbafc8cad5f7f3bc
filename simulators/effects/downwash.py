"""Downwash: the air below a drone pushes others down, a = -strength exp(-d^2 / (2 width^2)).

d is the horizontal distance; contributions of all drones above add up. The push fades in over a
height difference of `GATE`, by the smooth step s^2 (3 - 2 s), so that it is differentiable; it
does not decay with height. A drone alone is not affected.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, Shown
from simulators.effects.contract import Number, WrenchEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle

GATE = 0.05
"""Height difference from which on the full push acts [m]; a guess."""


class Downwash(WrenchEffect):
    """Source: Gaussian profile as in arXiv 2103.02142, without its dependence on height."""

    strength: Number = parameter(
        "m/s^2",
        0.0,
        8.0,
        source="published 5 to 20 gram-force, about 10 on 34 g in arXiv 2003.02992; the bound "
        "is a guess",
    )
    """Specific force straight below a drone [m/s^2]."""
    width: Number = parameter("m", 0.03, 0.3, 0.1, source="published 0.05 to 0.12, rest a guess")
    """Standard deviation of the profile [m]; without effect at zero strength."""

    order: ClassVar[int] = 5
    version: ClassVar[str] = "2"
    card: ClassVar[EffectCard] = EffectCard(
        label="downwash",
        noun="a downwash below other drones",
        physics="The air of a drone overhead pushes the one below down.",
        shown={"width": Shown("width", 1000.0, "mm")},
        inputs=frozenset({Input.NEIGHBOUR}),
        flight="two drones, one passing 0.5 m below the other",
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        # Of drone i (row) below drone j (column); a drone is not above itself.
        offset = flight.pos[None, :, :] - flight.pos[:, None, :]
        above = jnp.clip(offset[..., 2] / GATE, 0.0, 1.0)
        square = jnp.sum(offset[..., :2] ** 2, axis=-1)
        profile = above**2 * (3.0 - 2.0 * above) * jnp.exp(-square / (2.0 * self.width**2))
        push = -self.strength * vehicle.believed_mass * jnp.sum(profile, axis=-1)
        return None, jnp.zeros_like(flight.pos).at[:, 2].set(push), jnp.zeros_like(flight.pos)
