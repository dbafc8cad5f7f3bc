"""Gains of the yaw loop: attitude (1 + stiffness), its integral, rate (1 + damping)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import MELLINGER, EffectCard, Input, gain, percent
from simulators.effects.contract import AutopilotEffect, Parameter
from simulators.flight import Flight
from simulators.vehicle import AutopilotGains


class YawGains(AutopilotEffect):
    """A heading held more or less firmly than believed. Source: as `roll_pitch_gains`."""

    stiffness: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the yaw error [-]."""
    integral: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the integral of that error [-]."""
    damping: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the error in yaw rate [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "stiffness": Parameter(
            unit="-", low=-0.95, high=4.0, neutral=0.0, factor=True, source="a guess"
        ),
        "integral": Parameter(
            unit="-",
            low=-1.0,
            high=4.0,
            neutral=0.0,
            factor=True,
            source="-1 is a loop without this gain; the upper bound is a guess",
        ),
        "damping": Parameter(
            unit="-", low=-0.95, high=4.0, neutral=0.0, factor=True, source="a guess"
        ),
    }
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 1
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="yaw gains",
        noun="other gains of the yaw loop",
        physics="The autopilot holds the heading more or less firmly than the simulated one.",
        shown={
            "stiffness": percent("gain on the angle"),
            "integral": percent("gain on its integral"),
            "damping": percent("gain on the rate"),
        },
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        unbelieved=True,
        flight="yaw steps of 0.5 rad every second",
        check="compare the gains of the yaw loop with those that it had or should have",
        changes=(
            gain("px4", "MC_YAW_P", stiffness=-1.0, damping=1.0),
            gain("px4", "MC_YAWRATE_K", damping=-1.0),
            gain("crazyflie", "ctrlMel.kR_z", MELLINGER, stiffness=-1.0),
            gain("crazyflie", "ctrlMel.kw_z", MELLINGER, damping=-1.0),
            gain("crazyflie", "ctrlMel.ki_m_z", MELLINGER, integral=-1.0),
        ),
    )

    def autopilot(
        self, memory: None, flight: Flight, gains: AutopilotGains, dt: float
    ) -> tuple[None, AutopilotGains]:
        turning = (0.0, 0.0, 1.0)
        return None, gains.more(turning, self.stiffness, self.integral, self.damping)
