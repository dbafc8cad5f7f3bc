"""Fenced blocks of a page, for the tests of this folder."""

import re


def blocks(page, language):
    """The blocks of one language, in order."""
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
