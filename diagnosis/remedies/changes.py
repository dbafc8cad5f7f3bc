"""What a diagnosis changes in an autopilot: parameters with factors or sums, and their intervals.

The cards of the effects say which parameter makes up for which effect (`EffectCard.changes`). A
change waits where these flights cannot tell its effect from another that another parameter makes
up for. Effects that change the same parameter are made up for together, by one change.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Literal

from diagnosis.result import Diagnosis, Effect, Parameter
from simulators import registry
from simulators.effects.card import Change, load_card


@dataclasses.dataclass(frozen=True, kw_only=True)
class FirmwareChange:
    """One parameter of an autopilot, and what becomes of it."""

    effects: tuple[str, ...]
    """Registered names of the effects that it makes up for."""
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
    """Effects that these flights cannot tell from those and that change the parameter alike."""
    waits_for: tuple[str, ...]
    """Those that must be told from it first."""
    share: bool
    """Whether the parameter is a share, so that its value must lie between 0 and 1."""

    def of(self, old: float) -> float:
        """The new value of a parameter that is `old` now."""
        return {"times": old * self.amount, "plus": old + self.amount}.get(self.how, self.amount)


def firmware_changes(diagnosis: Diagnosis, autopilot: str) -> tuple[FirmwareChange, ...]:
    """What the effects of the likeliest set change in an autopilot; nothing if there are none.

    Where several of them act on the same parameters in the same way, one change stands for all.
    """
    alike: dict[tuple, list[FirmwareChange]] = {}
    for effect in diagnosis.effects:
        for change in load_card(effect.name).changes:
            if change.autopilot == autopilot and _applies(diagnosis, effect, change):
                made = _of(diagnosis, effect, change)
                alike.setdefault((made.parameters, made.where, made.how), []).append(made)
    return tuple(functools.reduce(_together, same) for same in alike.values())


def without_parameter(diagnosis: Diagnosis, autopilot: str) -> tuple[str, ...]:
    """Effects that no parameter of the autopilot makes up for."""
    changes = firmware_changes(diagnosis, autopilot)
    changed = {name for change in changes for name in change.effects}
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
        gained = [_of_size(lambda name, x: change.gains[name] * x, size) for size in sizes]
        how, (amount, low, high) = "plus", _summed(gained)
    return FirmwareChange(
        effects=(effect.name,),
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
        share=change.share,
    )


def _together(one: FirmwareChange, other: FirmwareChange) -> FirmwareChange:
    """Both changes of the same parameters as one.

    The two amounts are taken as independent, as the sizes of one effect are. That is cautious where
    flights tell little more than their product (mass and thrust), whose errors cancel each other.
    """
    effects = (*one.effects, *other.effects)
    first, second = ((x.amount, x.low, x.high) for x in (one, other))
    if one.how == "value":
        amount, low, high = first
    elif one.how == "times":
        amount, low, high = _mapped(
            math.exp, _summed([_mapped(math.log, x) for x in (first, second)])
        )
    else:
        amount, low, high = _summed([first, second])
    return dataclasses.replace(
        one,
        effects=effects,
        amount=amount,
        low=low,
        high=high,
        descriptive=one.descriptive or other.descriptive,
        alike=_besides(effects, (*one.alike, *other.alike)),
        waits_for=_besides(effects, (*one.waits_for, *other.waits_for)),
    )


def _besides(effects: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """`names` without `effects`, each once."""
    return tuple(dict.fromkeys(name for name in names if name not in effects))


def _shares(alias: str, change: Change) -> bool:
    """Whether the parameter changes alike, whichever of the two effects acts.

    Changes of one parameter that hold on different vehicles (`Change.where`) are not alike.
    """
    acts = (change.autopilot, change.parameter, change.where)
    return any((x.autopilot, x.parameter, x.where) == acts for x in load_card(alias).changes)


Ends = tuple[float, float | None, float | None]
"""A value, and the ends of its interval where there is one."""


def _product(effect: str, change: Change, sizes: list[Parameter]) -> Ends:
    """Factor with its interval; sizes of an effect are taken as independent."""
    kinds = registry.load("effect", effect).parameters

    def log(name: str, value: float) -> float:
        factor = value if kinds[name].neutral == 1.0 else 1.0 + value
        return change.powers[name] * math.log(max(factor, 1e-9))

    return _mapped(math.exp, _summed([_of_size(log, size) for size in sizes]))


def _of_size(function: Callable[[str, float], float], size: Parameter) -> Ends:
    return _mapped(functools.partial(function, size.name), (size.value, size.low, size.high))


def _mapped(function: Callable[[float], float], ends: Ends) -> Ends:
    """A monotonic function of a number, ends in order."""
    value, low, high = ends
    if low is None or high is None:
        return function(value), None, None
    low, high = sorted((function(low), function(high)))
    return function(value), low, high


def _summed(terms: Sequence[Ends]) -> Ends:
    """The sum of independent numbers, and its interval by the root sum of squares."""
    value = sum(term[0] for term in terms)
    below, above = 0.0, 0.0
    for middle, low, high in terms:
        if low is None or high is None:
            return value, None, None
        below, above = below + (middle - low) ** 2, above + (high - middle) ** 2
    return value, value - math.sqrt(below), value + math.sqrt(above)
