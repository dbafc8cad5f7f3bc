"""What a diagnosis changes in an autopilot: parameters with factors or sums, and their intervals.

The cards of the effects say which parameter makes up for which effect (`EffectCard.changes`). A
change waits where these flights cannot tell its effect from another that another parameter makes
up for.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Literal

from diagnosis.result import Diagnosis, Effect, Parameter
from simulators import registry
from simulators.effects.card import Change, load_card


@dataclasses.dataclass(frozen=True, kw_only=True)
class FirmwareChange:
    """One parameter of an autopilot, and what becomes of it."""

    effect: str
    """Registered name of the effect that it makes up for."""
    parameters: tuple[str, ...]
    """Names in the firmware; all change alike."""
    where: str
    """In which controller or on which vehicles it acts."""
    how: Literal["times", "plus", "value"]
    """Whether `amount` is a factor, a summand or the new value."""
    amount: float
    """Factor, summand or value."""
    low: float | None
    """Lower end of its 95 % interval."""
    high: float | None
    """Upper end."""
    unit: str
    """Unit of a summand or a value."""
    was: float | None
    """What the parameter holds if it is right now; null where only the autopilot knows."""
    descriptive: bool
    """Whether the size may be biased, so that it says what to look at only."""
    alike: tuple[str, ...]
    """Effects that these flights cannot tell from it and that change the parameter alike."""
    waits_for: tuple[str, ...]
    """Those that must be told from it first."""

    def of(self, old: float) -> float:
        """The new value of a parameter that is `old` now."""
        return {"times": old * self.amount, "plus": old + self.amount}.get(self.how, self.amount)


def firmware_changes(diagnosis: Diagnosis, autopilot: str) -> tuple[FirmwareChange, ...]:
    """What the effects of the likeliest set change in an autopilot; nothing if there are none."""
    return tuple(
        _of(diagnosis, effect, change)
        for effect in diagnosis.effects
        for change in load_card(effect.name).changes
        if change.autopilot == autopilot and _applies(diagnosis, effect, change)
    )


def without_parameter(diagnosis: Diagnosis, autopilot: str) -> tuple[str, ...]:
    """Effects that no parameter of the autopilot makes up for."""
    changed = {change.effect for change in firmware_changes(diagnosis, autopilot)}
    return tuple(effect.name for effect in diagnosis.effects if effect.name not in changed)


def _applies(diagnosis: Diagnosis, effect: Effect, change: Change) -> bool:
    known = {parameter.name for parameter in effect.parameters}
    beside = diagnosis.reference is not None or not change.beside_reference
    return beside and {*change.powers, *change.gains} <= known


def _of(diagnosis: Diagnosis, effect: Effect, change: Change) -> FirmwareChange:
    sizes = [effect.parameter(name) for name in (*change.powers, *change.gains)]
    if change.value is not None:
        how, (amount, low, high) = "value", (change.value, None, None)
    elif change.powers:
        how, (amount, low, high) = "times", _product(effect.name, change, sizes)
    else:
        how, (amount, low, high) = "plus", _sum(change, sizes)
    return FirmwareChange(
        effect=effect.name,
        parameters=tuple(change.parameter.split(", ")),
        where=change.where,
        how=how,
        amount=amount,
        low=low,
        high=high,
        unit=change.unit,
        was=diagnosis.flights.mass if change.holds_mass else None,
        descriptive=diagnosis.verdict != "effect" or any(p.use == "descriptive" for p in sizes),
        alike=tuple(alias for alias in effect.aliases if _shares(alias, change)),
        waits_for=tuple(alias for alias in effect.aliases if not _shares(alias, change)),
    )


def _shares(alias: str, change: Change) -> bool:
    """Whether the parameter changes alike, whichever of the two effects acts."""
    return any(
        (other.autopilot, other.parameter) == (change.autopilot, change.parameter)
        for other in load_card(alias).changes
    )


Ends = tuple[float, float | None, float | None]
"""A value, and the ends of its interval where there is one."""


def _product(effect: str, change: Change, sizes: list[Parameter]) -> Ends:
    """Factor with its interval; sizes of an effect are taken as independent."""
    kinds = registry.load("effect", effect).parameters

    def log(size: Parameter, value: float) -> float:
        factor = value if kinds[size.name].neutral == 1.0 else 1.0 + value
        return change.powers[size.name] * math.log(max(factor, 1e-9))

    value, *ends = _added([(log, size) for size in sizes])
    low, high = (None if end is None else math.exp(end) for end in ends)
    return math.exp(value), low, high


def _sum(change: Change, sizes: list[Parameter]) -> Ends:
    return _added([(lambda size, x: change.gains[size.name] * x, size) for size in sizes])


def _added(terms: Sequence[tuple[Callable[[Parameter, float], float], Parameter]]) -> Ends:
    """A sum of monotonic functions of sizes, and its interval by the root sum of squares."""
    value, below, above = sum(f(size, size.value) for f, size in terms), 0.0, 0.0
    for f, size in terms:
        if size.low is None or size.high is None:
            return value, None, None
        middle, ends = f(size, size.value), sorted((f(size, size.low), f(size, size.high)))
        below, above = below + (middle - ends[0]) ** 2, above + (ends[1] - middle) ** 2
    return value, value - math.sqrt(below), value + math.sqrt(above)
