"""What all HTML pages of the harness share: templates, and texts that can do no harm in them."""

import functools
import os
import re
from pathlib import Path

import jinja2

from bench.text.errors import UsageError

MOST_CHARACTERS = 120
"""Longest file name made of a text."""


@functools.cache
def environment() -> jinja2.Environment:
    """Templates that escape every value and refuse unknown ones."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parents[1] / "report" / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # JSON has neither NaN nor infinities: a page that holds one is not written (ValueError).
    made.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    made.filters["unbroken"] = unbroken
    return made


def unbroken(text: str) -> str:
    """`text` in which no line breaks between a number and its unit."""
    return re.sub(r"(?<=\d) (?=(?:%|mm|ms|m|s|N|m/s²?|1/s|1/m)(?![\w/]))", "\u00a0", text)


def file_name(text: str) -> str:
    """`text` as the name of one file: letters, digits, `.`, `_`, `+`, `-`; no hidden file."""
    return re.sub(r"[^A-Za-z0-9._+-]+", "_", text).lstrip(".")[:MOST_CHARACTERS] or "_"


def read_notes(path: Path) -> str:
    """A text file that goes into a document.

    Raises:
        UsageError: It cannot be read.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"The notes in {path} cannot be read: {error}") from error


def refuse_folder(path: Path) -> None:
    """Raises UsageError if a file is to be written where a folder is."""
    if path.is_dir():
        raise UsageError(f"{path} is a folder, so no file can be written there.")


def write_text(path: Path, text: str) -> None:
    """Writes a text whole or not at all, folders included.

    Raises:
        UsageError: There is a folder of that name.
    """
    path = Path(path)
    refuse_folder(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def documents_of(tables_dir: Path) -> Path:
    """Where the documents of a folder of tables are, as `bench run` lays them out."""
    place = tables_dir.absolute()
    if place.parent.name == "results":
        return Path(os.path.relpath(place.parent.parent / "reports" / place.name))
    return tables_dir
