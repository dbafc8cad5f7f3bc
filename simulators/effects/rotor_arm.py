"""Rotor arm: l = l_nominal (1 + e), the distance of rotors from the roll and the pitch axis."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, percent
from simulators.effects.contract import Parameter, PlantEffect
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class RotorArm(PlantEffect):
    """Rotors nearer or further out than believed. Source: crazyflow's and RotorPy's airframes.

    Thrusts that differ turn the drone by l, rotors that climb differently (`rotor_drag`) by l^2.
    """

    e: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess length [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "e": Parameter(
            unit="-",
            low=-0.5,
            high=1.0,
            neutral=0.0,
            factor=True,
            source="35.4 mm in crazyflow 0.4.0 (cf21B_500) and 30.4 mm in RotorPy's Crazyflie "
            "Brushless; the bounds are a guess",
        )
    }
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

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        scale = vehicle.arm_scale * (1.0 + self.e)
        return None, eqx.tree_at(lambda v: v.arm_scale, vehicle, scale)
