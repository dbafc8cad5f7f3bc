"""Effects and their parameters in words and units that people use, as their cards say.

An effect without a card is shown under its registered name, in its parameters' own units.
"""

from simulators.effects.card import EffectCard, Shown, load_card


def effect_words(name: str) -> EffectCard:
    """How to speak of the effect that is registered as `name`."""
    return load_card(name)


def parameter_words(effect: str, name: str) -> Shown:
    """How to speak of a parameter of an effect."""
    return load_card(effect).shown.get(name) or Shown(name.replace("_", " "))
