"""Mass: m = m_nominal (1 + e), with the inertia about the centre of mass unchanged."""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import Change, EffectCard, Probe, percent
from simulators.effects.contract import Parameter, PlantEffect, WeightEffect
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class Mass(PlantEffect, WeightEffect):
    """A vehicle heavier or lighter than believed. Source: paper, Sec. V-C (+20 %)."""

    e: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess mass [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "e": Parameter(
            unit="-",
            low=-0.3,
            high=0.6,
            neutral=0.0,
            factor=True,
            source="27 g (URDF) to 32.8 g (crazyflow) for one airframe, payloads of 5 to 10 g",
        )
    }
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="mass",
        noun="another mass",
        physics="The drone is heavier or lighter than the simulator believes.",
        more="{} more mass than {base}",
        less="{} less mass than {base}",
        shown={"e": percent()},
        families=("thrust over mass",),
        combined=("thrust over mass", -1.0),
        shared=False,  # would run against its alias, the thrust's gain, which stands for it
        separated_from={
            "thrust_gain": (
                "fast straight lines at 2 m/s or more: drag slows a heavier drone less, while a "
                "weaker rotor leaves that unchanged"
            ),
            "wind": (
                "climbs and descents at 1 m/s with hard turns: a mass error grows with thrust and "
                "tilts with the drone, a vertical wind does neither"
            ),
        },
        probe=Probe("plant", {"e": 0.3}),
        paths={"thrust_gain": "fast_lines", "wind": "tumbling"},
        check="weigh the vehicle with its battery (if the mass is as believed, thrust is missing, "
        "and no mass was added)",
        changes=(
            Change(
                autopilot="px4",
                parameter="MPC_THR_HOVER",
                where="hover thrust, from which the estimator of it starts",
                powers={"e": 1.0},
                share=True,
            ),
            Change(
                autopilot="crazyflie",
                parameter="ctrlMel.mass",
                where="Mellinger controller",
                powers={"e": 1.0},
                unit="kg",
                holds_mass=True,
            ),
            Change(
                autopilot="crazyflie",
                parameter="ctrlLee.mass",
                where="Lee controller",
                powers={"e": 1.0},
                unit="kg",
                holds_mass=True,
            ),
            Change(
                autopilot="crazyflie",
                parameter="posCtlPid.thrustBase",
                where="PID controller",
                powers={"e": 1.0},
            ),
        ),
    )

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        mass = vehicle.mass * (1.0 + self.e)
        return None, eqx.tree_at(lambda v: v.mass, vehicle, mass)

    @staticmethod
    def weight(values: Mapping[str, float]) -> float:
        return 1.0 + values["e"]
