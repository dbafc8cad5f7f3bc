"""A simulator whose dynamics are a little different in every episode."""

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

    effects: tuple[AbstractEffect, ...]
    """The effects as they are in this episode."""
    inner: Any
    """State of the simulator that is varied."""


class Varied(AbstractSimulator):
    """Scales the times of all effects by exp(U(-spread, spread)), each drawn anew at reset.

    Source: domain randomization of dynamics, Peng et al. (2018), arXiv 1710.06537.
    """

    simulator: AbstractSimulator
    """What is varied, with its effects."""
    spread: float = eqx.field(static=True)
    """Largest change of the logarithm of a time [-]."""

    name: ClassVar[str] = "varied"
    version: ClassVar[str] = "1"
    doors: ClassVar[tuple[str, ...]] = ()

    @property
    def spec(self) -> VehicleSpec:
        return self.simulator.spec

    @property
    def action_space(self) -> ActionSpace:
        return self.simulator.action_space

    @property
    def effects(self) -> tuple[AbstractEffect, ...]:
        return self.simulator.effects

    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> VariedState:
        draw_key, key = jax.random.split(key)
        effects = tuple(
            self._drawn(effect, jax.random.fold_in(draw_key, i))
            for i, effect in enumerate(self.simulator.effects)
        )
        return VariedState(effects, self.simulator.reset(pos, key))

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> VariedState:
        return VariedState(self.simulator.effects, self.simulator.restore(flight, cmd_history, key))

    def step_cmd(
        self, state: VariedState, cmd: Float[Array, "drones 4"], duration: float
    ) -> VariedState:
        simulator = eqx.tree_at(lambda s: s.effects, self.simulator, state.effects)
        return VariedState(state.effects, simulator.step_cmd(state.inner, cmd, duration))

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
        return VariedState(state.effects, inner)

    def _drawn(self, effect: AbstractEffect, key: PRNGKeyArray) -> AbstractEffect:
        for i, (name, parameter) in enumerate(effect.parameters.items()):
            if parameter.unit in TIMES:
                change = jax.random.uniform(
                    jax.random.fold_in(key, i), minval=-self.spread, maxval=self.spread
                )
                value = getattr(effect, name) * jnp.exp(change)
                effect = eqx.tree_at(lambda e, name=name: getattr(e, name), effect, value)
        return effect
