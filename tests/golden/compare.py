"""Where two answers differ: names exactly, numbers to a relative tolerance."""

import math
from typing import Any

RELATIVE = 1e-4
"""Relative difference of two numbers that is still rounding: another order of summation moves a
fit's last digits, its tolerance is 1e-6."""
NEGLIGIBLE = 1e-9
"""Absolute difference below which two numbers are the same."""


def differences(kept: Any, found: Any, where: str = "") -> list[str]:
    """One line for each place at which two JSON values differ."""
    if isinstance(kept, dict) and isinstance(found, dict):
        lines = [f"{where}/{key}: missing" for key in sorted(kept.keys() - found.keys())]
        lines += [f"{where}/{key}: new" for key in sorted(found.keys() - kept.keys())]
        for key in sorted(kept.keys() & found.keys()):
            lines += differences(kept[key], found[key], f"{where}/{key}")
        return lines
    if isinstance(kept, list) and isinstance(found, list):
        if len(kept) != len(found):
            return [f"{where}: {len(kept)} entries are {len(found)} now"]
        pairs = zip(kept, found, strict=True)
        return [
            line for i, (a, b) in enumerate(pairs) for line in differences(a, b, f"{where}/{i}")
        ]
    return [] if _equal(kept, found) else [f"{where}: {kept!r} is {found!r} now"]


def _equal(kept: Any, found: Any) -> bool:
    numbers = [isinstance(x, (int, float)) and not isinstance(x, bool) for x in (kept, found)]
    if not all(numbers):
        return type(kept) is type(found) and kept == found
    if math.isnan(kept) or math.isnan(found):
        return math.isnan(kept) and math.isnan(found)
    return math.isclose(kept, found, rel_tol=RELATIVE, abs_tol=NEGLIGIBLE)
