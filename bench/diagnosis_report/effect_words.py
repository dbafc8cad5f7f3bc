"""Effects and their parameters in words and units that people use, as their cards say.

An effect without a card is shown under its registered name, in its parameters' own units.
"""

from bench.diagnosis_report.numbers import clean
from simulators import registry
from simulators.effects.card import Shown, load_card


def parameter_words(effect: str, name: str) -> Shown:
    """How to speak of a parameter of an effect."""
    return load_card(effect).shown.get(name) or Shown(name.replace("_", " "))


def toward(shown: Shown, value: float) -> tuple[str, float]:
    """The name of a parameter at a value, and the sign that the name takes over, 1 or -1."""
    backward = value < 0 and bool(shown.opposite)
    return clean(shown.opposite if backward else shown.label), -1.0 if backward else 1.0


def range_of(effect: str, parameter: str) -> float | None:
    """All that a parameter may be, SI; None for an effect that nobody has registered."""
    try:
        info = registry.load("effect", effect).parameters[parameter]
    except (KeyError, registry.UnknownPluginError, registry.BrokenPluginError):
        return None
    return info.high - info.low
