"""Transport delay of the command: u_eff(t) = u(t - d)."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, Shown
from simulators.effects.contract import Number, parameter
from simulators.effects.late import LONGEST_DELAY_S, LateEffect


class Delay(LateEffect):
    """Latency between the policy and the autopilot. Source: 0 to 60 ms in radio-linked fleets."""

    seconds: Number = parameter("s", 0.0, LONGEST_DELAY_S, source="published 0 to 60 ms")
    """Delay [s], at most `LONGEST_DELAY_S`."""

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

    def late(self, t: Float[Array, "*n"]) -> Float[Array, "..."]:
        return jnp.asarray(self.seconds)
