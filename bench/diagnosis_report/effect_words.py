"""Effects and their parameters in words and units that people use, as their cards say.

An effect without a card is shown under its registered name, in its parameters' own units.
"""

from bench.diagnosis_report.numbers import clean, estimate, join, with_unit
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


def combined(effect: Effect) -> list[str]:
    """What flights tell that cannot tell an effect from aliases that act on the same number."""
    own = load_card(clean(effect.name)).combined
    if own is None or len(effect.parameters) != 1:
        return []
    name, power = own
    others = [load_card(clean(alias)) for alias in effect.aliases]
    same = [card.label for card in others if card.combined and card.combined[0] == name]
    if not same:
        return []
    which = (
        join([load_card(clean(effect.name)).label, *same]) if len(same) < len(others) else "them"
    )
    (size,) = effect.parameters
    low, high = (
        None if x is None else 100.0 * ((1.0 + x) ** power - 1.0) for x in (size.low, size.high)
    )
    ends = (low, high) if low is None or high is None else (min(low, high), max(low, high))
    value, interval = estimate(100.0 * ((1.0 + size.value) ** power - 1.0), *ends)
    size_text = f"{value} %" + within(with_unit(interval, "%") if interval else "")
    return [f"What these flights tell is {name}: {size_text}, whichever of {which} it is."]
