"""A simulator some of whose numbers are drawn anew in every episode.

Source: randomized dynamics, Peng et al. (2018), arXiv 1710.06537.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simulators.contract import AbstractSimulator, with_effects
from simulators.effects.contract import AbstractEffect
from simulators.effects.delay import Delay
from simulators.flight import Flight
from simulators.vehicle import ActionSpace, VehicleSpec

TIMES = ("s", "rad/s")
"""Units of what `vary_times` varies: time constants, delays, natural frequencies."""
Numbers = Callable[[Any], Sequence[Any]]
"""The numbers of a simulator that are drawn, in order; each a scalar array."""


class VariedState(eqx.Module):
    """State of one episode."""

    drawn: Float[Array, " numbers"]
    """The episode's numbers, each in its own unit."""
    inner: Any
    """State of the simulator that is varied."""


class Varied(AbstractSimulator):
    """Draws each of `numbers` at reset, log-uniform where its range is above 0, else uniform."""

    simulator: AbstractSimulator
    """What is varied."""
    numbers: Numbers = eqx.field(static=True)
    """Which of its numbers."""
    low: Float[Array, " numbers"]
    """Smallest value of each, in its own unit."""
    high: Float[Array, " numbers"]
    """Largest value of each."""
    spec: VehicleSpec
    """The airframe."""
    action_space: ActionSpace
    """How actions become commands."""
    effects: tuple[AbstractEffect, ...] = ()
    """None beside those of `simulator`."""

    name: ClassVar[str] = "varied"
    version: ClassVar[str] = "2"
    doors: ClassVar[tuple[str, ...]] = ()

    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> VariedState:
        draw_key, key = jax.random.split(key)
        share = jax.random.uniform(draw_key, self.low.shape)
        ratio = jnp.where(self.low > 0.0, self.high / jnp.where(self.low > 0.0, self.low, 1.0), 1.0)
        drawn = jnp.where(
            self.low > 0.0, self.low * ratio**share, self.low + share * (self.high - self.low)
        )
        return VariedState(drawn, self.simulator.reset(pos, key))

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> VariedState:
        """With the numbers as they are in `simulator`."""
        inner = self.simulator.restore(flight, cmd_history, key)
        return VariedState(_stacked(self.numbers(self.simulator)), inner)

    def step_cmd(
        self, state: VariedState, cmd: Float[Array, "drones 4"], duration: float
    ) -> VariedState:
        simulator = eqx.tree_at(self.numbers, self.simulator, list(state.drawn))
        return VariedState(state.drawn, simulator.step_cmd(state.inner, cmd, duration))

    def flight(self, state: VariedState) -> Flight:
        return self.simulator.flight(state.inner)


def vary(
    simulator: AbstractSimulator, numbers: Numbers, ranges: Sequence[tuple[float, float]]
) -> AbstractSimulator:
    """`simulator` with `numbers` drawn at every reset, each between the ends of its range."""
    if not ranges:
        return simulator
    low, high = jnp.asarray(ranges, float).T
    return Varied(
        simulator=simulator,
        numbers=numbers,
        low=low,
        high=high,
        spec=simulator.spec,
        action_space=simulator.action_space,
    )


def vary_times(
    simulator: AbstractSimulator, spread: float, delay: float = 0.0
) -> AbstractSimulator:
    """`simulator` with the times of its effects within a factor exp(+-`spread`) of what they are.

    Commands are up to `delay` [s] later than that. All stay within the bounds of their parameters:
    no delay outlasts its buffer.
    """
    if delay and not any(isinstance(effect, Delay) for effect in simulator.effects):
        simulator = with_effects(simulator, [Delay()])
    factor, ranges = jnp.exp(jnp.asarray([-spread, spread])), []
    for effect in simulator.effects:
        later = jnp.asarray([0.0, delay if isinstance(effect, Delay) else 0.0])
        for name, parameter in effect.parameters.items():
            if parameter.unit in TIMES:
                ends = getattr(effect, name) * factor + later
                low, high = jnp.clip(ends, parameter.low, parameter.high)
                ranges.append((float(low), float(high)))
    return vary(simulator, _times, ranges)


def _stacked(values: Sequence[Any]) -> Float[Array, " numbers"]:
    return jnp.stack([jnp.asarray(value, float) for value in values])


def _times(simulator: AbstractSimulator) -> list[Any]:
    """Parameters of the effects that are times."""
    return [
        getattr(effect, name)
        for effect in simulator.effects
        for name, parameter in effect.parameters.items()
        if parameter.unit in TIMES
    ]
