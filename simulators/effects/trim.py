"""Trim: constant angles on top of commanded roll and pitch."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import DEGREES, Change, EffectCard, Input, Probe, Shown
from simulators.effects.contract import CommandEffect, Parameter
from simulators.flight import Flight

_ANGLE = Parameter(
    unit="rad",
    low=-0.1,
    high=0.1,
    neutral=0.0,
    source="published 0 to 2 degrees (0.035); the bounds are a guess",
)


class Trim(CommandEffect):
    """A level that is not level: a tilted sensor or mount. Source: constant bias."""

    roll: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Added to commanded roll [rad]."""
    pitch: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Added to commanded pitch [rad]."""

    parameters: ClassVar[dict[str, Parameter]] = {"roll": _ANGLE, "pitch": _ANGLE}
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
            Change(
                autopilot="px4",
                parameter="SENS_BOARD_X_OFF",
                where="board's roll; attitude must be measured from outside, as by motion capture",
                gains={"roll": -DEGREES},
                unit="°",
            ),
            Change(
                autopilot="px4",
                parameter="SENS_BOARD_Y_OFF",
                where="board's pitch; attitude must be measured from outside, as by motion capture",
                gains={"pitch": DEGREES},
                unit="°",
            ),
            Change(
                autopilot="crazyflie",
                parameter="imu_sensors.imuPhi",
                where="Crazyflie 2.1 and Brushless",
                gains={"roll": DEGREES},
                unit="°",
            ),
            Change(
                autopilot="crazyflie",
                parameter="imu_sensors.imuTheta",
                where="Crazyflie 2.1 and Brushless",
                gains={"pitch": DEGREES},
                unit="°",
            ),
        ),
    )

    def command(
        self, memory: None, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[None, Float[Array, "drones 4"]]:
        tilt = cmd[:, :2] + jnp.stack([self.roll, self.pitch])
        return None, jnp.concatenate([tilt, cmd[:, 2:]], axis=-1)
