"""Effects and their parameters in words and units that people use, as their cards say.

An effect without a card is shown under its registered name, in its parameters' own units.
"""

import dataclasses
from collections.abc import Iterator

from bench.text.numbers import MISSING, estimate, rounded, scaled, with_unit
from bench.text.words import clean, join
from diagnosis.result import Effect, Parameter
from diagnosis.result_parts import Limit, SharedParameter
from simulators import registry
from simulators.effects.card import Shown, load_card
from simulators.effects.contract import Parameter as Declared

NOT_TOLD = "wider than its range"
"""What stands for an interval of a size that these flights do not tell by itself."""


def parameter_words(effect: str, name: str) -> Shown:
    """How to speak of a parameter of an effect."""
    return load_card(effect).shown.get(name) or Shown(name.replace("_", " "))


def toward(shown: Shown, value: float) -> tuple[str, float]:
    """The name of a parameter at a value, and the sign that the name takes over, 1 or -1."""
    backward = value < 0 and bool(shown.opposite)
    return clean(shown.opposite if backward else shown.label), -1.0 if backward else 1.0


def declared(effect: str, parameter: str) -> Declared | None:
    """What an effect says of a parameter, SI; None for an effect that nobody has registered."""
    try:
        return registry.load("effect", effect).parameters[parameter]
    except (KeyError, registry.UnknownPluginError, registry.BrokenPluginError):
        return None


def outside(effect: str, parameter: Parameter) -> bool:
    """Whether a size lies beyond what its parameter may be, as a change beside a twin can."""
    info = declared(effect, parameter.name)
    return info is not None and not info.low <= parameter.value <= info.high


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


def effect_phrase(effect: Effect, base: str) -> str:
    """A found effect with sizes and intervals, as part of a sentence.

    If an alias acts on the same number as the effect, the phrase gives that number, because the
    flights do not tell which of the two it is, and what each of them would have to be.
    """
    told = combined(effect)
    if told is None:
        return _own_phrase(effect, base)
    name, size, low, high = told
    sign, direction = (-1.0, "less") if size < 0.0 else (1.0, "more")
    value, interval = estimate(100.0 * abs(size), *scaled(low, high, 100.0 * sign))
    between = within(with_unit(interval, "%") if interval else "")
    than = f" than {base}"
    own = (_own_phrase(one, base, intervals=False) for one in _sharing(effect, told))
    each = " or ".join(phrase.replace(than, "") for phrase in own)
    return f"{value} % {direction} {name}{than}{between}, as {each} would give"


def _sharing(
    effect: Effect, told: tuple[str, float, float | None, float | None]
) -> Iterator[Effect]:
    """The effect and its aliases that act on the same number, each as the only one to do it."""
    yield effect
    name, share, *ends = told
    for alias in effect.aliases:
        own = load_card(clean(alias)).combined
        if own is None or own[0] != name:
            continue
        value, *interval = (
            None if x is None else (1.0 + x) ** (1.0 / own[1]) - 1.0 for x in (share, *ends)
        )
        low, high = interval if own[1] > 0.0 else reversed(interval)
        (parameter,) = effect.parameters
        (only,) = registry.load("effect", clean(alias)).parameters
        size = dataclasses.replace(parameter, name=only, value=value, low=low, high=high)
        yield dataclasses.replace(effect, name=alias, aliases=(), parameters=(size,))


def _own_phrase(effect: Effect, base: str, intervals: bool = True) -> str:
    """An effect by the sizes of its own parameters."""
    name = clean(effect.name)
    words = load_card(name)
    if len(effect.parameters) == 1 and words.more:
        (parameter,) = effect.parameters
        negative = parameter.value < 0 and bool(words.less)
        size, interval = parameter_texts(name, parameter, -1.0 if negative else 1.0)
        template = words.less if negative else words.more
        return template.format(size, base=base) + within(interval if intervals else "")
    sizes, directions = [], True
    for parameter in effect.parameters:
        shown = parameter_words(name, parameter.name)
        label, sign = toward(shown, parameter.value)
        size, interval = parameter_texts(name, parameter, sign)
        directions = directions and bool(shown.opposite)
        equal = f"{size} {label}" if shown.opposite else f"{label} = {size}"
        sizes.append(equal + within(interval if intervals else ""))
    return words.noun + (f" {'by' if directions else 'with'} {join(sizes)}" if sizes else "")


def parameter_texts(effect: str, parameter: Parameter, sign: float = 1.0) -> tuple[str, str]:
    """Value and interval of a parameter, both with the unit that people use."""
    words = parameter_words(effect, parameter.name)
    factor, unit = sign * words.factor, words.unit or parameter.unit
    if not_told(effect, parameter):
        return with_unit(rounded(factor * parameter.value, 2), unit), NOT_TOLD
    ends = scaled(parameter.low, parameter.high, factor)
    value, interval = estimate(factor * parameter.value, *ends)
    return with_unit(value, unit), with_unit(interval, unit) if interval else ""


def not_told(effect: str, parameter: Parameter) -> bool:
    """Whether a 95 % interval is wider than all that the parameter may be."""
    info = declared(effect, parameter.name)
    if info is None or parameter.low is None or parameter.high is None:
        return False
    return parameter.high - parameter.low > info.high - info.low


def shared_text(shared: SharedParameter, sign: float = 1.0) -> str:
    """Value of a parameter in the reference flights times `sign`, in the unit that people use."""
    words = parameter_words(shared.effect, shared.parameter)
    return with_unit(rounded(sign * words.factor * shared.value), words.unit or shared.unit)


def use_text(effect: str, parameter: Parameter) -> str:
    """What a size may be used for, and the end of its range where it lies there or beyond."""
    ends = {"low": ("at the lower end of", "below"), "high": ("at the upper end of", "above")}
    if parameter.at_bound not in ends:
        return parameter.use
    at, beyond = ends[parameter.at_bound]
    return f"{parameter.use}, {beyond if outside(effect, parameter) else at} its range"


def limit_text(limit: Limit) -> tuple[str, float | None]:
    """The smallest visible size of a parameter, and its share of all that the parameter may be.

    A factor is shown as such. The share is None where it is not known or above 1.
    """
    if limit.smallest is None:
        return MISSING, None
    words = parameter_words(limit.effect, limit.parameter)
    info = declared(limit.effect, limit.parameter)
    share = None if info is None else limit.smallest / (info.high - info.low)
    if share is not None and share > 1.0:
        return "more than its whole range", None
    factor = info is not None and info.neutral == 1.0
    size = rounded(words.factor * (limit.smallest + factor), 2)
    return with_unit(size, words.unit or limit.unit), share
