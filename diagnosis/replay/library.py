"""The candidates of a diagnosis as one flat vector of parameters.

Every effect of the library is attached to the simulator at once and stands at its neutral value,
so that one compiled program serves every candidate set: a set is a choice of entries.
"""

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from simulators import registry
from simulators.contract import AbstractSimulator, with_effects
from simulators.effects.contract import AbstractEffect

LEFT_OUT = ("floor",)
"""Effects that are no candidates: a floor is seen or not, it is not estimated from its slope."""

NEVER_BLAMED = ("gyro_compensation", "rotor_arm", "rotor_response", "rotor_torque")
"""Effects that tell one airframe from another and do not come or go; reference flights may show
them."""

LOCAL = ("wind", "trim", "yaw_misalignment")
"""Effects along whose slopes every window may want something for itself (`verdict.structure`);
attached always, so that what is left over is measured alike whatever is excluded."""

NEEDS_NEIGHBOUR = ("downwash",)
"""Effects that do nothing to a drone that flies alone."""

NEEDS_VOLTAGE = ("voltage_sag",)
"""Effects that follow a logged voltage, of which a vehicle has one."""

NEEDS_ATTITUDE_CMD = (
    "attitude_gain",
    "attitude_lag",
    "attitude_loop",
    "center_of_mass",
    "delay",
    "gyro_compensation",
    "inertia",
    "roll_pitch_gains",
    "rotor_arm",
    "rotor_inertia",
    "rotor_torque",
    "trim",
    "yaw_gains",
    "yaw_misalignment",
)
"""Effects that are not observable where the attitude is prescribed from measurement."""

NEEDS_THRUST_CMD = ("motor_lag", "rotor_response", "thrust_lag")
"""Effects that are not observable where the rotors' speeds are measured."""

FAMILIES: Mapping[str, frozenset[str]] = {
    name: frozenset(family)
    for family in (
        ("mass", "thrust_gain"),
        ("drag", "quadratic_drag", "rotor_drag"),
        ("wind", "gust"),
        (
            "attitude_lag",
            "attitude_loop",
            "delay",
            "motor_lag",
            "inertia",
            "roll_pitch_gains",
            "rotor_arm",
            "rotor_inertia",
            "rotor_torque",
            "yaw_gains",
        ),
        ("thrust_lag", "motor_lag", "rotor_response"),
        ("trim", "center_of_mass"),
        ("battery", "voltage_sag"),
    )
    for name in family
}
"""Effects that ordinary flights often cannot tell apart, and that are excluded together."""


FAR = 1e9
"""Stands for an infinite neutral value (a natural frequency), so that vectors can be compared."""
WEAKEST = -0.8
"""Least thrust gain of a map from PWM and voltage: that of one drone gave 2.0 times its weight in
hover; the bound is a guess."""


@dataclasses.dataclass(frozen=True)
class Slot:
    """One number of the vector."""

    effect: str
    """Registered name of the effect."""
    parameter: str
    """Name of its parameter."""
    unit: str
    """Unit."""
    neutral: float
    """Neutral value, where the simulator is nominal; `FAR` where that is infinite."""
    low: float
    """Smallest value that a fit may try."""
    high: float
    """Largest value that a fit may try."""
    factor: bool = False
    """Whether it multiplies (`Parameter.factor`)."""

    def beyond(self, value: float, base: float) -> tuple[float, float]:
        """What acts on top of `base` where the vector holds `value`, and its slope by `value`."""
        if not self.factor:
            return self.neutral + value - base, 1.0
        one = 1.0 - self.neutral
        return (value + one) / (base + one) - one, 1.0 / (base + one)

    def on_top(self, value: float, base: float) -> float:
        """What the vector holds where `value` acts on top of `base`."""
        if not self.factor:
            return value + base - self.neutral
        one = 1.0 - self.neutral
        return (value + one) * (base + one) - one

    def walked(self, value: float, by: float) -> float:
        """`value` after a step: factors grow by factors, so that steps hold ratios between them.

        How fast a drone turns goes by the arms of its rotors over its inertia, say.
        """
        one = 1.0 - self.neutral
        if not self.factor or value + one <= 0.0 or abs(by) > value + one:
            return value + by
        return (value + one) * math.exp(by / (value + one)) - one


class Library(eqx.Module):
    """The effects that a simulator has doors for, and where each stands in the vector."""

    simulator: AbstractSimulator
    """The simulator without them."""
    effects: Mapping[str, type[AbstractEffect]] = eqx.field(static=True)
    """Effect classes by registered name."""
    slots: tuple[Slot, ...] = eqx.field(static=True)
    """The vector's entries."""
    withheld: frozenset[str] = eqx.field(static=True, default=frozenset())
    """Effects that are attached and are no candidates: for their slopes (`LOCAL`), or because they
    may describe what reference flights show."""

    @property
    def candidates(self) -> list[str]:
        """Effects that may be blamed."""
        return [name for name in self.effects if name not in self.withheld]

    @property
    def neutral(self) -> Float[np.ndarray, " params"]:
        """The nominal simulator's vector."""
        return np.asarray([slot.neutral for slot in self.slots])

    @property
    def low(self) -> Float[np.ndarray, " params"]:
        """Lower bounds."""
        return np.asarray([slot.low for slot in self.slots])

    @property
    def high(self) -> Float[np.ndarray, " params"]:
        """Upper bounds."""
        return np.asarray([slot.high for slot in self.slots])

    def indices(self, effect: str) -> list[int]:
        """Where an effect's parameters stand."""
        return [i for i, slot in enumerate(self.slots) if slot.effect == effect]

    def attach(self, vector: Float[Array, " params"]) -> AbstractSimulator:
        """The simulator with every effect of the library, at the values of `vector`."""
        values: dict[str, dict[str, Array]] = {name: {} for name in self.effects}
        for i, slot in enumerate(self.slots):
            values[slot.effect][slot.parameter] = vector[i]
        made = [_made(kind, values[name]) for name, kind in self.effects.items()]
        return with_effects(self.simulator, made)

    def braking(
        self, vector: Float[np.ndarray, " params"], vel: Float[np.ndarray, "*n 3"]
    ) -> Float[np.ndarray, "*n 3"]:
        """Rate [1/s] at which drag at `vector` takes small changes of `vel` away, along each axis.

        Of a level drone in hover, by the nominal drag and the effects that are named here.
        """
        rotors = self.named(vector, "rotor_drag")
        axial, lateral = rotors.get("axial", 0.0), rotors.get("lateral", 0.0)
        heavier = 1.0 + self.named(vector, "mass").get("e", 0.0)
        spec, drags = self.simulator.spec, "rotation" in self.simulator.doors
        own = np.asarray(spec.drag) / spec.mass if drags else np.zeros(3)
        linear = own + self.named(vector, "drag").get("c", 0.0)
        linear = linear + np.asarray([lateral, lateral, axial])
        speed = np.maximum(np.linalg.norm(vel, axis=-1, keepdims=True), 1e-6)
        quadratic = self.named(vector, "quadratic_drag").get("k", 0.0)
        return (linear + quadratic * (speed + vel**2 / speed)) / heavier

    def named(self, vector: Float[np.ndarray, " params"], effect: str) -> dict[str, float]:
        """The parameters of one effect at `vector`, in their units."""
        return {self.slots[i].parameter: float(vector[i]) for i in self.indices(effect)}


def _made(kind: Callable[..., AbstractEffect], values: dict[str, Array]) -> AbstractEffect:
    return kind(**values)


def make_library(
    simulator: AbstractSimulator,
    exclude: Collection[str] = (),
    several_drones: bool = False,
    prescribed: bool = False,
    referenced: bool = False,
    voltage: bool = False,
    produced: bool = False,
    mapped: bool = False,
) -> Library:
    """Every registered effect that `simulator` has the doors for, without those excluded.

    `prescribed`: the attitude comes from measurement, so that effects on it cannot be seen.
    `referenced`: there are reference flights, which those excluded may describe; what changed since
    is still none of them.
    `voltage`: every flight is of one drone that logged its battery's voltage.
    `produced`: the rotors' speeds are measured, so that how they lag cannot be seen.
    `mapped`: thrust is known by a map from PWM and voltage alone, whose scale may be far off.
    """
    exclude = {*exclude, *NEVER_BLAMED}
    effects, slots = {}, []
    for name, kind in sorted(registry.load_all("effect").items()):
        missing = [door for door in (kind.door, *kind.needs) if door not in simulator.doors]
        unseen = (
            (name in NEEDS_NEIGHBOUR and not several_drones)
            or (name in NEEDS_ATTITUDE_CMD and prescribed)
            or (name in NEEDS_THRUST_CMD and produced)
            or (name in NEEDS_VOLTAGE and not voltage)
        )
        hidden = name in exclude and name not in LOCAL and not referenced
        if missing or unseen or hidden or name in LEFT_OUT:
            continue
        effects[name] = kind
        for parameter, info in kind.parameters.items():
            neutral = min(info.neutral, FAR)
            low = WEAKEST if mapped and name == "thrust_gain" else info.low
            slots.append(Slot(name, parameter, info.unit, neutral, low, info.high, info.factor))
    withheld = frozenset(name for name in effects if name in exclude)
    return Library(simulator, effects, tuple(slots), withheld)


def with_aliases(exclude: Collection[str]) -> set[str]:
    """`exclude` and every effect that is statically an alias of one of them."""
    wanted = set(exclude)
    for name in exclude:
        wanted |= set(FAMILIES.get(name, ()))
        wanted |= {other for other, family in FAMILIES.items() if name in family}
    return wanted
