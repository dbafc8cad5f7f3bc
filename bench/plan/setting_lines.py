"""The settings of a plug-in with their defaults and what their docstrings say."""

import ast
import dataclasses
import inspect
import itertools
import json
import textwrap
from collections.abc import Iterator

from bench.plan.settings import SettingsError, describe
from simulators.effects.contract import AbstractEffect

LONGEST = 28
"""Characters of a default that are shown."""
REQUIRED = "required"
"""Stands for the default of a field that has none."""


@dataclasses.dataclass(frozen=True)
class SettingLine:
    """One setting."""

    key: str
    """As `--setting` takes it, such as `trainer.epochs`."""
    default: str
    """Its default as JSON, or `REQUIRED`."""
    meaning: str
    """What its docstring says."""


def setting_lines(cls: type) -> list[SettingLine]:
    """Every setting of a plug-in's class, those of the modules in its fields included."""
    return list(_lines(cls, None, ""))


def _lines(cls: type, instance: object, prefix: str) -> Iterator[SettingLine]:
    """The fields of a class; defaults are those of `instance`, if there is one."""
    docs = _docstrings(cls)
    for field in dataclasses.fields(cls):
        if not field.init:
            continue
        value = _default(field) if instance is None else getattr(instance, field.name)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            yield from _lines(type(value), value, f"{prefix}{field.name}.")
        else:
            meaning = docs.get(field.name, "")
            if issubclass(cls, AbstractEffect) and field.name in cls.parameters:
                info = cls.parameters[field.name]
                meaning += f" Fitted between {info.low:g} and {info.high:g}."
            yield SettingLine(prefix + field.name, _written(value), meaning.strip())


def _default(field: dataclasses.Field) -> object:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _written(value: object) -> str:
    if value is dataclasses.MISSING:
        return REQUIRED
    try:
        text = json.dumps(describe(value, "default"))
    except SettingsError:
        text = type(value).__name__
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]} ..."


def _docstrings(cls: type) -> dict[str, str]:
    """Docstrings of the fields of a class and of its parents, each on one line."""
    found: dict[str, str] = {}
    for owner in reversed(cls.__mro__):
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(owner)))
        except (OSError, TypeError, SyntaxError):  # no source, as of `object`
            continue
        body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
        for field, after in itertools.pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                text = after.value if isinstance(after, ast.Expr) else None
                if isinstance(text, ast.Constant) and isinstance(text.value, str):
                    found[field.target.id] = " ".join(text.value.split())
    return found
