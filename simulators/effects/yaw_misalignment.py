"""Yaw misalignment: the drone holds a heading that is off the commanded one by an angle."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import DEGREES, EffectCard, Input, Shown
from simulators.effects.contract import CommandEffect, Number, parameter
from simulators.flight import Flight


class YawMisalignment(CommandEffect):
    """A heading reference that is turned against the world. Source: constant bias, a guess."""

    angle: Number = parameter("rad", -0.5, 0.5, source="a guess")
    """Added to commanded yaw [rad]."""

    order: ClassVar[int] = 3
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="yaw misalignment",
        noun="a yaw misalignment",
        physics=(
            "The drone's heading and its tilts are turned together against the world in which they "
            "are commanded."
        ),
        more="a yaw misalignment of {}",
        less="a yaw misalignment of -{}",
        shown={"angle": Shown("angle", DEGREES, "°")},
        inputs=frozenset({Input.ATTITUDE_CMD}),
        local=True,
        check=(
            "look at what tells the drone its heading: the compass and its declination, the "
            "estimator's initial yaw, the yaw between the motion capture's world and that of the "
            "commands"
        ),
    )

    def command(
        self, memory: None, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[None, Float[Array, "drones 4"]]:
        yaw = cmd[:, 2:3] + self.angle
        return None, jnp.concatenate([cmd[:, :2], yaw, cmd[:, 3:]], axis=-1)
