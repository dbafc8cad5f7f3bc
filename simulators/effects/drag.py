"""Linear drag, isotropic: f = -c m v, in the world frame, on top of the simulator's own drag.

Drag that differs along and across the rotors' axis is `rotor_drag`.

Here and in all effects like it m is the mass that the operator believes: a payload does not
change the force of the air.
"""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Shown
from simulators.effects.contract import BrakingEffect, Number, WrenchEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle


class Drag(WrenchEffect, BrakingEffect):
    """Excess aerodynamic drag. Source: paper, Sec. V-C (c = 2.0 1/s)."""

    c: Number = parameter(
        "1/s",
        -0.5,
        3.0,
        source="real logs 0.33 to 0.44, crazyflow 0.46 and 0.50, paper 2.0; below 0: a "
        "simulator that drags too much",
    )
    """Drag coefficient over mass [1/s]."""

    version: ClassVar[str] = "2"
    card: ClassVar[EffectCard] = EffectCard(
        label="linear drag",
        noun="another linear air drag",
        physics=(
            "Air brakes the drone in proportion to its speed, more or less than in the simulator."
        ),
        more="{} more linear air drag than {base}",
        less="{} less linear air drag than {base}",
        shown={"c": Shown("coefficient c")},
        families=("drag of the air",),
        flight="straight lines at 1 to 2 m/s",
        separated_from={
            "quadratic_drag": (
                "straight lines at two very different speeds, 0.5 and 3 m/s, each held for 2 s"
            ),
        },
        paths={"quadratic_drag": "two_speeds"},
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        return None, -self.c * vehicle.believed_mass * flight.vel, jnp.zeros_like(flight.vel)

    @staticmethod
    def braking(
        vel: Float[np.ndarray, "*n 3"], values: Mapping[str, float]
    ) -> Float[np.ndarray, "*n 3"]:
        return values["c"] * np.ones_like(vel)
