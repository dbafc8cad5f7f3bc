"""Rotor torque: M = M_nominal (1 + e), what turning rotors turn the drone with."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, percent
from simulators.effects.contract import Parameter, PlantEffect
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class RotorTorque(PlantEffect):
    """Propellers of another drag. Source: torque over thrust of crazyflow's and RotorPy's rotors.

    The less torque rotors have, the further their thrusts must differ to hold the heading, until
    some reach their limit and nothing is left to hold roll and pitch with.
    """

    e: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess torque about its axis of every rotor, at the same speed and thrust [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "e": Parameter(
            unit="-",
            low=-0.7,
            high=4.0,
            neutral=0.0,
            factor=True,
            source="5.9 mm of torque over thrust in crazyflow 0.4.0 (cf21B_500) and 19.2 mm in "
            "RotorPy's Crazyflie Brushless; the bounds are a guess",
        )
    }
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

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        scale = vehicle.rotor_torque_scale * (1.0 + self.e)
        return None, eqx.tree_at(lambda v: v.rotor_torque_scale, vehicle, scale)
