"""Thrust gain: every rotor produces f (1 + e) where its speed should give f."""

from typing import ClassVar

from simulators.effects.card import HOVER_THRUST, MELLINGER, EffectCard, factor, percent
from simulators.effects.contract import Number, ScalingEffect, excess

WEAKEST = -0.8
"""Least gain of a map from PWM and voltage: that of one drone gave 2.0 times its weight in hover;
the bound is a guess."""


class ThrustGain(ScalingEffect):
    """Rotors stronger or weaker than believed. Source: unit-to-unit spread of one fleet."""

    e: Number = excess(
        -0.5,
        0.5,
        "-0.14 to 0.03 over a fleet of one airframe, maps from PWM off by a third; the "
        "bound is a guess",
    )
    """Relative excess thrust [-]."""

    scales: ClassVar[str] = "thrust_gain"
    order: ClassVar[int] = 1
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="thrust gain",
        noun="another thrust gain",
        physics="The rotors make more or less thrust than commanded, by a constant factor.",
        more="{} more thrust at the same command than {base}",
        less="{} less thrust at the same command than {base}",
        shown={"e": percent()},
        families=("thrust over mass",),
        combined=("thrust over mass", 1.0),
        low_if_mapped={"e": WEAKEST},
        separated_from={
            "wind": (
                "climbs and descents at 1 m/s with hard turns: a thrust error grows with thrust "
                "and tilts with the drone, a vertical wind does neither"
            ),
        },
        paths={"wind": "tumbling"},
        check=(
            "look at the propellers, the battery, and how commands become newtons in these logs"
        ),
        changes=(
            factor("px4", "MPC_THR_HOVER", HOVER_THRUST, share=True, e=-1.0),
            factor("crazyflie", "ctrlMel.massThrust", MELLINGER, e=-1.0),
            factor("crazyflie", "posCtlPid.thrustBase", "PID controller", e=-1.0),
        ),
    )
