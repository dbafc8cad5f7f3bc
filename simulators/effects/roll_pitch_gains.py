"""Gains of the roll and pitch loops: attitude (1 + stiffness), rate (1 + damping), acceleration."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import AutopilotEffect, Parameter
from simulators.flight import Flight
from simulators.vehicle import AutopilotGains


class RollPitchGains(AutopilotEffect):
    """An autopilot tuned otherwise than believed. Source: PID and Mellinger loops of Crazyflies."""

    stiffness: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the attitude error [-]."""
    damping: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the error in angular velocity [-]."""
    acceleration: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the rate at which that error changes [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "stiffness": Parameter(unit="-", low=-0.8, high=4.0, neutral=0.0, source="a guess"),
        "damping": Parameter(unit="-", low=-0.8, high=4.0, neutral=0.0, source="a guess"),
        "acceleration": Parameter(
            unit="-",
            low=-1.0,
            high=4.0,
            neutral=0.0,
            source="-1 is a loop without this gain; the upper bound is a guess",
        ),
    }
    door: ClassVar[str] = "autopilot"
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 0
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def autopilot(
        self, memory: None, flight: Flight, gains: AutopilotGains, dt: float
    ) -> tuple[None, AutopilotGains]:
        tilting = jnp.asarray([1.0, 1.0, 0.0])
        return None, AutopilotGains(
            attitude=gains.attitude * (1.0 + self.stiffness * tilting),
            integral=gains.integral * (1.0 + self.stiffness * tilting),
            rate=gains.rate * (1.0 + self.damping * tilting),
            acceleration=gains.acceleration * (1.0 + self.acceleration * tilting),
        )
