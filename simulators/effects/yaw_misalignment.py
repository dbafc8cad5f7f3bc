"""Yaw misalignment: the drone holds a heading that is off the commanded one by an angle."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import DEGREES, EffectCard, Input, Shown
from simulators.effects.contract import CommandEffect, Parameter
from simulators.flight import Flight


class YawMisalignment(CommandEffect):
    """A heading reference that is turned against the world. Source: constant bias, a guess."""

    angle: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Added to commanded yaw [rad]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "angle": Parameter(unit="rad", low=-0.5, high=0.5, neutral=0.0, source="a guess")
    }
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
