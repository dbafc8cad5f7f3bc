"""Gyro compensation: torque = share (w x J w), which an autopilot adds to keep w as it is.

J is what the autopilot believes: a payload that changes the drone's does not change its torque.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import Parameter, WrenchEffect
from simulators.flight import Flight
from simulators.rotation import rotate
from simulators.vehicle import Vehicle


class GyroCompensation(WrenchEffect):
    """An autopilot that knows Euler's equation. Source: Lee, Leok and McClamroch (2010), eq. 16.

    Without it, a drone that rolls while it yaws is pitched; the lag of the rotors is left out.
    """

    share: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Part of the gyroscopic torque that the autopilot cancels [-]."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "share": Parameter(
            unit="-",
            low=0.0,
            high=4.0,
            neutral=0.0,
            source="0 in crazyflow's Mellinger loop, 1 in RotorPy's times its inertia over the "
            "believed one; the upper bound is a guess",
        )
    }
    door: ClassVar[str] = "wrench"
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 9
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        turning = jnp.cross(flight.ang_vel, flight.ang_vel @ vehicle.believed_inertia)
        return None, jnp.zeros_like(flight.vel), rotate(flight.quat, self.share * turning)
