"""A floor: a drone below `height` is put back onto it and stands still.

The same rule as crazyflow's own ``clip_floor_pos`` (which sits at z = -0.001 m): all of the
velocity is zeroed, and with it the gradient.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from simulators.effects.card import EffectCard, Probe
from simulators.effects.contract import Number, StateEffect, parameter
from simulators.flight import Flight


class Floor(StateEffect):
    """The ground, for a simulator without one. Source: crazyflow 0.4.0, ``clip_floor_pos``."""

    height: Number = parameter("m", -0.1, 0.1, -float("inf"), source="crazyflow: -0.001")
    """Height of the floor, world z [m]."""

    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="floor",
        noun="a floor",
        physics="The ground stops the drone at a certain height.",
        more="a floor at a height of {}",
        less="a floor at a height of -{}",
        no_candidate="a floor is seen or not; it has no slope to follow",
        probe=Probe("state", {"height": 0.5}),
    )

    def project(self, memory: None, flight: Flight) -> tuple[None, Flight]:
        below = flight.pos[:, 2] < self.height
        # A finite stand-in keeps the height's derivative defined where the floor does not act.
        height = jnp.where(jnp.isfinite(self.height), self.height, 0.0)
        z = jnp.where(below, height, flight.pos[:, 2])
        pos = jnp.concatenate([flight.pos[:, :2], z[:, None]], axis=-1)
        vel = jnp.where(below[:, None], 0.0, flight.vel)
        return None, eqx.tree_at(lambda f: (f.pos, f.vel), flight, (pos, vel))
