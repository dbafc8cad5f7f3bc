"""Gyro compensation: torque share (w x J w), which an autopilot asks for to keep w as it is.

J is what the autopilot believes: a payload that changes the drone's does not change its torque.
The rotors give it as late as they follow: m' = (w x J w - m) / tau, torque = share m.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.algebra.rotation import rotate
from simulators.effects.card import EffectCard, Input, percent
from simulators.effects.contract import Number, WrenchEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle

Memory = tuple[Float[Array, "drones 3"], Float[Array, ""]]


class GyroCompensation(WrenchEffect):
    """An autopilot that knows Euler's equation. Source: Lee, Leok and McClamroch (2010), eq. 16.

    Without it, a drone that rolls while it yaws is pitched.
    """

    share: Number = parameter(
        "-",
        0.0,
        4.0,
        source="0 in crazyflow's Mellinger loop, 1 in RotorPy's times its inertia over the "
        "believed one; the upper bound is a guess",
    )
    """Part of the gyroscopic torque that the autopilot cancels [-]."""

    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 9
    version: ClassVar[str] = "2"
    card: ClassVar[EffectCard] = EffectCard(
        label="gyro compensation",
        noun="an autopilot that cancels gyroscopic torques",
        physics="Rolling while yawing does not pitch the drone as far as in the simulator.",
        shown={"share": percent("share that is cancelled")},
        inputs=frozenset({Input.ATTITUDE_CMD}),
        airframe=True,
        unbelieved=True,
        flight="circles at 2 m/s under yaw sweeps of 1 rad/s",
    )

    def init(self, n_drones: int, dt: float) -> Memory:
        """Torque of the rotors [N m, body], and whether they turned yet: the first is not late."""
        return jnp.zeros((n_drones, 3)), jnp.asarray(0.0)

    def wrench(
        self, memory: Memory, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[Memory, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        last, started = memory
        asked = jnp.cross(flight.ang_vel, flight.ang_vel @ vehicle.believed_inertia)
        tau = vehicle.rotor_lag * vehicle.motor_lag_scale
        given = jnp.where(started > 0, asked + tau / (tau + dt) * (last - asked), asked)
        torque = rotate(flight.quat, self.share * given)
        return (given, jnp.ones_like(started)), jnp.zeros_like(flight.vel), torque
