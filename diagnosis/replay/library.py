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
from simulators.contract import AbstractSimulator, Replayable, replayable, with_effects
from simulators.effects.card import EffectCard, Input, load_card, load_cards, plain_card
from simulators.effects.contract import (
    AbstractEffect,
    BrakingEffect,
    OnsetEffect,
    VoltageEffect,
    WeightEffect,
)

NOTHING = 1e-9
"""A factor nearer to 0 than this leaves nothing; rounding is smaller."""
FAR = 1e9
"""Stands for an infinite neutral value (a natural frequency), so that vectors can be compared."""


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

    def multiplies(self, base: float) -> bool:
        """Whether a change multiplies `base`. If `base` leaves nothing, a change is added to it."""
        return self.factor and bool(abs(base + 1.0 - self.neutral) > NOTHING)

    def beyond(self, value: float, base: float) -> tuple[float, float]:
        """What acts on top of `base` where the vector holds `value`, and its slope by `value`."""
        if not self.multiplies(base):
            return self.neutral + value - base, 1.0
        one = 1.0 - self.neutral
        return (value + one) / (base + one) - one, 1.0 / (base + one)

    def on_top(self, value: float, base: float) -> float:
        """What the vector holds where `value` acts on top of `base`."""
        if not self.multiplies(base):
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

    simulator: Replayable
    """The simulator without them."""
    effects: Mapping[str, type[AbstractEffect]] = eqx.field(static=True)
    """Effect classes by registered name."""
    slots: tuple[Slot, ...] = eqx.field(static=True)
    """The vector's entries."""
    withheld: frozenset[str] = eqx.field(static=True, default=frozenset())
    """Effects that are attached and are no candidates: for their slopes (`EffectCard.local`), or
    because they may describe what reference flights show."""
    absent: frozenset[Input] = eqx.field(static=True, default=frozenset())
    """What the flights do not offer."""

    @property
    def candidates(self) -> list[str]:
        """Effects that may be blamed."""
        return [name for name in self.effects if name not in self.withheld]

    @property
    def onsets(self) -> dict[str, int]:
        """Where the moments stand from which on effects act, by the effects' names."""
        places = self.indices
        return {
            name: next(i for i in places[name] if self.slots[i].parameter == "onset")
            for name, kind in self.effects.items()
            if issubclass(kind, OnsetEffect)
        }

    @property
    def local(self) -> list[int]:
        """Where the parameters stand that every window may want some of for itself."""
        places = self.indices
        return [i for name in self.effects if self.card(name).local for i in places[name]]

    def why_out(self, name: str, kind: type[AbstractEffect]) -> str:
        """Why a registered effect is no candidate, unless that was asked for."""
        if _missing_door(kind, self.simulator):
            return f"{self.simulator.name} cannot simulate it"
        if _card(name, kind).airframe:
            return "never blamed as a cause: it differs between airframes"
        return _unseen(name, kind, self.absent)

    def card(self, name: str) -> EffectCard:
        """The card of one of its effects."""
        return _card(name, self.effects[name])

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

    @property
    def indices(self) -> dict[str, list[int]]:
        """Where the parameters of each effect stand.

        No method: Equinox looks at every leaf of a module each time that a method of it is asked
        for, and a search asks tens of thousands of times.
        """
        places: dict[str, list[int]] = {name: [] for name in self.effects}
        for i, slot in enumerate(self.slots):
            places[slot.effect].append(i)
        return places

    def attach(self, vector: Float[Array, " params"]) -> Replayable:
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

        Of a level drone in hover, by the nominal drag and the effects that say so of themselves.
        """
        rate = self.simulator.braking * np.ones_like(vel)
        weight = 1.0
        for name, kind in self.effects.items():
            if issubclass(kind, BrakingEffect):
                rate = rate + kind.braking(vel, self.named(vector, name))
            if issubclass(kind, WeightEffect):
                weight *= kind.weight(self.named(vector, name))
        return rate / weight

    def named(self, vector: Float[np.ndarray, " params"], effect: str) -> dict[str, float]:
        """The parameters of one effect at `vector`, in their units."""
        return {self.slots[i].parameter: float(vector[i]) for i in self.indices[effect]}


def _card(name: str, kind: type[AbstractEffect]) -> EffectCard:
    return kind.card or plain_card(name)


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
    twin: bool = False,
) -> Library:
    """Every registered effect that `simulator` has the doors for, without those excluded.

    `prescribed`: the attitude comes from measurement, so that effects on it cannot be seen.
    `several_drones`: some flights have neighbours.
    `referenced`: there are reference flights, which those excluded may describe; what changed since
    is still none of them.
    `voltage`: every flight is of one drone that logged its battery's voltage.
    `produced`: the rotors' speeds are measured, so that how they lag cannot be seen.
    `mapped`: thrust is known by a map from PWM and voltage alone, whose scale may be far off.
    `twin`: a twin of the reference flights stands between them and the effects.

    Raises:
        TypeError: `simulator` is not `Replayable`.
    """
    offered = {
        Input.NEIGHBOUR: several_drones,
        Input.ATTITUDE_CMD: not prescribed,
        Input.THRUST_CMD: not produced,
        Input.VOLTAGE: voltage,
        Input.TWIN: twin,
    }
    absent = frozenset(which for which, there in offered.items() if not there)
    effects, slots, withheld = {}, [], set()
    for name, kind in sorted(registry.load_all("effect").items()):
        card = _card(name, kind)
        excluded = name in exclude or card.airframe
        hidden = excluded and not card.local and not referenced
        if hidden or _missing_door(kind, simulator) or _unseen(name, kind, absent):
            continue
        effects[name] = kind
        withheld |= {name} if excluded else set()
        for parameter, info in kind.parameters.items():
            neutral = min(info.neutral, FAR)
            low = card.low_if_mapped.get(parameter, info.low) if mapped else info.low
            slots.append(Slot(name, parameter, info.unit, neutral, low, info.high, info.factor))
    return Library(replayable(simulator), effects, tuple(slots), frozenset(withheld), absent)


def _missing_door(kind: type[AbstractEffect], simulator: AbstractSimulator) -> str | None:
    doors = (door for door in (kind.door, *kind.needs) if door not in simulator.doors)
    return next(doors, None)


def _unseen(name: str, kind: type[AbstractEffect], absent: Collection[Input]) -> str:
    """Why an effect cannot be fitted to flights that lack `absent`; empty if it can."""
    card = _card(name, kind)
    wanted = {*card.inputs, *([Input.VOLTAGE] if issubclass(kind, VoltageEffect) else [])}
    lacking = (which.value for which in Input if which in wanted and which in absent)
    return card.no_candidate or next(lacking, "")


def with_aliases(exclude: Collection[str]) -> set[str]:
    """`exclude` and every effect of a family that one of them belongs to."""
    if not exclude:
        return set()
    families = {family for name in exclude for family in load_card(name).families}
    return {*exclude} | {name for name, card in load_cards().items() if families & {*card.families}}
