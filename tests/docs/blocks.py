"""Fenced blocks of a page, and what its commands print, for the tests of this folder."""

import re
import shlex
from pathlib import Path

from bench.cli.app import main


def blocks(page, language):
    """The blocks of one language, in order."""
    return [content for found, content in every_block(page) if found == language]


def every_block(page):
    """All blocks in order: language and content."""
    text = page.read_text(encoding="utf-8")
    return re.findall(r"^```(\w+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def run(line, capsys, diagnose=()):
    """What one command of a page prints, on one line; `diagnose`: more options of that command."""
    words = shlex.split(line.removeprefix("$ bench ").split(" > ")[0])
    given = [w for word in words for w in (sorted(map(str, Path().glob(word))) or [word])]
    assert main([*given, *(diagnose if given[0] == "diagnose" else ())]) == 0
    return " ".join(capsys.readouterr().out.split())
