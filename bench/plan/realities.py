"""Simulated realities as text: a simulator and the effects that it has beyond the nominal one."""

import math
import re
from collections.abc import Mapping

from bench.text.errors import UsageError
from simulators import registry
from simulators.contract import AbstractSimulator, MissingDoorError, with_effects
from simulators.effects.chain import canonical
from simulators.effects.contract import Parameter

_PART = re.compile(r"([a-z_0-9]+)\(([^()]*)\)")


def written(reality: AbstractSimulator) -> str:
    """Canonical text of a simulator and its effects."""
    return f"{reality.name}+{canonical(reality.effects)}".rstrip("+")


def parse_reality(text: str, where: str = "`--reality`") -> AbstractSimulator:
    """The simulator with effects that `text` names, such as `crazyflow+mass(e=0.2)+drag(c=1)`.

    `where` is what messages begin with.

    Raises:
        UsageError: A part is not understood, or the simulator lacks a door for it.
        UnknownPluginError: No simulator or effect has that name.
    """
    name, *parts = [part.strip() for part in text.split("+")]
    simulator = registry.load("simulator", name)()
    effects = []
    for part in parts:
        match = _PART.fullmatch(part)
        if match is None:
            raise UsageError(f"{where}: {part!r} is no effect; write NAME(PARAMETER=VALUE).")
        kind = registry.load("effect", match[1])
        effects.append(kind(**_values(match[1], match[2], kind.parameters, where)))
    try:
        return with_effects(simulator, effects)
    except MissingDoorError as error:
        raise UsageError(f"{where}: {error}") from error


def _values(effect: str, text: str, known: Mapping[str, Parameter], where: str) -> dict[str, float]:
    values = {}
    for pair in filter(None, (p.strip() for p in text.split(","))):
        name, _, number = (x.strip() for x in pair.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if name not in known or not math.isfinite(value):
            raise UsageError(
                f"{where}: {pair!r} is no setting of '{effect}'; its parameters are "
                f"{', '.join(known)}, each with a number."
            )
        if name in values:
            raise UsageError(f"{where}: {name} of '{effect}' is given twice.")
        low, high = known[name].low, known[name].high
        if not low <= value <= high:
            raise UsageError(
                f"{where}: {name} of '{effect}' must lie in [{low:g}, {high:g}], got {value:g}."
            )
        values[name] = value
    return values
