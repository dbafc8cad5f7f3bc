"""Second-order attitude loop behind the simulator's own first-order lag.

With u the lagged command, x the attitude (roll and pitch), w_n the natural frequency and z the
damping ratio,

    x'' = w_n^2 (u - x) - 2 z w_n x',

integrated by backward Euler, which is stable for every w_n dt. With a = 1 / w_n:

    x_k+1 = u + (a^2 (x_k + dt x'_k - u) + 2 z a dt (x_k - u)) / (a^2 + 2 z a dt + dt^2)

so that w_n = inf gives x = u, the nominal simulator, bit for bit.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, Shown
from simulators.effects.contract import Number, ResponseEffect, parameter

Memory = tuple[Float[Array, "drones 2"], Float[Array, "drones 2"]]


class AttitudeLoop(ResponseEffect):
    """Attitude dynamics of a controlled rigid body.

    Source: crazyflow's identified second-order models (cf21B 12.5 rad/s, damping 0.65; L250
    22 rad/s, 0.75).
    """

    natural_freq: Number = parameter(
        "rad/s",
        5.0,
        100.0,
        float("inf"),
        source="12.5 to 22 identified in crazyflow 0.4.0; the outer bounds are a guess",
    )
    """Natural frequency of the loop [rad/s]."""
    damping: Number = parameter("-", 0.3, 2.0, 1.0, source="0.65 to 0.75, outer bounds a guess")
    """Damping ratio [-]; without effect at infinite natural frequency."""

    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="attitude loop",
        noun="an attitude loop of second order",
        physics="The drone follows attitude commands like a damped oscillator.",
        shown={"natural_freq": Shown("natural frequency")},
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        start={"natural_freq": 15.0, "damping": 1.0},
    )

    def init(self, n_drones: int, dt: float) -> Memory:
        """Attitude [rad] and its rate [rad/s], level and at rest."""
        return jnp.zeros((n_drones, 2)), jnp.zeros((n_drones, 2))

    def at(self, memory: Memory, rpy_thrust: Float[Array, "drones 4"]) -> Memory:
        return rpy_thrust[:, :2], jnp.zeros_like(memory[1])

    def respond(
        self,
        memory: Memory,
        rpy_thrust: Float[Array, "drones 4"],
        cmd: Float[Array, "drones 4"],
        dt: float,
    ) -> tuple[Memory, Float[Array, "drones 4"]]:
        tilt, rate = memory
        u, a = rpy_thrust[:, :2], 1.0 / self.natural_freq
        lag = a * a * (tilt + dt * rate - u) + 2.0 * self.damping * a * dt * (tilt - u)
        new = u + lag / (a * a + 2.0 * self.damping * a * dt + dt * dt)
        response = jnp.concatenate([new, rpy_thrust[:, 2:]], axis=-1)
        return (new, (new - tilt) / dt), response
