"""Gains of the roll and pitch loops: attitude (1 + stiffness), rate (1 + damping), acceleration."""

from typing import ClassVar

from simulators.effects.card import MELLINGER, EffectCard, Input, Probe, gain, percent
from simulators.effects.contract import AutopilotEffect, Number, excess
from simulators.flight import Flight
from simulators.vehicle import AutopilotGains


class RollPitchGains(AutopilotEffect):
    """An autopilot tuned otherwise than believed. Source: PID and Mellinger loops of Crazyflies."""

    stiffness: Number = excess(-0.95, 4.0, "a guess")
    """Relative excess of the gain on the attitude error [-]."""
    damping: Number = excess(-0.95, 4.0, "a guess")
    """Relative excess of the gain on the error in angular velocity [-]."""
    acceleration: Number = excess(
        -1.0, 4.0, "-1 is a loop without this gain; the upper bound is a guess"
    )
    """Relative excess of the gain on the rate at which that error changes [-]."""

    roll: Number = excess(
        -0.5,
        1.0,
        "-0.11 makes the two loops of cf21B_500 alike, whose inertias are 25e-6 and "
        "28e-6 kg m^2; the bounds are a guess",
    )
    """Relative excess of all gains of roll over those of pitch [-]."""

    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="roll and pitch gains",
        noun="other gains of the roll and pitch loop",
        physics="The autopilot holds roll and pitch more or less firmly than the simulated one.",
        shown={
            "stiffness": percent("gain on the angle"),
            "damping": percent("gain on the rate"),
            "acceleration": percent("gain on the acceleration"),
            "roll": percent("roll over pitch"),
        },
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        unbelieved=True,
        flight="attitude steps of 0.3 rad every 0.4 s",
        check="compare the gains of the roll and pitch loop with those that it had or should have",
        probe=Probe("autopilot", {"stiffness": 1.0}),
        changes=(
            gain("px4", "MC_ROLL_P, MC_PITCH_P", stiffness=-1.0, damping=1.0),
            gain("px4", "MC_ROLLRATE_K", damping=-1.0, roll=-1.0),
            gain("px4", "MC_PITCHRATE_K", damping=-1.0),
            gain("crazyflie", "ctrlMel.kR_xy", MELLINGER, stiffness=-1.0),
            gain("crazyflie", "ctrlMel.kw_xy", MELLINGER, damping=-1.0),
            gain("crazyflie", "ctrlMel.kd_omega_rp", MELLINGER, acceleration=-1.0),
        ),
    )

    def autopilot(
        self, memory: None, flight: Flight, gains: AutopilotGains, dt: float
    ) -> tuple[None, AutopilotGains]:
        own = gains.more((1.0, 0.0, 0.0), self.roll, self.roll, self.roll, self.roll)
        tilting = (1.0, 1.0, 0.0)
        return None, own.more(
            tilting, self.stiffness, self.stiffness, self.damping, self.acceleration
        )
