"""Attitude gain: commanded roll and pitch act as (1 + g) times their values."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, percent
from simulators.effects.contract import CommandEffect, Number, excess
from simulators.flight import Flight


class AttitudeGain(CommandEffect):
    """A steady tilt other than the commanded one. Source: crazyflow's identified loops."""

    g: Number = excess(
        -0.3, 0.3, "-0.11 (cf21B) and -0.08 (L250) in crazyflow 0.4.0; the bounds are a guess"
    )
    """Relative excess of roll and pitch [-]."""

    order: ClassVar[int] = 1
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="attitude gain",
        noun="another attitude gain",
        physics="The drone tilts more or less than commanded, by a constant factor.",
        more="roll and pitch that come out {} larger than {base}",
        less="roll and pitch that come out {} smaller than {base}",
        shown={"g": percent()},
        inputs=frozenset({Input.ATTITUDE_CMD}),
        flight="attitude steps of 0.3 rad every 0.4 s",
        check="look at limits and scales between the position controller and the attitude loop",
    )

    def command(
        self, memory: None, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[None, Float[Array, "drones 4"]]:
        tilt = cmd[:, :2] * (1.0 + self.g)
        return None, jnp.concatenate([tilt, cmd[:, 2:]], axis=-1)
