"""Drag of four turning rotors with the axis b, each at its own velocity and speed.

    f = -m s (k_a b b' + k_l (1 - b b')) v
    torque = -m s l^2 (k_a (1 - b b') + 2 k_l b b') w - (k_a b' v - k_l b v') tau / (2 gain g s)

It grows with rotor speed, s = sqrt(T / (gain m g)) for the thrust T of rotors of that gain, one in
hover; linear drag of the body (`drag`) does not. By the torque tau rotors turn the drone, and those
that thrust more turn faster and are braked more: a climb along b weakens the grip on the attitude,
by 13 % at 1.5 m/s and k_a = 1.7. f acts amid the rotors, off a centre of mass that lies elsewhere,
whose own motion by w is left out. A simulator without rotation ignores the torque.

| symbol | name | unit |
|---|---|---|
| k_a, k_l | axial, lateral | 1/s |
| l | the vehicle's arm | m |
"""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simulators.algebra.rotation import along, body_z, rotate
from simulators.effects.card import EffectCard, Shown
from simulators.effects.contract import BrakingEffect, Number, WrenchEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import GRAVITY, Vehicle

_SOURCE = "1.77 along and 0.75 across the axis in RotorPy's Crazyflie Brushless; rotors do not push"


class RotorDrag(WrenchEffect, BrakingEffect):
    """Inflow along rotors and blade drag across them. Source: RotorPy (2023), its k_z and k_d."""

    axial: Number = parameter("1/s", 0.0, 4.0, source=_SOURCE)
    """Drag along the rotor axis in hover, over mass [1/s]."""
    lateral: Number = parameter("1/s", 0.0, 4.0, source=_SOURCE)
    """Drag across it."""

    order: ClassVar[int] = 7
    version: ClassVar[str] = "3"
    card: ClassVar[EffectCard] = EffectCard(
        label="rotor drag",
        noun="another drag of the rotors",
        physics="Turning rotors brake the drone in proportion to their speed and to its own.",
        shown={"axial": Shown("along the rotor axis"), "lateral": Shown("across it")},
        families=("drag of the air",),
        flight="climbs and descents at 1 m/s",
        separated_from={
            "quadratic_drag": (
                "straight lines at two very different speeds, 0.5 and 3 m/s, each held for 2 s"
            ),
            "drag": (
                "climbs and descents at 1 m/s with hard turns: rotors brake more the faster they "
                "turn, and more along their axis"
            ),
        },
        paths={"quadratic_drag": "two_speeds", "drag": "tumbling"},
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        up, turn = body_z(flight.quat), rotate(flight.quat, flight.ang_vel)
        climb, yaw = along(up, flight.vel), along(up, turn)
        turning = flight.thrust > 0.0  # the root has no derivative where the rotors stand still
        mass = vehicle.believed_mass
        lift = flight.thrust / (vehicle.thrust_gain * mass * GRAVITY)
        speed = jnp.sqrt(jnp.where(turning, lift, 1.0))[:, None]
        force = self.axial * climb + self.lateral * (flight.vel - climb)
        torque = (vehicle.arm * vehicle.arm_scale) ** 2 * (
            self.axial * (turn - yaw) + 2.0 * self.lateral * yaw
        )
        # Rotor i is braked by m k / 4 (s + ds_i) of its velocity, where its thrust exceeds the
        # others' mean by dF_i = gain m g / 2 s ds_i, and dF_i sums up to the torque.
        own = rotate(flight.quat, flight.torque)
        climbing = jnp.sum(up * flight.vel, axis=-1, keepdims=True)
        across = jnp.sum(own * flight.vel, axis=-1, keepdims=True) * up
        differing = (self.axial * climbing * own - self.lateral * across) / (
            2.0 * vehicle.thrust_gain * GRAVITY * speed
        )
        force, torque = mass * speed * force, mass * speed * torque + differing
        torque = torque + vehicle.at_center(flight.quat, force)
        braked = [jnp.where(turning[:, None], -x, 0.0) for x in (force, torque)]
        return None, braked[0], braked[1]

    @staticmethod
    def braking(
        vel: Float[np.ndarray, "*n 3"], values: Mapping[str, float]
    ) -> Float[np.ndarray, "*n 3"]:
        along = np.asarray([values["lateral"], values["lateral"], values["axial"]])
        return along * np.ones_like(vel)
