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
from simulators.effects.contract import AbstractEffect, Parameter
from simulators.effects.delay import Delay
from simulators.effects.wind import Wind
from simulators.flight import Flight
from simulators.vehicle import ActionSpace, VehicleSpec

TIMES = ("s", "rad/s")
"""Units of what `vary_around` varies by a factor: time constants, delays, natural frequencies."""
MOST_PUSH = Wind.parameters["z"].high
"""Largest steady push that may be drawn along each axis [m/s^2]: what `wind` may be upwards."""
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
        numbers = [jnp.asarray(value, float) for value in self.numbers(self.simulator)]
        return VariedState(jnp.stack(numbers), inner)

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


def vary_around(
    simulator: AbstractSimulator, spread: float, delay: float = 0.0, push: float = 0.0
) -> AbstractSimulator:
    """`simulator` with its effects drawn around what they are, anew in every episode.

    Times stay within a factor exp(+-`spread`) of what they are. Commands are up to `delay` [s]
    later than that, and a steady push of up to `push` [m/s^2] acts along each axis of the world.
    Of several delays or winds the last one gets that. All stay within the bounds of their
    parameters: no delay outlasts its buffer.

    Raises:
        ValueError: A number that is to be drawn lies outside of these bounds.
    """
    added = {Delay: (0.0, delay), Wind: (-push, push)}
    present = {type(effect) for effect in simulator.effects}
    if missing := [kind() for kind, (_, most) in added.items() if most and kind not in present]:
        simulator = with_effects(simulator, missing)
    last = {type(effect): effect for effect in simulator.effects}
    factor, ranges = jnp.exp(jnp.asarray([-spread, spread])), []
    for effect, name in _varied(simulator, push > 0.0):
        parameter, value = effect.parameters[name], getattr(effect, name)
        _check_within(parameter, float(value), type(effect).__name__, name)
        ends = value * factor if parameter.unit in TIMES else jnp.broadcast_to(value, 2)
        more = added.get(type(effect), (0.0, 0.0)) if effect is last[type(effect)] else (0.0, 0.0)
        ends = ends + jnp.asarray(more)
        low, high = jnp.clip(ends, parameter.low, parameter.high)
        ranges.append((float(low), float(high)))
    return vary(simulator, _times_and_pushes if push else _times, ranges)


def _check_within(parameter: Parameter, value: float, effect: str, name: str) -> None:
    """Raises if a value lies beyond its bounds, as does the infinity that switches effects off."""
    rounding = 1e-5 * max(abs(parameter.low), abs(parameter.high))
    if not parameter.low - rounding <= value <= parameter.high + rounding:
        raise ValueError(
            f"`{name}` of {effect} must lie in [{parameter.low:g}, {parameter.high:g}] "
            f"{parameter.unit} to be drawn anew in every episode, got {value:g}. Leave the effect "
            "out if it does nothing."
        )


def _times(simulator: AbstractSimulator) -> list[Any]:
    """Parameters of the effects that are times."""
    return [getattr(effect, name) for effect, name in _varied(simulator, pushes=False)]


def _times_and_pushes(simulator: AbstractSimulator) -> list[Any]:
    """The same, and the steady push along each axis."""
    return [getattr(effect, name) for effect, name in _varied(simulator, pushes=True)]


def _varied(simulator: AbstractSimulator, pushes: bool) -> list[tuple[AbstractEffect, str]]:
    """Effects and names of the parameters that are drawn around what they are."""
    return [
        (effect, name)
        for effect in simulator.effects
        for name, parameter in effect.parameters.items()
        if parameter.unit in TIMES or (pushes and type(effect) is Wind)
    ]
