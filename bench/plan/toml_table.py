"""Reads keys of the tables in a suite file; each error names the table and the key."""

import dataclasses
from collections.abc import Mapping
from typing import TypeVar

from bench.plan.keys import Setting, unknown_key
from bench.text.errors import UsageError

T = TypeVar("T")


class SuiteError(UsageError):
    """A suite that cannot be run as it is written; the message is one line."""


def check_keys(
    where: str, table: Mapping[str, Setting], cls: type, required: tuple[str, ...]
) -> None:
    """Refuses a key that is no field of `cls`, and a table without a required key."""
    allowed = [field.name for field in dataclasses.fields(cls)]
    for key in table:
        if key not in allowed:
            raise SuiteError(unknown_key(where, key, allowed))
    for key in required:
        if key not in table:
            raise SuiteError(f"{where} lacks the key '{key}'.")


def typed(
    where: str, table: Mapping[str, Setting], key: str, kind: type[T], default: T | None = None
) -> T:
    """The value of a key, which must be of a kind; without a default the key must be there."""
    value = table[key] if default is None else table.get(key, default)
    if not isinstance(value, kind) or isinstance(value, bool):
        words = {str: "text", int: "a whole number", dict: "a table", list: "a list"}[kind]
        raise SuiteError(f"{where}: `{key}` must be {words}, got {value!r}.")
    return value


def flag(where: str, table: Mapping[str, Setting], key: str) -> bool:
    """The value of a key that is true or false; false without it."""
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise SuiteError(f"{where}: `{key}` must be true or false, got {value!r}.")
    return value


def values(where: str, table: Mapping[str, Setting], key: str, kind: type[T]) -> tuple[T, ...]:
    """The values of a key that has a list, each of a kind."""
    found = typed(where, table, key, list)
    return tuple(typed(where, {key: value}, key, kind) for value in found)
