"""Rotor inertia: I = I_nominal (1 + e), what speeding up a rotor turns the drone with."""

from typing import ClassVar

from simulators.effects.card import EffectCard, Input, Probe, percent
from simulators.effects.contract import Number, ScalingEffect, excess


class RotorInertia(ScalingEffect):
    """Propellers and motors heavier or lighter than believed. Source: crazyflow's 39e-9 kg m^2."""

    e: Number = excess(-1.0, 2.0, "-1 is a simulator without it; the upper bound is a guess")
    """Relative excess moment of inertia of every rotor [-]."""

    scales: ClassVar[str] = "rotor_inertia_scale"
    needs: ClassVar[tuple[str, ...]] = ("rotation", "rotors")
    order: ClassVar[int] = 6
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="rotor inertia",
        noun="another inertia of the rotors",
        physics=(
            "Rotors that speed up turn the drone the other way, more or less than in the simulator."
        ),
        more="{} more rotor inertia than {base}",
        less="{} less rotor inertia than {base}",
        shown={"e": percent()},
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        unbelieved=True,
        flight="yaw steps of 0.5 rad every second",
        probe=Probe("rotors", {"e": 2.0}),
    )
