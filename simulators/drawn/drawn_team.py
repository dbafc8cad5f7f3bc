"""A team whose drones differ: parameters of effects drawn anew for each drone at every reset.

Every drone flies as a team of one in a simulator with its own numbers; what acts between drones
(downwash, collision) cannot be among the effects. What an effect draws while it acts, such as
turbulence, is the same for the whole team: the drones fly in one air. The key of the reset decides
everything, so that whoever evaluates with the same keys meets the same teams in the same weather.

A number that stands still (`mass(e=0.1)`) is the same for all drones. `Sensing` is what they see.
"""

from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simulators.contract import AbstractSimulator, with_effects
from simulators.distribution import Distribution
from simulators.drawn.sensing import Sensing
from simulators.effects.card import Input
from simulators.effects.contract import AbstractEffect
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, ActionSpace, VehicleSpec

Tree = TypeVar("Tree")


class DrawnState(eqx.Module):
    """State of one episode."""

    numbers: Float[Array, "drones numbers"]
    """What was drawn for each drone, in the order of the effects and their parameters."""
    inner: Any
    """State of each drone in its own simulator, with a leading axis of drones."""
    sight: Any
    """What sensing remembers; None without sensing."""

    version: ClassVar[str] = "1"
    """Version of how teams are drawn; results are reused only while it stays the same."""


class Drawn(AbstractSimulator):
    """`simulator` with effects some of whose parameters are distributions."""

    simulator: AbstractSimulator
    """What each drone flies in, without effects."""
    spec: VehicleSpec
    """The airframe."""
    action_space: ActionSpace
    """How actions become commands."""
    effects: tuple[AbstractEffect, ...] = ()
    """Effects, in the order in which they act; a `Distribution` where a parameter is drawn."""

    SENSES: ClassVar[tuple[str, ...]] = ("sensing",)

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The name of what is flown."""
        return self.simulator.name

    @property
    def version(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The version of what is flown."""
        return self.simulator.version

    @property
    def doors(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The doors of what is flown, and that to what is seen."""
        return (*self.simulator.doors, *self.SENSES)

    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> DrawnState:
        draw_key, flight_key, sense_key = jax.random.split(key, 3)
        numbers = self._draw(draw_key, len(pos))

        def one(own: Array, pos: Array) -> Any:
            return self._drone(own).reset(pos[None], flight_key)

        return self._begun(numbers, jax.vmap(one)(numbers, pos), sense_key)

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> DrawnState:
        """With numbers drawn from `key`; sensing has seen nothing but this flight."""
        draw_key, flight_key, sense_key = jax.random.split(key, 3)
        numbers = self._draw(draw_key, len(flight.pos))

        def one(own: Array, flight: Flight, cmds: Array) -> Any:
            return self._drone(own).restore(flight, cmds[:, None], flight_key)

        alone = jax.tree.map(lambda x: x[:, None] if jnp.ndim(x) else x, flight)
        axes = jax.tree.map(lambda x: 0 if jnp.ndim(x) else None, flight)
        inner = jax.vmap(one, in_axes=(0, axes, 1))(numbers, alone, cmd_history)
        return self._begun(numbers, inner, sense_key)

    def step_cmd(
        self, state: DrawnState, cmd: Float[Array, "drones 4"], duration: float
    ) -> DrawnState:
        """Held for `duration` [s]; with sensing, which looks once a control step, that long."""
        sensing = _sensing(self._own(state.numbers))
        if sensing is not None and duration != CONTROL_DT:
            raise ValueError(
                f"With sensing a step must last {CONTROL_DT} s, one control step, got {duration}."
            )

        def one(own: Array, inner: Any, cmd: Array) -> Any:
            return self._drone(own).step_cmd(inner, cmd[None], duration)

        inner = jax.vmap(one)(state.numbers, state.inner, cmd)
        after = DrawnState(state.numbers, inner, state.sight)
        if sensing is None:
            return after
        sight = sensing.sense(state.sight, self.flight(after))
        return DrawnState(state.numbers, inner, sight)

    def flight(self, state: DrawnState) -> Flight:
        def one(own: Array, inner: Any) -> Flight:
            return self._drone(own).flight(inner)

        found = jax.vmap(one)(state.numbers, state.inner)
        joined = jax.tree.map(lambda x: x[:, 0] if x.ndim > 1 else x, found)
        return eqx.tree_at(lambda f: f.t, joined, joined.t[0])

    def sensed(self, state: DrawnState) -> Flight:
        flight, sensing = self.flight(state), _sensing(self.effects)
        return flight if sensing is None else sensing.seen(state.sight, flight)

    def member(self, key: PRNGKeyArray) -> "Drawn":
        """The reality in which every drone is one and the same, drawn from `key`."""
        (numbers,) = self._draw(key, 1)
        return eqx.tree_at(lambda s: s.effects, self, self._own(numbers), is_leaf=_is_law)

    @property
    def _places(self) -> list[tuple[int, str, Distribution]]:
        """Place of the effect, parameter and distribution of every number that is drawn."""
        return [
            (place, name, value)
            for place, effect in enumerate(self.effects)
            for name in effect.parameters
            if isinstance(value := getattr(effect, name), Distribution)
        ]

    def _draw(self, key: PRNGKeyArray, n_drones: int) -> Float[Array, "drones numbers"]:
        for effect in self.effects:
            if effect.card is not None and Input.NEIGHBOUR in effect.card.inputs:
                raise ValueError(
                    f"{type(effect).__name__} acts between drones, but in a drawn reality every "
                    "drone flies for itself. Leave it out, or give numbers instead of "
                    "distributions."
                )
        shares = jax.random.uniform(key, (n_drones, len(self._places)))
        drawn = [law.quantile(shares[:, i]) for i, (*_, law) in enumerate(self._places)]
        return jnp.stack(drawn, axis=1) if drawn else shares

    def _own(self, numbers: Float[Array, "*drones numbers"]) -> tuple[AbstractEffect, ...]:
        """The effects with what was drawn instead of distributions."""
        places = [(place, name) for place, name, _ in self._places]
        return eqx.tree_at(
            lambda effects: [getattr(effects[place], name) for place, name in places],
            self.effects,
            [numbers[..., i] for i in range(len(places))],
            is_leaf=_is_law,
        )

    def _drone(self, numbers: Float[Array, " numbers"]) -> AbstractSimulator:
        """The simulator of one drone."""
        flown = [effect for effect in self._own(numbers) if not isinstance(effect, Sensing)]
        return with_effects(self.simulator, flown)

    def _begun(self, numbers: Array, inner: Any, key: PRNGKeyArray) -> DrawnState:
        state, sensing = DrawnState(numbers, inner, None), _sensing(self.effects)
        if sensing is None:
            return state
        return DrawnState(numbers, inner, sensing.begin(self.flight(state), key))


def _is_law(x: Any) -> bool:
    return isinstance(x, Distribution)


def _sensing(effects: tuple[AbstractEffect, ...]) -> Sensing | None:
    return next((effect for effect in effects if isinstance(effect, Sensing)), None)


def drawn(simulator: AbstractSimulator, effects: tuple[AbstractEffect, ...]) -> Drawn:
    """`simulator`, which has no effects of its own, with `effects`, some of them drawn.

    Raises:
        MissingDoorError: The simulator lacks a door that an effect needs.
        ValueError: An effect acts between drones.
    """
    bare = Drawn(  # pyright takes the properties of the class for fields
        simulator=simulator,  # pyright: ignore[reportCallIssue]
        spec=simulator.spec,
        action_space=simulator.action_space,
    )
    made = with_effects(bare, effects)
    made._draw(jax.random.key(0), 1)
    return made


def one_member(simulator: Tree, key: PRNGKeyArray) -> Tree:
    """`simulator` for flights of one drone of the team: what is drawn is drawn once, from `key`.

    A drawn reality, or one inside of another simulator, gets its numbers here; any other comes
    back as it is.
    """

    def fixed(node: Any) -> Any:
        return node.member(key) if isinstance(node, Drawn) else node

    return jax.tree.map(fixed, simulator, is_leaf=lambda node: isinstance(node, Drawn))
