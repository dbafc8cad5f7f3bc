"""Rotor arm: l = l_nominal (1 + e), the distance of rotors from the roll and the pitch axis."""

from typing import ClassVar

from simulators.effects.card import EffectCard, Input, percent
from simulators.effects.contract import Number, ScalingEffect, excess


class RotorArm(ScalingEffect):
    """Rotors nearer or further out than believed. Source: crazyflow's and RotorPy's airframes.

    Thrusts that differ turn the drone by l, rotors that climb differently (`rotor_drag`) by l^2.
    """

    e: Number = excess(
        -0.5,
        1.0,
        "35.4 mm in crazyflow 0.4.0 (cf21B_500) and 30.4 mm in RotorPy's Crazyflie "
        "Brushless; the bounds are a guess",
    )
    """Relative excess length [-]."""

    scales: ClassVar[str] = "arm_scale"
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 9
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="rotor arm",
        noun="rotors nearer or further out",
        physics="Thrusts that differ turn the drone more or less than in the simulator.",
        shown={"e": percent()},
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        airframe=True,
        prior=0.1,  # crazyflow's and RotorPy's files of one Crazyflie differ by 0.14
        flight="attitude steps of 0.3 rad every 0.4 s",
    )
