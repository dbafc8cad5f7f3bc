"""Battery: thrust fades with time, gain 1 - rate t, t since the reset [s].

A linear stand-in for the voltage that falls over a flight: rotors at a given duty turn slower.
"""

from typing import ClassVar

import equinox as eqx

from simulators.effects.card import VOLTAGE_COMPENSATION, EffectCard, Shown
from simulators.effects.contract import Number, PlantEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class Battery(PlantEffect):
    """A battery that runs down and is not compensated for. Source: linear form, a guess."""

    rate: Number = parameter(
        "1/s",
        0.0,
        0.05,
        source="0.3 to 0.5 V a minute of 3.8 V and thrust as voltage squared give 0.0026 to "
        "0.0044; the bound is a guess",
    )
    """Share of the thrust that is lost per second [1/s]."""

    order: ClassVar[int] = 2
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="battery",
        noun="a fading battery",
        physics="Thrust at the same command fades in the course of the flight.",
        more="thrust that fades by {}",
        less="thrust that grows by {}",
        shown={"rate": Shown("thrust lost", 6000.0, "% a minute")},
        families=("fading thrust",),
        flight="one flight of several minutes",
        separated_from={
            "thrust_gain": "one flight of a minute or more: a weak battery grows with time",
            "mass": "one flight of a minute or more: a weak battery grows with time",
        },
        paths={"thrust_gain": "hover", "mass": "hover"},
        check="charge the battery, and look at its age",
        changes=VOLTAGE_COMPENSATION,
    )

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        gain = vehicle.thrust_gain * (1.0 - self.rate * flight.t)
        return None, eqx.tree_at(lambda v: v.thrust_gain, vehicle, gain)
