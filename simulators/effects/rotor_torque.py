"""Rotor torque: M = M_nominal (1 + e), what turning rotors turn the drone with."""

from typing import ClassVar

from simulators.effects.card import EffectCard, Input, percent
from simulators.effects.contract import Number, ScalingEffect, excess


class RotorTorque(ScalingEffect):
    """Propellers of another drag. Source: torque over thrust of crazyflow's and RotorPy's rotors.

    The less torque rotors have, the further their thrusts must differ to hold the heading, until
    some reach their limit and nothing is left to hold roll and pitch with.
    """

    e: Number = excess(
        -0.7,
        4.0,
        "5.9 mm of torque over thrust in crazyflow 0.4.0 (cf21B_500) and 19.2 mm in "
        "RotorPy's Crazyflie Brushless; the bounds are a guess",
    )
    """Relative excess torque about its axis of every rotor, at the same speed and thrust [-]."""

    scales: ClassVar[str] = "rotor_torque_scale"
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 8
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="rotor torque",
        noun="propellers of another drag",
        physics="The rotors' torque for a given thrust is not the simulated one.",
        shown={"e": percent()},
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        airframe=True,
        unbelieved=True,
        flight="yaw steps of 0.5 rad every second",
    )
