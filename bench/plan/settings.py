"""Settings of plug-ins: the fields of their classes, overridden by name and written out as JSON.

The defaults of the fields are the configuration. A suite overrides single ones; a field that is
itself a module (such as a method's `trainer`) is overridden field by field.
"""

import dataclasses
import json
import math
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

import equinox as eqx
import numpy as np

from bench.plan.keys import Setting, SettingsError, unknown_key

LARGEST_WHOLE_NUMBER = 2**53 - 1
"""The largest whole number that JSON holds exactly (RFC 8785)."""
T = TypeVar("T", bound=eqx.Module)


def build(cls: type[T], overrides: Mapping[str, Setting], where: str, **given: Setting) -> T:
    """An instance of `cls` with `given` and `overrides` instead of its defaults.

    Args:
        cls: A dataclass, such as a method or a task.
        overrides: Field -> value; for a field that is a dataclass itself, a table of its own.
        where: What is built, for messages.
        **given: Fields that overrides may not touch.

    Raises:
        SettingsError: There is no such field, or the class does not accept the value.
    """
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    for key in overrides:
        if key not in fields or key in given:
            raise SettingsError(unknown_key(where, key, set(fields) - set(given)))
    missing = dataclasses.MISSING
    required = {
        key: value
        for key, value in overrides.items()
        if fields[key].default is missing and fields[key].default_factory is missing
    }
    try:
        return _override(cls(**given, **required), overrides, where)
    except SettingsError:
        raise
    except (TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise SettingsError(f"{where} does not accept these settings: {reason}") from error


def _override(instance: T, overrides: Mapping[str, Setting], where: str) -> T:
    """`instance` with some fields replaced, nested ones too."""
    allowed = {field.name: field.type for field in dataclasses.fields(instance) if field.init}
    changes = {}
    for key, value in overrides.items():
        if key not in allowed:
            raise SettingsError(unknown_key(where, key, allowed))
        old, path = getattr(instance, key), f"{where}, {key}"
        if isinstance(old, eqx.Module):
            if not isinstance(value, Mapping):
                raise SettingsError(f"{path} must be a table of its settings, got {value!r}.")
            changes[key] = _override(old, value, path)
        else:
            changes[key] = _like(old, value, allowed[key], path)
    return dataclasses.replace(instance, **changes)


def _like(old: Any, value: Setting, kind: object, path: str) -> Setting:
    """`value`, checked to be of the kind of the default `old`; lists become tuples.

    Where that is None, an annotation `int | None` or `float | None` says what else it may be.
    """
    value = tuple(value) if isinstance(value, list) else value
    if old is None and value is not None:
        others = [t for t in typing.get_args(kind) if t is not type(None)]
        old = {int: 1, float: 0.5}.get(others[0]) if len(others) == 1 else None
    for cls, words in ((bool, "true or false"), (str, "text"), (tuple, "a list")):
        if isinstance(old, cls):
            if isinstance(value, cls):
                return value
            raise SettingsError(f"{path} must be {words} (such as {old!r}), got {value!r}.")
    if isinstance(old, int) and (not isinstance(value, int) or isinstance(value, bool)):
        raise SettingsError(f"{path} must be a whole number (such as {old}), got {value!r}.")
    if isinstance(value, int) and abs(value) > LARGEST_WHOLE_NUMBER:
        raise SettingsError(
            f"{path} must be at most {LARGEST_WHOLE_NUMBER} in size, got {value!r:.40}."
        )
    if isinstance(old, float):
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise SettingsError(f"{path} must be a number (such as {old}), got {value!r}.")
        if math.isnan(value):
            raise SettingsError(f"{path} must be a number (such as {old}), got NaN.")
        return float(value)
    return value


def describe_fields(instance: object, where: str) -> dict[str, Setting]:
    """Fields of a dataclass as JSON, each as `describe` writes it.

    A field that came later, and whose default does what was done before, says so by its metadata,
    {"neutral": True}; it is left out while it stands at its default, so that no key moves by it.
    """
    if not dataclasses.is_dataclass(instance) or isinstance(instance, type):
        raise SettingsError(f"{where} must be a dataclass, got {instance!r:.80}.")
    return {
        field.name: describe(getattr(instance, field.name), f"{where}, {field.name}")
        for field in dataclasses.fields(instance)
        if not (field.metadata.get("neutral") and getattr(instance, field.name) == field.default)
    }


def describe(value: object, where: str) -> Setting:
    """`value` as JSON: dataclasses become tables, arrays lists, functions their names.

    Raises:
        SettingsError: It holds something that has no JSON form.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return describe_fields(value, where)
    if isinstance(value, Mapping):
        return {str(key): describe(item, f"{where}, {key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [describe(item, where) for item in value]
    if isinstance(value, float) and value - value != 0.0:  # JSON knows neither inf nor nan
        return repr(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if eqx.is_array_like(value):
        return describe(np.asarray(value).tolist(), where)
    if callable(value):
        return f"{value.__module__}.{getattr(value, '__qualname__', type(value).__name__)}"
    raise SettingsError(
        f"{where} must be made of numbers, text, lists, tables and named functions, so that it can "
        f"be stored; got a {type(value).__name__}."
    )


def variant(*pairs: tuple[Mapping[str, Setting], Mapping[str, Setting]]) -> str:
    """Canonical text of what differs in pairs of (settings, defaults), e.g. "trainer.lr=0.01"."""
    different = []
    for settings, defaults in pairs:
        flat, reference = flatten(settings), flatten(defaults)
        different += [
            f"{key}={value if isinstance(value, str) else json.dumps(value)}"
            for key, value in flat.items()
            if value != reference.get(key, ...)
        ]
    return ", ".join(sorted(different))


def flatten(tree: Mapping[str, Setting], prefix: str = "") -> dict[str, Setting]:
    """Tables within tables as one, by keys such as `trainer.lr`, each after `prefix`."""
    flat = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat
