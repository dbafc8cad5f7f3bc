"""A simulator whose lags and delays are a little different in every episode."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from simulators.contract import AbstractSimulator
from simulators.effects.contract import AbstractEffect
from simulators.flight import Flight
from simulators.vehicle import ActionSpace, VehicleSpec

TIMES = ("s", "rad/s")
"""Units of the parameters that are varied: time constants, delays, natural frequencies."""


class VariedState(eqx.Module):
    """State of one episode."""

    factors: Float[Array, " times"]
    """What each time is multiplied by [-]."""
    inner: Any
    """State of the simulator that is varied."""


class Varied(AbstractSimulator):
    """Multiplies the times of its effects by exp(U(-spread, spread)), each drawn at reset.

    They stay within the bounds of their parameters: no delay outlasts its buffer. Made by
    `make_varied`. Source: randomized dynamics, Peng et al. (2018), arXiv 1710.06537.
    """

    simulator: AbstractSimulator
    """What is varied."""
    spread: float = eqx.field(static=True)
    """Largest change of the logarithm of a time [-]; 0 varies nothing."""
    spec: VehicleSpec
    """The airframe."""
    action_space: ActionSpace
    """How actions become commands."""
    effects: tuple[AbstractEffect, ...] = ()
    """None beside those of `simulator`."""

    name: ClassVar[str] = "varied"
    version: ClassVar[str] = "1"
    doors: ClassVar[tuple[str, ...]] = ()

    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> VariedState:
        draw_key, key = jax.random.split(key)
        shape = (len(_times(self.simulator)),)
        drawn = jax.random.uniform(draw_key, shape, minval=-self.spread, maxval=self.spread)
        return VariedState(jnp.exp(drawn), self.simulator.reset(pos, key))

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> VariedState:
        """With the times as they are."""
        inner = self.simulator.restore(flight, cmd_history, key)
        return VariedState(jnp.ones(len(_times(self.simulator))), inner)

    def step_cmd(
        self, state: VariedState, cmd: Float[Array, "drones 4"], duration: float
    ) -> VariedState:
        times = [
            jnp.clip(time * factor, low, high)
            for time, (low, high), factor in zip(
                _times(self.simulator), _bounds(self.simulator), state.factors, strict=True
            )
        ]
        simulator = eqx.tree_at(_times, self.simulator, times) if times else self.simulator
        return VariedState(state.factors, simulator.step_cmd(state.inner, cmd, duration))

    def flight(self, state: VariedState) -> Flight:
        return self.simulator.flight(state.inner)

    def turned(
        self,
        state: VariedState,
        quat: Float[Array, "drones 4"],
        ang_vel: Float[Array, "drones 3"],
        chosen: Bool[Array, " drones"],
    ) -> VariedState:
        inner = self.simulator.turned(state.inner, quat, ang_vel, chosen)
        return VariedState(state.factors, inner)


def make_varied(simulator: AbstractSimulator, spread: float) -> Varied:
    """`simulator` with the times of its effects drawn at every reset."""
    return Varied(
        simulator=simulator,
        spread=spread,
        spec=simulator.spec,
        action_space=simulator.action_space,
    )


def _times(simulator: AbstractSimulator) -> list[Any]:
    """Parameters of the effects that are times."""
    return [
        getattr(effect, name)
        for effect in simulator.effects
        for name, parameter in effect.parameters.items()
        if parameter.unit in TIMES
    ]


def _bounds(simulator: AbstractSimulator) -> list[tuple[float, float]]:
    """Least and largest value of each."""
    return [
        (parameter.low, parameter.high)
        for effect in simulator.effects
        for parameter in effect.parameters.values()
        if parameter.unit in TIMES
    ]
