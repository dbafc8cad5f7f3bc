"""Words as people read them, and text that is safe to print."""

import re
from collections.abc import Iterable


def join(parts: Iterable[str]) -> str:
    """Parts of a sentence as "a", "a and b" or "a, b and c"."""
    *most, last = [*parts] or [""]
    return f"{', '.join(most)} and {last}" if most else last


def count(n: int, noun: str) -> str:
    """A number of things in words, such as "1 flight" or "3 flights"."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


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
