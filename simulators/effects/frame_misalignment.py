"""Frame misalignment: roll and pitch commands are meant for a frame that is turned in yaw."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import CRAZYFLIES, DEGREES, EffectCard, Input, Shown, offset
from simulators.effects.contract import CommandEffect, Number, parameter
from simulators.flight import Flight

_SEEN = "where motion capture gives the heading"


class FrameMisalignment(CommandEffect):
    """Roll and pitch turned by an angle, the heading held as commanded.

    A body frame, an autopilot's board or a position controller whose forward is not the drone's.
    Source: a rotation of the horizontal command, exact for small tilts.
    """

    angle: Number = parameter("rad", -0.5, 0.5, source="a guess")
    """Turn of the commanded tilt, counter-clockwise seen from above [rad]."""

    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="frame misalignment",
        noun="a frame misalignment",
        physics="The drone tilts in a direction that is turned against the commanded one.",
        more="a frame misalignment of {}",
        less="a frame misalignment of -{}",
        shown={"angle": Shown("angle", DEGREES, "°")},
        inputs=frozenset({Input.ATTITUDE_CMD, Input.TWIN}),
        flight="back and forth along one axis, without turning",
        check="look at how the flight controller is turned on the frame",
        changes=(
            offset("px4", "SENS_BOARD_Z_OFF", f"board's yaw, {_SEEN}", "°", angle=-DEGREES),
            offset(
                "crazyflie", "imu_sensors.imuPsi", f"{CRAZYFLIES}, {_SEEN}", "°", angle=-DEGREES
            ),
        ),
    )

    def command(
        self, memory: None, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[None, Float[Array, "drones 4"]]:
        cos, sin = jnp.cos(self.angle), jnp.sin(self.angle)
        roll, pitch = cmd[:, 0], cmd[:, 1]
        tilt = jnp.stack([cos * roll - sin * pitch, sin * roll + cos * pitch], axis=-1)
        return None, jnp.concatenate([tilt, cmd[:, 2:]], axis=-1)
