"""What there is to run: plug-ins with their settings, and suites."""

import contextlib
import dataclasses
import json
import sys
from collections.abc import Collection, Iterator

import docstring_parser
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.plan.expansion import PlanError, expand
from bench.plan.settings import SettingsError, describe
from bench.plan.suite import built_in, load_suite
from simulators import registry
from simulators.effects.contract import AbstractEffect

OURS = "fidelity-bench"
"""The package of the built-in plug-ins, which is not shown beside them."""
SHOWN_CHARACTERS = 28
"""Characters of a default that are shown."""
REQUIRED = "required"
"""Stands for the default of a field that has none."""


def show_plugins(console: Console, kinds: Collection[str], settings: bool = False) -> None:
    """Prints registered plug-ins; one that cannot be imported with the reason.

    Args:
        console: Where they are shown.
        kinds: Which kinds of them.
        settings: Whether each is followed by its settings with defaults and meanings.
    """
    for kind in kinds:
        table = _table(f"{kind.capitalize()}s")
        for name in registry.names(kind):
            try:
                cls = registry.load(kind, name)
                text = Text(_summary(cls))
            except registry.BrokenPluginError as error:
                cls, text = None, Text(f"broken: {error}", "red")
            package = registry.distribution(kind, name)
            if package.split()[0] != OURS:
                text.append(f" ({package})", "dim")
            table.add_row(Text(name, "bold"), text)
            if settings and isinstance(cls, type) and dataclasses.is_dataclass(cls):
                for key, default, meaning in _lines(cls, None, ""):
                    table.add_row(f"  {key}", Text.assemble((default, "cyan"), "  ", meaning))
        console.print(table)


def show_suites(console: Console) -> None:
    """Prints the built-in suites with their number of runs."""
    table = _table("Suites")
    for name in built_in():
        suite = load_suite(name)
        try:
            plan = expand(suite)
        except PlanError as error:
            table.add_row(Text(name, "bold"), Text(f"0 runs. {error}", "red"))
            continue
        left_out = " Some runs are left out, because a plug-in is broken." * bool(plan.broken)
        table.add_row(Text(name, "bold"), f"{len(plan.runs)} runs. {suite.description}{left_out}")
    console.print(table)


def _summary(cls: type) -> str:
    """First line on a plug-in: its module's, which is about nothing else, or else its own."""
    for docstring in (sys.modules[cls.__module__].__doc__, cls.__doc__):
        if docstring and docstring.strip():
            return docstring.strip().splitlines()[0]
    return ""


def _table(title: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None)
    table.add_column(no_wrap=True, overflow="ignore")
    table.add_column()
    table.show_header = False
    return table


def _lines(cls: type, instance: object, prefix: str) -> Iterator[tuple[str, str, str]]:
    """Key, default and meaning of every setting of a class and of the modules in it.

    A key is what `--setting` takes, such as `trainer.epochs`; a default is JSON, or `REQUIRED`.
    With an `instance`, its values are the defaults.
    """
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
            yield prefix + field.name, _written(value), meaning.strip()


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
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[: SHOWN_CHARACTERS - 4]} ..."


def _docstrings(cls: type) -> dict[str, str]:
    """Docstrings of the fields of a class and of its parents, each on one line."""
    found: dict[str, str] = {}
    for owner in reversed(cls.__mro__[:-1]):
        with contextlib.suppress(TypeError, docstring_parser.ParseError):  # written in C, or odd
            params = docstring_parser.parse_from_object(owner).params
            found |= {p.arg_name: " ".join((p.description or "").split()) for p in params}
    return found
