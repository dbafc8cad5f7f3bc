"""First-order lag of the produced thrust, for simulators without rotors.

tau x' = u - x by backward Euler, h the step, u what was asked for:

    x_k+1 = u + tau / (tau + h) (x_k - u),    tau = up where u > x_k, else down,

which is u exactly at tau = 0, with the derivative (x_k - u) / h there.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, Probe, Shown
from simulators.effects.contract import Number, Parameter, ResponseEffect, declared

_TIME = Parameter(
    unit="s",
    low=0.0,
    high=0.3,
    neutral=0.0,
    source="0.057 and 0.062 (cf21B), 0.136 and 0.106 (L250) in crazyflow 0.4.0, 0.072 in arXiv "
    "2404.07837; twice that is a guess",
)


class ThrustLag(ResponseEffect):
    """Rotors that take time to change speed. Source: first-order rotor, arXiv 2404.07837."""

    up: Number = declared(_TIME)
    """Time constant of rising thrust [s]."""
    down: Number = declared(_TIME)
    """Time constant of falling thrust [s]."""

    order: ClassVar[int] = 1
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="thrust lag",
        noun="a thrust lag",
        physics="Thrust follows its command with a lag, as rotors need time to change speed.",
        shown={
            "up": Shown("time constant, rising", 1000.0, "ms"),
            "down": Shown("time constant, falling", 1000.0, "ms"),
        },
        families=("how fast rotors follow",),
        inputs=frozenset({Input.THRUST_CMD}),
        probe=Probe("response", {"up": 0.1, "down": 0.1}),
    )

    def init(self, n_drones: int, dt: float) -> Float[Array, " drones"]:
        """Thrust [N] of standing rotors."""
        return jnp.zeros(n_drones)

    def at(
        self, memory: Float[Array, " drones"], rpy_thrust: Float[Array, "drones 4"]
    ) -> Float[Array, " drones"]:
        return rpy_thrust[:, 3]

    def respond(
        self,
        memory: Float[Array, " drones"],
        rpy_thrust: Float[Array, "drones 4"],
        cmd: Float[Array, "drones 4"],
        dt: float,
    ) -> tuple[Float[Array, " drones"], Float[Array, "drones 4"]]:
        asked = rpy_thrust[:, 3]
        tau = jnp.where(asked > memory, self.up, self.down)
        thrust = asked + tau / (tau + dt) * (memory - asked)
        return thrust, jnp.concatenate([rpy_thrust[:, :3], thrust[:, None]], axis=-1)
