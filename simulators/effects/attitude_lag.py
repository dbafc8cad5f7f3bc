"""First-order lag of the commanded attitude, ahead of the simulator's own attitude loop.

tau x' = u - x, for steps of h:

    x_k+1 = u + a (x_k - u),   a = t / (t + h),   t = tau (tau + h/2) / (tau + h)

At tau = 0 this is u exactly, with a slope: unlike the exact factor exp(-h / tau), whose derivatives
all vanish at 0, so that a lag could not be told from none by its first derivative. From tau = 5 h
on, a is exp(-h / tau) to 0.3 %.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, Shown
from simulators.effects.contract import CommandEffect, Number, parameter
from simulators.flight import Flight

Memory = tuple[Float[Array, "drones 3"], Float[Array, ""]]


class AttitudeLag(CommandEffect):
    """An autopilot that smooths its setpoints. Source: first-order model, a guess."""

    tau: Number = parameter("s", 0.0, 0.3, source="a guess")
    """Time constant of roll, pitch and yaw [s]."""

    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="attitude lag",
        noun="an attitude lag",
        physics="The drone follows attitude commands later than the simulator believes.",
        more="an attitude that follows its commands with {} more lag than {base}",
        shown={"tau": Shown("time constant", 1000.0, "ms")},
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        flight="attitude steps of 0.3 rad every 0.4 s",
        separated_from={
            "delay": (
                "attitude steps of 0.3 rad every 0.4 s: a delay shifts the response, a lag rounds "
                "it"
            ),
            "motor_lag": (
                "attitude steps and thrust steps in turn: slow rotors delay thrust as well"
            ),
            "inertia": "attitude steps of 0.3 rad every 0.4 s, as sharp as the controller allows",
        },
        check="look at the attitude loop's gains and filters",
    )

    def init(self, n_drones: int, dt: float) -> Memory:
        """Lagged angles [rad], and whether there was a command yet: the first one is not lagged."""
        return jnp.zeros((n_drones, 3)), jnp.asarray(0.0)

    def command(
        self, memory: Memory, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[Memory, Float[Array, "drones 4"]]:
        last, started = memory
        last = jnp.where(started > 0, last, cmd[:, :3])
        tau = self.tau * (self.tau + 0.5 * dt) / (self.tau + dt)
        angles = cmd[:, :3] + tau / (tau + dt) * (last - cmd[:, :3])
        return (angles, jnp.ones_like(started)), jnp.concatenate([angles, cmd[:, 3:]], axis=-1)
