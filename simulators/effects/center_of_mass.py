"""Centre of mass: off the geometric centre by r = (x, y, 0), so that thrust turns the body.

In the body frame, about the centre of mass, torque = -r x (0, 0, T) = (-y T, x T, 0).
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from simulators.effects.card import EffectCard, Input, Shown, offset
from simulators.effects.contract import Number, Parameter, PlantEffect, declared
from simulators.flight import Flight
from simulators.vehicle import Vehicle

_OFFSET = Parameter(
    unit="m",
    low=-0.01,
    high=0.01,
    neutral=0.0,
    source="published 0.5 to 5 mm; twice that is a guess",
)


def _places(axis: str) -> str:
    """PX4's parameters of where the rotors are."""
    return ", ".join(f"CA_ROTOR{i}_P{axis}" for i in range(4))


class CenterOfMass(PlantEffect):
    """A battery or payload mounted off centre. Source: rigid-body mechanics."""

    x: Number = declared(_OFFSET)
    """Offset along body x, forward [m]."""
    y: Number = declared(_OFFSET)
    """Offset along body y, left [m]."""

    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 5
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="centre of mass",
        noun="a centre of mass off the middle",
        physics="The centre of mass is off the middle, so that thrust tilts the drone.",
        shown={
            "x": Shown("forward", 1000.0, "mm", opposite="backward"),
            "y": Shown("to the left", 1000.0, "mm", opposite="to the right"),
        },
        families=("lean in hover",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        check="move the battery until the drone hovers level",
        changes=(
            offset(
                "px4", _places("X"), "rotors' places forward of the centre of mass", "m", x=-1.0
            ),
            offset(
                "px4", _places("Y"), "rotors' places to the right of the centre of mass", "m", y=1.0
            ),
        ),
    )

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        offset = vehicle.center_of_mass + jnp.stack([self.x, self.y, jnp.zeros_like(self.x)])
        return None, eqx.tree_at(lambda v: v.center_of_mass, vehicle, offset)
