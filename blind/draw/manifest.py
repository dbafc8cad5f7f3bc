"""The manifest of `bench blind --real`: labelled sets of real flights, none of them shipped.

A TOML file with a table for each set; paths are relative to the file:

    [sets.heavy]
    flights = "logs/heavy"        # folder in the log format
    sha256 = "5f0c..."            # of its files; what is wrong or missing is told
    licence = "MIT"
    airframe = "Crazyflie 2.1"    # scores are given for each airframe
    label = ["mass"]              # effects that act; "none": undisturbed; "unknown": no effect fits
    reference = "plain"           # optional: another set, of the vehicle before the change
    parameters.mass.e = 0.31      # optional: true numbers of effects in the label, SI

The SHA-256 is that of the lines `<SHA-256 of the file>  <path in the folder>` of vehicle.toml and
all files in flights/, sorted by path, each ended by a line feed: what `sha256sum` prints.
"""

import hashlib
import tomllib
from pathlib import Path
from typing import Literal

import pydantic
from pydantic_core import ErrorDetails

from bench.plan.keys import unknown_key
from bench.plan.toml_table import KINDS
from bench.text.errors import UsageError
from simulators import registry

NONE, UNKNOWN = "none", "unknown"
"""Labels of an undisturbed vehicle, and of one with a change that no effect describes."""


class LabelledSet(pydantic.BaseModel, extra="forbid", frozen=True, strict=True):
    """One set of flights, and what is known about it."""

    flights: str
    """Folder, relative to the manifest."""
    sha256: str = ""
    """Digest of its files."""
    licence: str = pydantic.Field(min_length=1)
    """Under which the flights may be used."""
    airframe: str = pydantic.Field(min_length=1)
    """What flew."""
    label: Literal["none", "unknown"] | list[str]
    """Effects that act, or that none does, or that none describes what does."""
    reference: str | None = None
    """Name of the set beside which it is diagnosed."""
    parameters: dict[str, dict[str, float]] = {}
    """True numbers, effect -> parameter -> value, SI."""

    @property
    def acting(self) -> tuple[str, ...]:
        """The effects of the label."""
        return () if isinstance(self.label, str) else tuple(self.label)


class Manifest(pydantic.BaseModel, extra="forbid", frozen=True, strict=True):
    """All sets by name."""

    sets: dict[str, LabelledSet] = pydantic.Field(min_length=1)


def read_manifest(path: Path) -> Manifest:
    """The manifest in a file, after its sets, labels and digests were checked.

    Raises:
        UsageError: It cannot be read, or something in it is wrong; one line for each thing.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read: {str(error).splitlines()[0]}") from error
    try:
        manifest = Manifest.model_validate(content)
    except pydantic.ValidationError as error:
        # A label that is neither a word nor a list is one mistake, not two.
        lines = dict.fromkeys(_in_words(one) for one in error.errors())
        raise UsageError("\n".join(f"{path}: {line}" for line in lines)) from error
    wrong = [
        f"{path}: set `{name}`: {line}"
        for name, own in manifest.sets.items()
        for line in _wrong(path.parent, own, manifest)
    ]
    if wrong:
        raise UsageError("\n".join(wrong))
    return manifest


def _in_words(error: ErrorDetails) -> str:
    """One error of pydantic as a person reads it."""
    kind, place = error["type"], [str(part) for part in error["loc"]]
    if "label" in place[2:3]:
        return f'`{".".join(place[:3])}` must be "none", "unknown" or a list of effects.'
    key = ".".join(place)
    if kind == "missing":
        return f"`{key}` is missing."
    if kind == "extra_forbidden":
        kinds = LabelledSet if len(place) > 1 else Manifest
        where = f"`{'.'.join(place[:-1])}`" if place[1:] else "the file"
        return unknown_key(where, place[-1], kinds.model_fields)
    if kind in ("string_too_short", "too_short"):
        return f"`{key}` is empty."
    return f"`{key}` must be {KINDS.get(kind, 'a number')}, got {error['input']!r}."


def _wrong(folder: Path, own: LabelledSet, manifest: Manifest) -> list[str]:
    """What is wrong with a set whose fields have the right types."""
    found, effects = [], registry.names("effect")
    if not isinstance(own.label, str) and not own.label:
        found.append('`label` is empty; write "none" for undisturbed flights.')
    for name in own.acting:
        if name not in effects:
            found.append(registry.unknown("effect", name, effects))
    for name in own.parameters:
        if name not in own.acting:
            found.append(f"`parameters` speaks of {name}, which is not in `label`.")
    if own.reference is not None and own.reference not in manifest.sets:
        found.append(f"`reference` names no set of this file: {own.reference}.")
    elif own.reference is not None and manifest.sets[own.reference] is own:
        found.append("`reference` is the set itself.")
    place = folder / own.flights
    if not (place / "vehicle.toml").is_file():
        return [*found, f"{place} holds no vehicle.toml."]
    digest = files_digest(place)
    if own.sha256 != digest:
        said = f"is {own.sha256}" if own.sha256 else "is missing"
        found.append(f'`sha256` {said}; that of the files is "{digest}".')
    return found


def files_digest(folder: Path) -> str:
    """SHA-256 of a folder of flights, as the top of this module defines it."""
    files = [folder / "vehicle.toml", *(p for p in (folder / "flights").glob("*") if p.is_file())]
    lines = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(lines.items()))
    return hashlib.sha256(text.encode()).hexdigest()
