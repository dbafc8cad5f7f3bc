"""Clock drift: commands act later the longer the flight lasts, u_eff(t) = u(t - r t).

t is the time since the reset. Logs look so if the clocks that stamp commands and path differ in
speed by a rate r. A queue that is filled faster than it is emptied delays commands so, too.
"""

from typing import ClassVar

from jaxtyping import Array, Float

from simulators.effects.card import EffectCard, Input, Shown
from simulators.effects.contract import Number, parameter
from simulators.effects.late import LateEffect


class ClockDrift(LateEffect):
    """A delay that grows with time, up to `LONGEST_DELAY_S`. Source: the two clocks' equation."""

    rate: Number = parameter("s/s", 0.0, 0.05, source="a guess")
    """Growth of the delay [s/s]."""

    order: ClassVar[int] = 8
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="clock drift",
        noun="a drifting clock",
        physics="Commands take effect the later, the longer the flight lasts.",
        more="commands that come ever later, by {}",
        less="commands that come ever earlier, by {}",
        shown={"rate": Shown("drift", 1000.0, "ms a second")},
        inputs=frozenset({Input.ATTITUDE_CMD, Input.TWIN}),
        flight="attitude steps of 0.3 rad every 0.4 s, for ten seconds",
        separated_from={
            "delay": "attitude steps of 0.3 rad every 0.4 s, for ten seconds: a drift grows"
        },
        check=(
            "compare the clock that stamps commands with the one that stamps the path, and look "
            "for a queue that fills up"
        ),
        instead=(
            "If only the stamps drift, mend them and diagnose again; if commands do act ever "
            "later, keep that in the simulator"
        ),
    )

    def late(self, t: Float[Array, "*n"]) -> Float[Array, "..."]:
        return self.rate * t
