"""Simulators as text: a high-fidelity one with effects, or the low-fidelity one with effects."""

import functools
import math
import re
from collections.abc import Mapping
from typing import Any

import equinox as eqx

from bench.plan.keys import Setting, SettingsError
from bench.plan.names import SENSING, world_text, worlds
from bench.plan.settings import build
from bench.text.errors import UsageError
from simulators import registry
from simulators.contract import AbstractSimulator, with_effects
from simulators.distribution import Distribution
from simulators.drawn.drawn_team import Drawn, drawn
from simulators.drawn.sensing import Sensing
from simulators.effects.chain import canonical
from simulators.effects.contract import AbstractEffect, Parameter

NOMINAL = "point_mass"
"""Name of the low-fidelity simulator."""
EFFECTS = "effects"
"""Its setting that is text, as in a reality: "floor(height=0)"."""

_PART = re.compile(r"([a-z_0-9]+)\(((?:[^()]|\([^()]*\))*)\)")
_PAIR = re.compile(r"[^,()]*(?:\([^()]*\)[^,()]*)?")
_LAW = re.compile(r"(\w+)\(([^,]+),([^,]+)\)")


def written(reality: AbstractSimulator) -> str:
    """Canonical text of a simulator and its effects."""
    return joined(reality.name, canonical(reality.effects))


def joined(simulator: str, effects: str) -> str:
    """A simulator and the canonical text of its effects, as rows write a world."""
    return f"{simulator}+{effects}".rstrip("+")


def shortened(text: str) -> str:
    """`text` with the names of worlds in the place of what they are (`named_worlds.toml`)."""
    if "(" not in text:  # without effects there is nothing to shorten, and no plug-in to load
        return text
    for long, name in _names().items():
        text = re.sub(re.escape(long) + "(?!;)", name, text)  # not a world with more effects
    return text


@functools.cache
def _names() -> dict[str, str]:
    """Name of each named world, by its canonical text."""
    return {written(parse_reality(name)): name for name in worlds()}


def parse_reality(text: str, where: str = "`--reality`") -> AbstractSimulator:
    """The simulator with effects that `text` names, such as `crazyflow+mass(e=0.2)+drag(c=1)`.

    `text` may be the name of a world (`bench/plan/named_worlds.toml`). A parameter with a
    distribution, such as `mass(e~normal(0, 0.05))`, is drawn for each drone and episode;
    `sensing(...)` is what drones see. `where` is what messages begin with.

    Raises:
        UsageError: A part is not understood, or the simulator lacks a door for it.
        UnknownPluginError: No simulator or effect has that name.
    """
    name, *parts = [part.strip() for part in world_text(text).split("+")]
    simulator = registry.load("simulator", name)()
    effects, drawn_anew = [], False
    for part in parts:
        match = _PART.fullmatch(part)
        if match is None:
            raise UsageError(f"{where}: {part!r} is no effect; write NAME(PARAMETER=VALUE).")
        kind = Sensing if match[1] == SENSING else registry.load("effect", match[1])
        values = _values(match[1], match[2], kind.parameters, where)
        laws = {p: law for p, law in values.items() if isinstance(law, Distribution)}
        numbers = {p: x for p, x in values.items() if p not in laws}
        effects.append(_with_laws(kind(**numbers), laws))
        drawn_anew |= bool(laws) or kind is Sensing
    try:
        attach = drawn if drawn_anew else with_effects
        return attach(simulator, tuple(effects))
    except ValueError as error:  # a door is missing, or it cannot be part of a drawn reality
        raise UsageError(f"{where}: {error}") from error


def nominal_simulator(
    settings: Mapping[str, Setting], where: str = f"Simulator '{NOMINAL}'"
) -> AbstractSimulator:
    """The low-fidelity simulator with these settings; `effects` is text: "floor(height=0)".

    Raises:
        SettingsError: There is no such setting, or it does not accept the value.
        UsageError: The effects are not understood, or the simulator lacks a door for one.
        UnknownPluginError: No effect has that name.
    """
    text, place = settings.get(EFFECTS, ""), f"{where}, {EFFECTS}"
    if not isinstance(text, str):
        raise SettingsError(f"{place} must be text, such as 'floor(height=0)', got {text!r}.")
    fields = {name: value for name, value in settings.items() if name != EFFECTS}
    plain = build(registry.load("simulator", NOMINAL), fields, where)
    if not text:
        return plain
    with_text = parse_reality(f"{NOMINAL}+{text}", place)
    if isinstance(with_text, Drawn):
        raise UsageError(f"{place}: effects of this simulator are numbers, none is drawn.")
    return with_effects(plain, with_text.effects)


def _with_laws(effect: AbstractEffect, laws: Mapping[str, Distribution]) -> AbstractEffect:
    names = list(laws)
    places = lambda e: [getattr(e, name) for name in names]  # noqa: E731
    return eqx.tree_at(places, effect, [laws[name] for name in names])


def _values(effect: str, text: str, known: Mapping[str, Parameter], where: str) -> dict[str, Any]:
    """Number or distribution of each parameter that `text` gives."""
    values: dict[str, Any] = {}
    for pair in filter(None, (p.strip() for p in _PAIR.findall(text))):
        sign = next((x for x in pair if x in "=~"), "")
        name, _, value = (x.strip() for x in pair.partition(sign or "="))
        if name not in known or not sign:
            raise _no_setting(where, effect, pair, known)
        if name in values:
            raise UsageError(f"{where}: {name} of '{effect}' is given twice.")
        parameter = known[name]
        if sign == "=":
            values[name] = number = _number(value)
            if not math.isfinite(number):
                raise _no_setting(where, effect, pair, known)
            if not parameter.low <= number <= parameter.high:
                raise UsageError(
                    f"{where}: {name} of '{effect}' must lie in [{parameter.low:g}, "
                    f"{parameter.high:g}], got {number:g}."
                )
            continue
        law = _LAW.fullmatch(value)
        if law is None:
            raise _no_setting(where, effect, pair, known)
        numbers = (_number(law[2]), _number(law[3]))
        try:
            values[name] = Distribution(law[1], *numbers, parameter.low, parameter.high)
        except ValueError as error:
            raise UsageError(f"{where}: {name} of '{effect}': {error}.") from error
    return values


def _number(text: str) -> float:
    """The number that `text` is; NaN for none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _no_setting(where: str, effect: str, pair: str, known: Mapping[str, Parameter]) -> UsageError:
    return UsageError(
        f"{where}: {pair!r} is no setting of '{effect}'; its parameters are {', '.join(known)}, "
        "each with a number, or with a distribution such as ~normal(0, 0.05) or ~uniform(0, 1)."
    )
