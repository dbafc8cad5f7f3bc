"""Thrust gain: every rotor produces f (1 + e) where its speed should give f."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import Change, EffectCard, percent
from simulators.effects.contract import Parameter, PlantEffect
from simulators.flight import Flight
from simulators.vehicle import Vehicle

WEAKEST = -0.8
"""Least gain of a map from PWM and voltage: that of one drone gave 2.0 times its weight in hover;
the bound is a guess."""


class ThrustGain(PlantEffect):
    """Rotors stronger or weaker than believed. Source: unit-to-unit spread of one fleet."""

    e: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess thrust [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "e": Parameter(
            unit="-",
            low=-0.5,
            high=0.5,
            neutral=0.0,
            factor=True,
            source="-0.14 to 0.03 over a fleet of one airframe, maps from PWM off by a third; the "
            "bound is a guess",
        )
    }
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
            Change(
                autopilot="px4",
                parameter="MPC_THR_HOVER",
                where="hover thrust, from which the estimator of it starts",
                powers={"e": -1.0},
                share=True,
            ),
            Change(
                autopilot="crazyflie",
                parameter="ctrlMel.massThrust",
                where="Mellinger controller",
                powers={"e": -1.0},
            ),
            Change(
                autopilot="crazyflie",
                parameter="posCtlPid.thrustBase",
                where="PID controller",
                powers={"e": -1.0},
            ),
        ),
    )

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        gain = vehicle.thrust_gain * (1.0 + self.e)
        return None, eqx.tree_at(lambda v: v.thrust_gain, vehicle, gain)
