"""Rotor response: how rotors slow down, and how much of their lag is quadratic in the speed."""

from typing import ClassVar

import equinox as eqx

from simulators.effects.card import EffectCard, Input, Shown
from simulators.effects.contract import Number, PlantEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class RotorResponse(PlantEffect):
    """Rotors that follow commands by another law. Source: crazyflow's four rotor coefficients.

    A law that is not linear in the thrust, or differs between speeding up and slowing down, shifts
    the mean thrust wherever a thrust or attitude command swings, and the more, the less thrust.
    """

    slowing: Number = parameter(
        "-",
        0.3,
        3.0,
        1.0,
        factor=True,
        source="slowing down takes 1.09 (cf21B) and 0.78 (L250) times as long as speeding up "
        "in crazyflow 0.4.0; the bounds are those of `motor_lag`",
    )
    """Time constant of slowing down over its nominal value, beside `motor_lag` [-]."""
    quadratic: Number = parameter(
        "-",
        0.0,
        2.0,
        1.0,
        source="0 is a lag that is linear in the speed, as in RotorPy 2.1; the upper bound is "
        "a guess",
    )
    """Quadratic part of the lag over its nominal value, the time constants in hover kept [-]."""

    needs: ClassVar[tuple[str, ...]] = ("rotation", "rotors")
    order: ClassVar[int] = 7
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="rotor response",
        noun="rotors that follow their commands by another law",
        physics=(
            "Rotors slow down more slowly or faster than they speed up, in another proportion than "
            "the simulated ones."
        ),
        shown={
            "slowing": Shown("time constant of slowing down, times nominal"),
            "quadratic": Shown("quadratic part of the lag, times nominal"),
        },
        families=("how fast rotors follow",),
        inputs=frozenset({Input.THRUST_CMD}),
        airframe=True,
        unbelieved=True,
        flight="thrust steps of 30 % every 0.4 s",
    )

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        return None, eqx.tree_at(
            lambda v: (v.slowing_scale, v.quadratic_lag_scale),
            vehicle,
            (
                vehicle.slowing_scale * self.slowing,
                vehicle.quadratic_lag_scale * self.quadratic,
            ),
        )
