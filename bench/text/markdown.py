"""Markdown tables in which any text is harmless."""

import html
import re
from collections.abc import Iterable, Sequence


def escape(text: str) -> str:
    r"""`text` as it can stand in a Markdown cell or paragraph and be shown literally.

    HTML becomes entities; `|`, backticks, brackets, asterisks and backslashes get a backslash;
    line breaks and other control characters become spaces.
    """
    flat = re.sub(r"[\x00-\x1f\x7f\u2028\u2029]+", " ", text)
    return re.sub(r"([\\`*\[\]|~])", r"\\\1", html.escape(flat, quote=False))


def table(
    headings: Sequence[str], rows: Iterable[Sequence[str]], left: Iterable[int] = (0,)
) -> str:
    """A Markdown table of finished (escaped) cells; columns in `left` align left, others right."""
    left = set(left)
    rule = [":---" if i in left else "---:" for i in range(len(headings))]
    return "\n".join(_line(cells) for cells in [headings, rule, *rows])


def text_table(
    headings: Sequence[str], rows: Iterable[Sequence[str]], left: Iterable[int] = (0,)
) -> str:
    """A Markdown table of any texts, which it escapes."""
    escaped = [[escape(text) for text in row] for row in [headings, *rows]]
    return table(escaped[0], escaped[1:], left)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def anchor(heading: str) -> str:
    """Where links find a heading: its text in small letters with hyphens, as on GitHub."""
    return re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip())
