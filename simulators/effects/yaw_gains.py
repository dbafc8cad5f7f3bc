"""Gains of the yaw loop: attitude (1 + stiffness), its integral, rate (1 + damping)."""

from typing import ClassVar

from simulators.effects.card import MELLINGER, EffectCard, Input, gain, percent
from simulators.effects.contract import AutopilotEffect, Number, excess
from simulators.flight import Flight
from simulators.vehicle import AutopilotGains


class YawGains(AutopilotEffect):
    """A heading held more or less firmly than believed. Source: as `roll_pitch_gains`."""

    stiffness: Number = excess(-0.95, 4.0, "a guess")
    """Relative excess of the gain on the yaw error [-]."""
    integral: Number = excess(
        -1.0, 4.0, "-1 is a loop without this gain; the upper bound is a guess"
    )
    """Relative excess of the gain on the integral of that error [-]."""
    damping: Number = excess(-0.95, 4.0, "a guess")
    """Relative excess of the gain on the error in yaw rate [-]."""

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
