"""Mass: m = m_nominal (1 + e), with the inertia about the centre of mass unchanged."""

from collections.abc import Mapping
from typing import ClassVar

from simulators.effects.card import HOVER_THRUST, MELLINGER, EffectCard, Probe, factor, percent
from simulators.effects.contract import Number, ScalingEffect, WeightEffect, excess


class Mass(ScalingEffect, WeightEffect):
    """A vehicle heavier or lighter than believed. Source: paper, Sec. V-C (+20 %)."""

    e: Number = excess(
        -0.3, 0.6, "27 g (URDF) to 32.8 g (crazyflow) for one airframe, payloads of 5 to 10 g"
    )
    """Relative excess mass [-]."""

    scales: ClassVar[str] = "mass"
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="mass",
        noun="another mass",
        physics="The drone is heavier or lighter than the simulator believes.",
        more="{} more mass than {base}",
        less="{} less mass than {base}",
        shown={"e": percent()},
        families=("thrust over mass",),
        combined=("thrust over mass", -1.0),
        shared=False,  # would run against its alias, the thrust's gain, which stands for it
        separated_from={
            "thrust_gain": (
                "fast straight lines at 2 m/s or more: drag slows a heavier drone less, while a "
                "weaker rotor leaves that unchanged"
            ),
            "wind": (
                "climbs and descents at 1 m/s with hard turns: a mass error grows with thrust and "
                "tilts with the drone, a vertical wind does neither"
            ),
        },
        probe=Probe("plant", {"e": 0.3}),
        paths={"thrust_gain": "fast_lines", "wind": "tumbling"},
        check="weigh the vehicle with its battery (if the mass is as believed, thrust is missing, "
        "and no mass was added)",
        changes=(
            factor("px4", "MPC_THR_HOVER", HOVER_THRUST, share=True, e=1.0),
            factor("crazyflie", "ctrlMel.mass", MELLINGER, "kg", holds_mass=True, e=1.0),
            factor("crazyflie", "ctrlLee.mass", "Lee controller", "kg", holds_mass=True, e=1.0),
            factor("crazyflie", "posCtlPid.thrustBase", "PID controller", e=1.0),
        ),
    )

    @staticmethod
    def weight(values: Mapping[str, float]) -> float:
        return 1.0 + values["e"]
