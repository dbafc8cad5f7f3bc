"""Numbers as people read them."""

import math

MISSING = "-"
"""Shown where there is no number."""


def number(value: float, digits: int) -> str:
    """A number as text, `-` for NaN; with fewer than no digits, rounded to tens, hundreds, ..."""
    if not math.isfinite(value):
        return MISSING
    value, digits = (round(value, digits) if digits < 0 else value), max(digits, 0)
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def significant(value: float, digits: int = 2) -> str:
    """A number with so many significant digits, whole numbers in full: 0.5, 40, 193."""
    if not math.isfinite(value):
        return MISSING
    places = 0 if value == 0.0 else digits - 1 - math.floor(math.log10(abs(value)))
    text = number(value, max(0, places))
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


def seconds(value: float) -> str:
    """A duration as text, in seconds, minutes or hours."""
    if not math.isfinite(value):
        return MISSING
    if value < 120.0:
        return f"{value:.0f} s"
    return f"{value / 60.0:.1f} min" if value < 7200.0 else f"{value / 3600.0:.1f} h"
