"""What a simulator is, and how effects are attached to it."""

import abc
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from simulators import registry
from simulators.effects.contract import DOORS, AbstractEffect
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, ActionSpace, VehicleSpec


class AbstractSimulator(eqx.Module):
    """A team of drones in one world; `vmap` adds worlds."""

    name: eqx.AbstractClassVar[str]
    """Name under which the simulator is registered."""
    version: eqx.AbstractClassVar[str]
    """Declared version; results are reused only while it stays the same."""
    doors: eqx.AbstractClassVar[tuple[str, ...]]
    """The hooks that effects can use here."""
    spec: eqx.AbstractVar[VehicleSpec]
    """The airframe; what a controller believes, whatever effects do to the plant."""
    action_space: eqx.AbstractVar[ActionSpace]
    """How an action in [-1, 1]^3 becomes a command."""
    effects: eqx.AbstractVar[tuple[AbstractEffect, ...]]
    """Attached effects, in the order in which they act."""

    @abc.abstractmethod
    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> Any:
        """The state of a team at rest and level at `pos` [m, world], rotors standing."""

    @abc.abstractmethod
    def restore(
        self,
        flight: Flight,
        cmd_history: Float[Array, "time drones 4"],
        key: PRNGKeyArray,
    ) -> Any:
        """The state at a measured flight.

        What the flight does not tell (rotors, lags, buffers) is warmed up from the commands
        before, `CONTROL_DT` apart, oldest first: roll, pitch, yaw [rad] and thrust [N].
        """

    @abc.abstractmethod
    def step_cmd(self, state: Any, cmd: Float[Array, "drones 4"], duration: float) -> Any:
        """The state after holding roll, pitch, yaw [rad] and thrust [N] for `duration` [s].

        Raises:
            ValueError: The simulator cannot step by that duration.
        """

    @abc.abstractmethod
    def flight(self, state: Any) -> Flight:
        """What can be measured of a state."""

    def sensed(self, state: Any) -> Flight:
        """The flight as controllers and neighbours see it: as it is, unless sensors stand between.

        Rewards, contacts and logs are those of `flight`.
        """
        return self.flight(state)

    def step(self, state: Any, action: Float[Array, "drones 3"]) -> Any:
        """The state one control step of `CONTROL_DT` later, under an action in [-1, 1]^3."""
        return self.step_cmd(state, self.action_space.to_cmd(action), CONTROL_DT)


Simulator = TypeVar("Simulator", bound=AbstractSimulator)


class Replayable(AbstractSimulator):
    """A simulator whose states can be set to what a log says, and whose steps can be repeated.

    Replays of logs (`diagnosis/replay/replay.py`) and the adjoint of a training
    (`methods/training/adjoint.py`) need it; evaluation and plain training do not. Its states have
    the fields `pos` [m, world] and `vel` [m/s, world].
    """

    replay_dt: eqx.AbstractClassVar[float]
    """Integration step of a replay [s]."""
    airframes: eqx.AbstractClassVar[Mapping[str, VehicleSpec]]
    """What it knows of the airframes that a log may name."""

    @property
    def braking(self) -> Float[np.ndarray, " 3"]:
        """Rate [1/s] at which a level drone in hover loses small velocities along each axis.

        Unless another one is given, that of the airframe's drag where the simulator has rotation.
        """
        drags = "rotation" in self.doors
        return np.asarray(self.spec.drag) / self.spec.mass if drags else np.zeros(3)

    def with_motion(
        self, state: Any, pos: Float[Array, "drones 3"], vel: Float[Array, "drones 3"]
    ) -> Any:
        """The state with the drones at `pos` [m] and `vel` [m/s], everything else kept."""
        return eqx.tree_at(lambda s: (s.pos, s.vel), state, (pos, vel))

    @abc.abstractmethod
    def with_attitude(
        self,
        state: Any,
        quat: Float[Array, "drones 4"],
        ang_vel: Float[Array, "drones 3"],
        chosen: Bool[Array, " drones"],
    ) -> Any:
        """The state with the chosen drones at `quat` and `ang_vel` [rad/s, body]."""

    def with_faster_rotors(
        self, state: Any, faster: Float[Array, "drones 4"], chosen: Bool[Array, " drones"]
    ) -> Any:
        """The state with the chosen drones' rotors, if any, faster by those shares.

        Unless another one is given, of a state with a field `rotor_vel`.
        """
        speeds = state.rotor_vel * (1.0 + jnp.where(chosen[:, None], faster, 0.0))
        return eqx.tree_at(lambda s: s.rotor_vel, state, speeds)

    @abc.abstractmethod
    def with_thrust(self, state: Any, thrust: Float[Array, " drones"]) -> Any:
        """The state with every drone's rotors, if any, at the speeds of a nominal thrust [N]."""

    def repeating(self, after: Any) -> AbstractSimulator:
        """The simulator for a step that is known to end in `after`, to be differentiated.

        Its frozen effects may do again what they did in that step instead of computing it. Itself,
        unless another one is given.
        """
        return self


def replayable(simulator: AbstractSimulator) -> Replayable:
    """`simulator`, if logs can be replayed in it.

    Raises:
        TypeError: It is not `Replayable`.
    """
    if isinstance(simulator, Replayable):
        return simulator
    if issubclass(registry.load("simulator", simulator.name), Replayable):
        raise TypeError(
            f"`simulator` must be a simulator itself, got '{simulator.name}' in a "
            f"{type(simulator).__name__}, which meters its flight or draws its parameters: logs "
            "are replayed in `setup.nominal`, or in one that you make."
        )
    raise _not_replayable(simulator.name)


def replayable_class(name: str) -> type[Replayable]:
    """The registered simulator of that name, if logs can be replayed in it.

    Raises:
        TypeError: It is not `Replayable`.
        UnknownPluginError: There is none of that name.
    """
    kind = registry.load("simulator", name)
    if issubclass(kind, Replayable):
        return kind
    raise _not_replayable(name)


def _not_replayable(name: str) -> TypeError:
    kinds = registry.load_all("simulator").items()
    able = ", ".join(known for known, kind in kinds if issubclass(kind, Replayable))
    return TypeError(
        f"`simulator` must be Replayable, so that logs can be replayed in it; got '{name}'. "
        f"Simulators that are: {able}. Derive yours from `simulators.contract.Replayable` and "
        "write its methods."
    )


class MissingDoorError(ValueError):
    """An effect was attached to a simulator that has no hook for it."""


def with_effects(simulator: Simulator, effects: Iterable[AbstractEffect]) -> Simulator:
    """`simulator` with `effects` beside those it has; the list's order does not matter.

    Raises:
        MissingDoorError: The simulator lacks a door that an effect needs.
    """
    effects = tuple(effects)
    for effect in effects:
        needed = (effect.door, *effect.needs)
        if missing := [door for door in needed if door not in simulator.doors]:
            able = [
                name
                for name, other in registry.load_all("simulator").items()
                if all(door in other.doors for door in needed)
            ]
            raise MissingDoorError(
                f"Effect {type(effect).__name__} acts through '{missing[0]}', which simulator "
                f"'{simulator.name}' does not have. Simulators that have it: "
                f"{', '.join(able) or 'none'}."
            )
    ordered = sorted(
        (*simulator.effects, *effects),
        key=lambda e: (DOORS.index(e.door), e.order, type(e).__name__),
    )
    return eqx.tree_at(lambda s: s.effects, simulator, tuple(ordered))
