"""Yaw misalignment: the drone holds a heading that is off the commanded one by an angle."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import DEGREES, Change, EffectCard, Input, Shown
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
        physics="The drone's forward axis is turned against the one that the logs assume.",
        more="a yaw misalignment of {}",
        less="a yaw misalignment of -{}",
        shown={"angle": Shown("angle", DEGREES, "°")},
        inputs=frozenset({Input.ATTITUDE_CMD}),
        local=True,
        check="look at the forward axis of the motion capture's rigid body, and at the compass",
        changes=(
            Change(
                autopilot="px4",
                parameter="SENS_BOARD_Z_OFF",
                where="board's yaw; not if motion capture gives the heading: turn its body there",
                gains={"angle": DEGREES},
                unit="°",
            ),
            Change(
                autopilot="crazyflie",
                parameter="imu_sensors.imuPsi",
                where="Crazyflie 2.1 and Brushless; not if motion capture gives the heading",
                gains={"angle": DEGREES},
                unit="°",
            ),
        ),
    )

    def command(
        self, memory: None, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[None, Float[Array, "drones 4"]]:
        yaw = cmd[:, 2:3] + self.angle
        return None, jnp.concatenate([cmd[:, :2], yaw, cmd[:, 3:]], axis=-1)
