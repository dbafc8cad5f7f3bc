"""Trim: constant angles on top of commanded roll and pitch."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import CRAZYFLIES, DEGREES, EffectCard, Input, Probe, Shown, offset
from simulators.effects.contract import CommandEffect, Number, Parameter, declared
from simulators.flight import Flight

_ANGLE = Parameter(
    unit="rad",
    low=-0.1,
    high=0.1,
    neutral=0.0,
    source="published 0 to 2 degrees (0.035); the bounds are a guess",
)
_OUTSIDE = "attitude must be measured from outside, as by motion capture"


class Trim(CommandEffect):
    """A level that is not level: a tilted sensor or mount. Source: constant bias."""

    roll: Number = declared(_ANGLE)
    """Added to commanded roll [rad]."""
    pitch: Number = declared(_ANGLE)
    """Added to commanded pitch [rad]."""

    order: ClassVar[int] = 2
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="trim",
        noun="a trim error, so that the drone leans",
        physics="The drone leans by a constant angle where level flight is commanded.",
        shown={
            "roll": Shown("right side down", DEGREES, "°", opposite="left side down"),
            "pitch": Shown("nose down", DEGREES, "°", opposite="nose up"),
        },
        families=("lean in hover",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        local=True,
        separated_from={
            "center_of_mass": (
                "up and down by 25 cm every 1.4 s, so that the thrust swings by half of the "
                "weight: the tilt that an offset of the centre of mass causes grows with thrust, a "
                "trim does not"
            ),
            "wind": (
                "hover with the yaw turned by 90 degrees every 3 s: a trim turns with the drone"
            ),
        },
        probe=Probe("command", {"roll": 0.2, "pitch": -0.1}),
        paths={"center_of_mass": "pumping", "wind": "turning"},
        check="level the flight controller, and calibrate its level",
        changes=(
            offset("px4", "SENS_BOARD_X_OFF", f"board's roll; {_OUTSIDE}", "°", roll=-DEGREES),
            offset("px4", "SENS_BOARD_Y_OFF", f"board's pitch; {_OUTSIDE}", "°", pitch=DEGREES),
            offset("crazyflie", "imu_sensors.imuPhi", CRAZYFLIES, "°", roll=DEGREES),
            offset("crazyflie", "imu_sensors.imuTheta", CRAZYFLIES, "°", pitch=DEGREES),
        ),
    )

    def command(
        self, memory: None, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[None, Float[Array, "drones 4"]]:
        tilt = cmd[:, :2] + jnp.stack([self.roll, self.pitch])
        return None, jnp.concatenate([tilt, cmd[:, 2:]], axis=-1)
