"""What an effect is: parameters with units and bounds, a memory, and one hook (its door).

A simulator calls the hooks once per integration step: command, autopilot, plant, response or
rotation, wrench, state. Every hook takes and returns the effect's own memory, is written for one
world and all its drones, and is exactly nominal when the parameters stand at their neutral values.

What a diagnosis must do otherwise for some effects is a type beside the door: `OnsetEffect`,
`VoltageEffect`, `BrakingEffect`, `WeightEffect`. `RandomEffect` is one that draws numbers.
"""

import abc
import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from simulators.effects.card import EffectCard
from simulators.flight import Flight
from simulators.vehicle import AutopilotGains, Vehicle

DOORS = (
    "command",
    "autopilot",
    "plant",
    "response",
    "rotation",
    "rotors",
    "wrench",
    "state",
    "sensing",
)
"""The hooks that a simulator may have; `rotation` means that torque and inertia act, `rotors` that
the rotors' own inertia and the curve of their response do, beside one time constant, and `sensing`
that what controllers see is not the flight itself (`simulators/drawn/`)."""
Number = Float[Array, "*drones"] | float
"""What may be given for a parameter; the effect holds an array, without axes unless it was drawn
for each drone."""
DECLARED = "parameter"
"""Key of a field's metadata under which its `Parameter` stands."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Parameter:
    """What the number of an effect means."""

    unit: str
    """SI unit, "-" if dimensionless."""
    low: float
    """Smallest value that a fit may try."""
    high: float
    """Largest value that a fit may try."""
    neutral: float
    """The value at which the simulator is exactly nominal; may lie outside [low, high]."""
    source: str
    """Where the bounds come from; a guess is called a guess."""
    factor: bool = False
    """Whether it multiplies: 1 + value where neutral is 0, the value where neutral is 1."""


def declared(info: Parameter) -> Any:
    """A field of an effect that is this parameter, neutral by default."""
    return eqx.field(converter=jnp.asarray, default=info.neutral, metadata={DECLARED: info})


def parameter(
    unit: str, low: float, high: float, neutral: float = 0.0, *, source: str, factor: bool = False
) -> Any:
    """A field of an effect that is a parameter (`Parameter` has the arguments)."""
    return declared(
        Parameter(unit=unit, low=low, high=high, neutral=neutral, source=source, factor=factor)
    )


def excess(low: float, high: float, source: str) -> Any:
    """A field of an effect that is a relative excess, which multiplies by 1 + its value."""
    return parameter("-", low, high, source=source, factor=True)


class AbstractEffect(eqx.Module):
    """One physical effect that a simulator leaves out."""

    if TYPE_CHECKING:  # else a checker takes the abstract one for an argument
        parameters: ClassVar[dict[str, Parameter]]
    else:
        parameters: eqx.AbstractClassVar[dict[str, Parameter]]
    """Every field that is a number, by name; those declared by `parameter` are entered here."""
    door: eqx.AbstractClassVar[str]
    """The hook through which the effect acts; the class for that door has it."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Further doors without which the effect would act wrongly or not at all."""
    order: ClassVar[int] = 0
    """Place among the effects of the same door; smaller acts first."""
    version: eqx.AbstractClassVar[str]
    """Declared version; results are reused only while it stays the same."""
    card: ClassVar[EffectCard | None] = None
    """What everybody else needs to know of the effect; None stands for a plain one."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        own = {n: x for n, x in vars(cls).items() if isinstance(x, dataclasses.Field)}
        found = {n: x.metadata[DECLARED] for n, x in own.items() if DECLARED in x.metadata}
        if found:
            cls.parameters = {**getattr(cls, "parameters", {}), **found}

    def init(self, n_drones: int, dt: float) -> Any:
        """The memory at reset, a pytree, for steps of `dt` [s]; None without one."""
        return None


class CommandEffect(AbstractEffect):
    """An effect on what the autopilot is told."""

    door: ClassVar[str] = "command"

    @abc.abstractmethod
    def command(
        self, memory: Any, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[Any, Float[Array, "drones 4"]]:
        """The command that takes effect: roll, pitch, yaw [rad] and thrust [N]."""


class AutopilotEffect(AbstractEffect):
    """An effect on the gains of the attitude controller."""

    door: ClassVar[str] = "autopilot"

    @abc.abstractmethod
    def autopilot(
        self, memory: Any, flight: Flight, gains: AutopilotGains, dt: float
    ) -> tuple[Any, AutopilotGains]:
        """The gains as they are at this step."""


class PlantEffect(AbstractEffect):
    """An effect on the plant's constants; the controller's belief stays nominal."""

    door: ClassVar[str] = "plant"

    @abc.abstractmethod
    def plant(
        self, memory: Any, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[Any, Vehicle]:
        """The vehicle as it is at this step."""


class ScalingEffect(PlantEffect):
    """An effect that multiplies one constant of the plant by 1 + e."""

    e: eqx.AbstractVar[Number]
    """Relative excess [-]."""
    scales: eqx.AbstractClassVar[str]
    """The field of `Vehicle` that it multiplies."""

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        value = getattr(vehicle, self.scales) * (1.0 + self.e)
        return None, eqx.tree_at(lambda v: getattr(v, self.scales), vehicle, value)


class ResponseEffect(AbstractEffect):
    """An effect on how attitude and thrust follow the command, for simulators without rotors.

    `rpy_thrust` is what the simulator's own lag (and the effects before) make of the command at
    this step; what the hook returns takes its place.
    """

    door: ClassVar[str] = "response"

    @abc.abstractmethod
    def respond(
        self,
        memory: Any,
        rpy_thrust: Float[Array, "drones 4"],
        cmd: Float[Array, "drones 4"],
        dt: float,
    ) -> tuple[Any, Float[Array, "drones 4"]]:
        """Roll, pitch, yaw [rad] and thrust [N] after this step."""

    @abc.abstractmethod
    def at(self, memory: Any, rpy_thrust: Float[Array, "drones 4"]) -> Any:
        """The memory in a steady flight at `rpy_thrust`, from which `restore` starts."""


class WrenchEffect(AbstractEffect):
    """An effect that pushes or turns the drones."""

    door: ClassVar[str] = "wrench"

    @abc.abstractmethod
    def wrench(
        self, memory: Any, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[Any, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        """Force [N] and torque [N m] at the centre of mass, world frame."""


class StiffEffect(WrenchEffect):
    """A wrench that changes much within one integration step, such as that of a contact.

    Its hook sees positions of the same instant as the velocities. Those of explicit Euler, which
    moves a drone along its old velocity, are half a step older, those of semi-implicit Euler half
    a step younger: with them a spring would feed energy into the flight, or take it.
    """


class ListeningEffect(WrenchEffect):
    """A wrench that also depends on the commands, which it hears before each step."""

    @abc.abstractmethod
    def hear(self, memory: Any, cmd: Float[Array, "drones 4"], dt: float) -> Any:
        """The memory with the command that was sent: roll, pitch, yaw [rad], thrust [N]."""


class FrozenEffect(WrenchEffect):
    """An expensive wrench without a gradient; its memory holds what it did."""

    @abc.abstractmethod
    def repeated(self, memory: Any) -> WrenchEffect:
        """An effect that repeats what led to `memory`."""


class StateEffect(AbstractEffect):
    """An effect that restricts where a drone can be."""

    door: ClassVar[str] = "state"

    @abc.abstractmethod
    def project(self, memory: Any, flight: Flight) -> tuple[Any, Flight]:
        """The flight after the restriction; only `pos` and `vel` may change."""


class OnsetEffect(AbstractEffect):
    """An effect that sets in at a moment, which no gradient at neutral reveals.

    Replays try the moments one by one. `parameters` must list `onset`, too.
    """

    onset: eqx.AbstractVar[Float[Array, ""]]
    """Time since the reset from which on it acts [s]."""


class RandomEffect(AbstractEffect):
    """An effect that draws numbers of its own while it acts; the same key gives the same ones."""

    @abc.abstractmethod
    def seeded(self, memory: Any, key: PRNGKeyArray) -> Any:
        """The memory whose draws come from `key`; `init` gives one with a fixed key."""


class VoltageEffect(AbstractEffect):
    """An effect that follows the battery's voltage, which a replay knows from the log."""

    @abc.abstractmethod
    def at_voltage(self, voltage: Float[Array, ""]) -> Any:
        """The memory at a measured voltage [V], the same for all drones."""


class BrakingEffect(AbstractEffect):
    """An effect by which the velocity of a level drone in hover fades."""

    @staticmethod
    @abc.abstractmethod
    def braking(
        vel: Float[np.ndarray, "*n 3"], values: Mapping[str, float]
    ) -> Float[np.ndarray, "*n 3"]:
        """Rate [1/s] at which small changes of `vel` [m/s, world] fade along each axis.

        Of a drone of the believed mass; `values` are the effect's parameters by name.
        """


class WeightEffect(AbstractEffect):
    """An effect that makes the drone heavier or lighter than believed."""

    @staticmethod
    @abc.abstractmethod
    def weight(values: Mapping[str, float]) -> float:
        """Mass over the believed mass [-]; `values` are the effect's parameters by name."""
