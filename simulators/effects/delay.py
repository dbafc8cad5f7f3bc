"""Transport delay of the command: u_eff(t) = u(t - d), linear between integration steps.

A buffer of fixed length holds the last commands and their ages; the delayed one is interpolated
between the two entries around the age d, so the output is differentiable in d everywhere but at
whole steps. Commands that follow each other faster than the buffer's step share its newest entry.
"""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, Shown
from simulators.effects.contract import CommandEffect, Parameter
from simulators.flight import Flight

LONGEST_DELAY_S = 0.1
"""Longest delay that the buffer holds [s]."""

Memory = tuple[Float[Array, "steps drones 4"], Float[Array, " steps"], Float[Array, ""]]


class LateEffect(CommandEffect):
    """Commands that come late; each effect says by how much."""

    @abc.abstractmethod
    def late(self, flight: Flight) -> Float[Array, ""]:
        """How old the command is that takes effect now [s]."""

    def init(self, n_drones: int, dt: float) -> Memory:
        """Past commands, newest first, their ages [s], and whether there was a command yet."""
        length = round(LONGEST_DELAY_S / dt) + 2
        age = jnp.arange(length) * (LONGEST_DELAY_S / (length - 2))
        return jnp.zeros((length, n_drones, 4)), age, jnp.asarray(0.0)

    def command(
        self, memory: Memory, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[Memory, Float[Array, "drones 4"]]:
        past, age, started = memory
        past, age = jnp.where(started > 0, past, cmd), age + dt
        early = age[1] < 1.001 * LONGEST_DELAY_S / (len(age) - 2)
        past = jnp.concatenate([cmd[None], jnp.where(early, past[1:], past[:-1])])
        age = jnp.concatenate([jnp.zeros(1), jnp.where(early, age[1:], age[:-1])])
        seconds = self.late(flight)
        older = jnp.clip(jnp.searchsorted(age, seconds, side="right"), 1, len(age) - 1)
        part = (seconds - age[older - 1]) / (age[older] - age[older - 1])
        part = jnp.minimum(part, 1.0)  # beyond the buffer, its oldest command
        delayed = past[older - 1] * (1.0 - part) + past[older] * part
        return (past, age, jnp.ones_like(started)), delayed


class Delay(LateEffect):
    """Latency between the policy and the autopilot. Source: 0 to 60 ms in radio-linked fleets."""

    seconds: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.0)
    """Delay [s], at most `LONGEST_DELAY_S`."""

    parameters: ClassVar[dict[str, Parameter]] = {
        "seconds": Parameter(
            unit="s", low=0.0, high=LONGEST_DELAY_S, neutral=0.0, source="published 0 to 60 ms"
        )
    }
    order: ClassVar[int] = 9
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="delay",
        noun="a command delay",
        physics="Commands take effect a fixed time later than the simulator believes.",
        more="commands that take effect {} later than {base}",
        less="commands that take effect {} earlier than {base}",
        shown={"seconds": Shown("delay", 1000.0, "ms")},
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        flight="attitude steps of 0.3 rad every 0.4 s",
        separated_from={
            "inertia": (
                "attitude steps of 0.3 rad every 0.4 s: a delay shifts the response, inertia "
                "rounds it"
            ),
            "motor_lag": (
                "attitude steps and thrust steps in turn: slow rotors round the thrust's response"
            ),
        },
        check=(
            "look at how old commands are when they arrive: the radio, the "
            "companion computer's loop, queues"
        ),
    )

    def late(self, flight: Flight) -> Float[Array, ""]:
        return self.seconds
