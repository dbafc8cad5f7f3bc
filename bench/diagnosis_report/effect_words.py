"""Effects and their parameters in words and units that people use, as their cards say.

An effect without a card is shown under its registered name, in its parameters' own units.
"""

from bench.text.words import clean
from diagnosis.result import Effect
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


def within(interval: str) -> str:
    """An interval in words after its estimate; nothing if it is not known."""
    return f" (95 %: {interval})" if interval else ""


def combined(effect: Effect) -> tuple[str, float, float | None, float | None] | None:
    """What flights tell that cannot tell an effect from aliases that act on the same number.

    Its name, and its change with both ends of the interval, as shares of the nominal; None where
    no alias acts on it.
    """
    own = load_card(clean(effect.name)).combined
    others = [load_card(clean(alias)).combined for alias in effect.aliases]
    if own is None or len(effect.parameters) != 1 or own[0] not in [x[0] for x in others if x]:
        return None
    (size,) = effect.parameters
    value, *ends = (  # an interval may reach beyond what a factor can be
        None if x is None or x <= -1.0 else (1.0 + x) ** own[1] - 1.0
        for x in (size.value, size.low, size.high)
    )
    if value is None:
        return None
    low, high = ends if own[1] > 0.0 else reversed(ends)
    return own[0], value, low, high
