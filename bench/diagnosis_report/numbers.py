"""Numbers with their units and intervals as people read them, and text that is safe to print."""

import math
import re
from collections.abc import Iterable
from typing import Any, TypeGuard

from bench.text.numbers import MISSING

UNITS = {"m/s^2": "m/s²", "rad/s^2": "rad/s²"}
"""Units as they are shown, where not as they are reported."""
SHOWN = {"m": (1000.0, "mm"), "rad": (180.0 / math.pi, "°")}
"""Factor and unit in which small lengths and angles are shown."""


def join(parts: Iterable[str]) -> str:
    """Parts of a sentence as "a", "a and b" or "a, b and c"."""
    *most, last = [*parts] or [""]
    return f"{', '.join(most)} and {last}" if most else last


def count(n: int, noun: str) -> str:
    """A number of things in words, such as "1 flight" or "3 flights"."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def scaled(
    low: float | None, high: float | None, factor: float
) -> tuple[float, float] | tuple[None, None]:
    """The ends of an interval times `factor`, in order; None where there is no interval."""
    if low is None or high is None:
        return None, None
    ends = (factor * low, factor * high)
    return min(ends), max(ends)


def clean(value: object) -> str:
    """`value` as one line of text without control characters, which a terminal would obey.

    What of a file's name is no text is shown as a replacement character.
    """
    flat = re.sub(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]+", " ", str(value))
    return re.sub(r"[\ud800-\udfff]", "\ufffd", flat).strip()


def shorten(text: str, limit: int) -> str:
    """At most `limit` characters of a clean text, the middle left out."""
    if len(text) <= limit:
        return text
    half = (limit - 1) // 2
    return f"{text[:half]}…{text[len(text) - half :]}"


def is_number(value: Any) -> TypeGuard[float]:
    """Whether `value` is a finite number."""
    return isinstance(value, int | float) and math.isfinite(value)


def decimals_of(value: float, digits: int) -> int:
    """Decimals with which `value` shows `digits` significant digits."""
    if value == 0.0:
        return 0
    shortened = float(f"{abs(value):.{digits - 1}e}")
    return max(0, digits - 1 - math.floor(math.log10(shortened)))


def rounded(value: Any, digits: int = 3) -> str:
    """`value` with `digits` significant digits, never in exponents."""
    if not is_number(value):
        return MISSING
    if abs(value) < 1e-12:
        return "0"
    return f"{value:.{decimals_of(value, digits)}f}"


def with_unit(text: str, unit: str) -> str:
    """A number's text followed by its unit; "-" stands for none."""
    unit = UNITS.get(clean(unit), clean(unit))
    if text == MISSING or unit in ("", "-"):
        return text
    return text + unit if unit == "°" else f"{text} {unit}"


def scale_of(unit: str) -> tuple[float, str]:
    """Factor and unit in which values of `unit` are shown."""
    return SHOWN.get(unit, (1.0, unit))


def quantity(value: Any, unit: str, digits: int = 3) -> str:
    """`value` with its unit; lengths below a metre in mm, angles in degrees."""
    if not is_number(value):
        return MISSING
    factor, shown = scale_of(unit)
    if unit == "m" and abs(value) >= 1.0:
        factor, shown = 1.0, unit
    return with_unit(rounded(factor * value, digits), shown)


def estimate(value: Any, low: Any, high: Any) -> tuple[str, str]:
    """Texts of an estimate and of its interval, rounded to what the interval's width allows.

    The second is empty where there is no interval.
    """
    if not is_number(value):
        return MISSING, ""
    if not (is_number(low) and is_number(high)):
        return rounded(value), ""
    width = high - low
    places = decimals_of(width, 2) if width > 0.0 else decimals_of(value, 4)
    places = min(places, decimals_of(value, 5) if value else places)
    value, low, high = (x + 0.0 if round(x, places) else 0.0 for x in (value, low, high))
    return f"{value:.{places}f}", f"{low:.{places}f} to {high:.{places}f}"


def percent(share: Any) -> str:
    """A share of one as a percentage."""
    if not is_number(share):
        return MISSING
    if 0.0 < share < 0.01:
        return "< 1 %"
    return f"{100.0 * share:.0f} %"


def probability(value: Any) -> str:
    """A probability; never rounded to certainty."""
    if not is_number(value):
        return MISSING
    if value > 0.995:
        return "> 0.99"
    return "< 0.01" if value < 0.005 else f"{value:.2f}"
