"""Rotor inertia: I = I_nominal (1 + e), what speeding up a rotor turns the drone with."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, Probe, percent
from simulators.effects.contract import Parameter, PlantEffect
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class RotorInertia(PlantEffect):
    """Propellers and motors heavier or lighter than believed. Source: crazyflow's 39e-9 kg m^2."""

    e: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess moment of inertia of every rotor [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "e": Parameter(
            unit="-",
            low=-1.0,
            high=2.0,
            neutral=0.0,
            factor=True,
            source="-1 is a simulator without it; the upper bound is a guess",
        )
    }
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

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        scale = vehicle.rotor_inertia_scale * (1.0 + self.e)
        return None, eqx.tree_at(lambda v: v.rotor_inertia_scale, vehicle, scale)
