"""Numbers as people read them, with their units and intervals."""

import math
import numbers
from typing import Any, TypeGuard

from bench.text.words import clean

MISSING = "-"
"""Shown where there is no number."""
UNITS = {"m/s^2": "m/s²", "rad/s^2": "rad/s²"}
"""Units as they are shown, where not as they are reported."""
SHOWN = {"m": (1000.0, "mm"), "rad": (180.0 / math.pi, "°")}
"""Factor and unit in which small lengths and angles are shown."""


def is_number(value: Any) -> TypeGuard[float]:
    """Whether `value` is a finite number, of NumPy too."""
    return isinstance(value, numbers.Real) and math.isfinite(value)


def number(value: float, digits: int) -> str:
    """A number as text, `-` for NaN; with fewer than no digits, rounded to tens, hundreds, ..."""
    if not math.isfinite(value):
        return MISSING
    value, digits = (round(value, digits) if digits < 0 else value), max(digits, 0)
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def decimals_of(value: float, digits: int) -> int:
    """Decimals with which `value` shows `digits` significant digits."""
    if value == 0.0:
        return 0
    shortened = float(f"{abs(value):.{digits - 1}e}")
    return max(0, digits - 1 - math.floor(math.log10(shortened)))


def rounded(value: Any, digits: int = 3) -> str:
    """`value` with `digits` significant digits, whole numbers in full, never in exponents."""
    if not is_number(value):
        return MISSING
    if abs(value) < 1e-12:
        return "0"
    return f"{value:.{decimals_of(value, digits)}f}"


def significant(value: Any, digits: int = 2) -> str:
    """`value` with `digits` significant digits and no zeros behind the point: 0.5, 40, 193."""
    text = rounded(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text else text


def places(half: float) -> int:
    """Decimals of a number that is known to +- `half`, below 0 for tens; 1 if that is unknown.

    One or two significant digits of `half`, by the rule of the Particle Data Group (Review of
    Particle Physics, introduction, "Rounding"): two where its first three are 100 to 354, else one;
    our choice from 100 on is always two.
    """
    if not math.isfinite(half) or half <= 0.0:
        return 1
    power = math.floor(math.log10(half))
    leading = half / 10.0**power
    two = leading < 3.55 or power >= 2
    return min((1 if two else 0) - power, 6)


def mean_std(mean: float, std: float, digits: int = 1) -> str:
    """`mean ± std` as text, without the second part where there is no second seed."""
    return number(mean, digits) + (f" ± {number(std, digits)}" if math.isfinite(std) else "")


def span(low: float, high: float, digits: int) -> str:
    """`low to high` as text, `-` where there is no interval."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    return f"{number(low, digits)} to {number(high, digits)}"


def measured(value: float, low: float, high: float) -> str:
    """A number with its interval and the digits that this allows: `2.3 (1.1 to 3.6)`."""
    if not math.isfinite(value):
        return MISSING
    if math.isnan(low):
        return significant(value, 3)
    digits = places(0.5 * (high - low))
    return f"{number(value, digits)} ({span(low, high, digits)})"


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


def scaled(
    low: float | None, high: float | None, factor: float
) -> tuple[float, float] | tuple[None, None]:
    """The ends of an interval times `factor`, in order; None where there is no interval."""
    if low is None or high is None:
        return None, None
    ends = (factor * low, factor * high)
    return min(ends), max(ends)


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


def percent(share: Any, digits: int = 0) -> str:
    """A share of one as a percentage; a small one is no "0 %"."""
    if not is_number(share):
        return MISSING
    if digits == 0 and 0.0 < share < 0.01:
        return "< 1 %"
    return f"{100.0 * share:.{digits}f} %"


def probability(value: Any) -> str:
    """A probability; never rounded to certainty."""
    if not is_number(value):
        return MISSING
    if value > 0.995:
        return "> 0.99"
    return "< 0.01" if value < 0.005 else f"{value:.2f}"


def seconds(value: float) -> str:
    """A duration as text, in seconds, minutes or hours."""
    if not math.isfinite(value):
        return MISSING
    if value < 120.0:
        return f"{value:.0f} s"
    return f"{value / 60.0:.1f} min" if value < 7200.0 else f"{value / 3600.0:.1f} h"
