"""Motor lag: the rotors' time constants, rising and falling, are `scale` times the nominal."""

from typing import ClassVar

import equinox as eqx

from simulators.effects.card import EffectCard, Input, Shown
from simulators.effects.contract import Number, PlantEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class MotorLag(PlantEffect):
    """Rotors slower or faster than believed. Source: spread of identified time constants."""

    scale: Number = parameter(
        "-",
        0.3,
        5.0,
        1.0,
        factor=True,
        source="0.057 and 0.062 s (cf21B), 0.136 and 0.106 s (L250) in crazyflow 0.4.0, 0.072 "
        "s in arXiv 2404.07837; the lower bound is a guess. At 4 times nominal one of three "
        "simulated flights of cf21B_500 turned over, at 5 times all did",
    )
    """Time constants over their nominal values [-]."""

    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 4
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="motor lag",
        noun="another motor lag",
        physics="The rotors change speed more slowly or quickly than the simulator believes.",
        more="rotor time constants {} times as long as {base}",
        shown={"scale": Shown("time constants, times nominal")},
        families=(
            "how fast it turns",
            "how fast rotors follow",
        ),
        inputs=frozenset({Input.THRUST_CMD}),
        flight="thrust steps of 30 % every 0.4 s",
        check="look at the motor controllers' settings and the propellers' inertia",
    )

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        scale = vehicle.motor_lag_scale * self.scale
        return None, eqx.tree_at(lambda v: v.motor_lag_scale, vehicle, scale)
