"""Settings as people write them, in files and on the command line; imports nothing heavy."""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from bench.text.errors import UsageError
from simulators import registry

Setting: TypeAlias = bool | int | float | str | list | tuple | dict | None
"""What a setting can be in a file; tables are dicts."""


class SettingsError(UsageError):
    """Settings that a plug-in does not have or does not accept."""


def unknown_key(where: str, key: str, allowed: Iterable[str]) -> str:
    """One line: where an unknown key stands, what was probably meant, and what there is."""
    allowed = sorted(allowed)
    hint = registry.did_you_mean(key, allowed)
    return f"{where} has no key '{key}'.{hint} Allowed: {', '.join(allowed)}."


def parse_settings(assignments: Sequence[str]) -> dict[str, Setting]:
    """Settings by key from KEY=VALUE texts.

    A value is read as in TOML; what TOML cannot read is a text.

    Raises:
        UsageError: A text is no assignment, or a key is given twice.
    """
    found: dict[str, Setting] = {}
    for text in assignments:
        key, equals, value = text.partition("=")
        key = key.strip()
        if not equals or not all(key.split(".")):
            raise UsageError(
                f"`--setting` must be KEY=VALUE, such as trainer.epochs=3, got '{text}'."
            )
        if key in found:
            raise UsageError(f"`--setting` gives '{key}' twice.")
        found[key] = _value(value)
    return found


def nested(settings: Mapping[str, Setting]) -> dict[str, Setting]:
    """Settings as tables within tables, from keys such as `trainer.epochs`.

    Raises:
        UsageError: A key is given both a value and fields.
    """
    found: dict[str, Setting] = {}
    for key, value in settings.items():
        *tables, last = key.split(".")
        place: Setting = found
        for name in tables:
            place = place.setdefault(name, {}) if isinstance(place, dict) else None
        if not isinstance(place, dict) or last in place:
            raise UsageError(f"Settings give both a value and fields to a part of '{key}'.")
        place[last] = dict(value) if isinstance(value, dict) else value
    return found


def _value(text: str) -> Setting:
    try:
        parsed = tomllib.loads(f"x = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return parsed["x"] if len(parsed) == 1 else text  # a line break would begin another key
