"""Gains of the yaw loop: attitude (1 + stiffness), its integral, rate (1 + damping)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import AutopilotEffect, Parameter
from simulators.flight import Flight
from simulators.vehicle import AutopilotGains


class YawGains(AutopilotEffect):
    """A heading held more or less firmly than believed. Source: as `roll_pitch_gains`."""

    stiffness: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the yaw error [-]."""
    integral: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the integral of that error [-]."""
    damping: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Relative excess of the gain on the error in yaw rate [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "stiffness": Parameter(
            unit="-", low=-0.95, high=4.0, neutral=0.0, factor=True, source="a guess"
        ),
        "integral": Parameter(
            unit="-",
            low=-1.0,
            high=4.0,
            neutral=0.0,
            factor=True,
            source="-1 is a loop without this gain; the upper bound is a guess",
        ),
        "damping": Parameter(
            unit="-", low=-0.95, high=4.0, neutral=0.0, factor=True, source="a guess"
        ),
    }
    door: ClassVar[str] = "autopilot"
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 1
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def autopilot(
        self, memory: None, flight: Flight, gains: AutopilotGains, dt: float
    ) -> tuple[None, AutopilotGains]:
        turning = (0.0, 0.0, 1.0)
        return None, gains.more(turning, self.stiffness, self.integral, self.damping)
