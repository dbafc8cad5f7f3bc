"""Translational lift of four rotors with the axis b, each at its own velocity across it, c.

    f = k m (|c|^2 + 2 l^2 w_b^2) b
    torque = -2 k m l^2 w_b c

The torque: while the drone turns about b at w_b, the rotors on one side fly forward faster. At
2 m/s and 1 rad/s, RotorPy's lift accelerates roll or pitch by 0.5 rad/s^2. f acts amid the rotors;
l is the vehicle's arm. A simulator without rotation ignores the torque. |c| counts up to `FASTEST`:
without drag beside it, a drone at full thrust would be at infinity within ten seconds.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.algebra.rotation import along, body_z, rotate
from simulators.effects.card import EffectCard, Shown
from simulators.effects.contract import Number, WrenchEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle

FASTEST = 20.0
"""Speed across the axis up to which lift grows with its square [m/s]; flights here are slower."""


class TranslationalLift(WrenchEffect):
    """Thrust gained by flying forward. Source: RotorPy (2023), its k_h; Svacha et al. (2017)."""

    k: Number = parameter(
        "1/m", -0.1, 0.6, source="0.10 in RotorPy's Crazyflie Brushless; the bounds are a guess"
    )
    """Lift over mass and squared speed across the axis [1/m]."""

    order: ClassVar[int] = 8
    version: ClassVar[str] = "4"
    card: ClassVar[EffectCard] = EffectCard(
        label="translational lift",
        noun="another translational lift",
        physics=(
            "Flying forward adds thrust, in proportion to the speed across the rotor axis squared."
        ),
        more="{} more translational lift than {base}",
        less="{} less translational lift than {base}",
        shown={"k": Shown("coefficient k")},
        flight="level straight lines at 2 m/s",
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        up, turn = body_z(flight.quat), rotate(flight.quat, flight.ang_vel)
        across = flight.vel - along(up, flight.vel)
        yaw = jnp.sum(up * turn, axis=-1, keepdims=True)
        square = (vehicle.arm * vehicle.arm_scale) ** 2
        lift = self.k * vehicle.believed_mass
        forward = jnp.minimum(jnp.sum(across**2, axis=-1, keepdims=True), FASTEST**2)
        squared = forward + 2.0 * square * yaw**2
        force = lift * squared * up
        torque = vehicle.at_center(flight.quat, force) - 2.0 * lift * square * yaw * across
        return None, force, torque
