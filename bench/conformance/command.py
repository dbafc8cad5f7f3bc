"""`bench check`: finds a plug-in, runs the suite of its kind, and says what is wrong."""

import dataclasses
import importlib
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from bench.conformance import effects, methods, residuals, simulators, tasks
from bench.conformance.suite import Check, Finding, execute
from bench.plan.keys import Setting, nested, parse_settings
from bench.plan.names import kind_of
from bench.plan.planned_run import REALITY
from bench.plan.settings import build
from bench.text.errors import UsageError
from bench.text.say import say
from methods.contract import AbstractMethod
from methods.residuals.contract import AbstractResidual
from simulators import registry
from simulators.contract import AbstractSimulator
from simulators.effects.contract import AbstractEffect
from tasks.contract import AbstractTask

CONTRACTS = {
    "method": AbstractMethod,
    "task": AbstractTask,
    "simulator": AbstractSimulator,
    "residual": AbstractResidual,
    "effect": AbstractEffect,
}
"""The class that a plug-in of each kind implements."""
SUITES = {"task": tasks, "simulator": simulators, "residual": residuals, "effect": effects}
"""Checks of each kind but methods, which take settings."""


def check(plugin: str, assignments: Sequence[str], simulator_names: Sequence[str]) -> int:
    """Prints every finding; exit status 1 if something is wrong.

    Options as in `bench check`.

    Raises:
        UsageError: There is no such plug-in or setting.
    """
    console = Console()
    kind, cls = find(plugin)
    if assignments and kind != "method":
        raise UsageError(f"`--setting` is for methods, and '{plugin}' is of another kind: {kind}.")
    if simulator_names and kind not in ("effect", "method"):
        raise UsageError(
            f"`--simulator` is for effects and methods, and '{plugin}' is of another kind: {kind}."
        )
    if len(simulator_names) > 1 and kind == "method":
        raise UsageError("`--simulator` may be given once for a method: where it is deployed.")
    if kind == "effect" and not simulator_names:
        realities = registry.load_all("simulator")
    else:
        chosen = simulator_names or [REALITY]
        realities = {name: registry.load("simulator", name) for name in chosen}
    settings = nested(parse_settings(assignments))
    say(console, f"Checking {kind} {getattr(cls, '__qualname__', repr(cls))} of {cls.__module__}.")
    if kind == "method" and _has_fields(cls):
        used = methods.short_settings(cls, settings)
        say(console, f"Trained for a moment with {json.dumps(used)}; change it with --setting.")
    done = wrong = 0
    for finding in findings(kind, cls, realities, settings):
        done += 1
        wrong += bool(finding.problem)
        _show(console, finding)
    if wrong:
        say(console, f"{done} checks executed, {wrong} failed.", "bold red")
        return 1
    say(console, f"{done} checks executed, all passed.", "bold green")
    return 0


def findings(
    kind: str,
    cls: type,
    realities: Mapping[str, type[AbstractSimulator]],
    settings: Mapping[str, Setting],
) -> Iterator[Finding]:
    """What the suite finds; if a declaration is wrong, nothing else is tried.

    Raises:
        SettingsError: A method does not have or accept the settings.
    """
    needs = kind == "method" and _has_fields(cls) and _needs_residual(cls)
    given = {"residual": "affine"} if needs else {}
    given, wanted = {name: settings.get(name, value) for name, value in given.items()}, settings
    settings = {name: value for name, value in settings.items() if name not in given}
    sound = True
    for finding in execute(cls, declarations(kind, cls, given)):
        sound = sound and not finding.problem
        yield finding
    if sound and kind == "method" and wanted:
        build(cls, methods.short_settings(cls, settings), f"Method '{cls.__name__}'", **given)
    if sound:
        yield from execute(cls, behaviour(kind, cls, realities, given, settings))


def find(plugin: str) -> tuple[str, type]:
    """Kind and class of a plug-in by registered name, kind:name, or module:Class."""
    module, _, name = plugin.partition(":")
    if name and module not in registry.GROUPS:
        return _imported(module, name)
    kind, name = kind_of(plugin)
    if kind not in CONTRACTS:
        raise UsageError(f"'{plugin}' is a {kind}, for which there is nothing to check.")
    return kind, registry.load(kind, name)


def _imported(module: str, name: str) -> tuple[str, type]:
    sys.path.insert(0, str(Path.cwd()))
    try:
        cls = getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"{module}:{name} cannot be imported: {type(error).__name__}: {error}"
        ) from error
    finally:
        sys.path.remove(str(Path.cwd()))
    for kind, contract in CONTRACTS.items():
        if isinstance(cls, type) and issubclass(cls, contract):
            return kind, cls
    wanted = ", ".join(contract.__name__ for contract in CONTRACTS.values())
    raise UsageError(f"{module}:{name} is no plug-in: it must be a subclass of one of {wanted}.")


def _has_fields(cls: object) -> bool:
    return isinstance(cls, type) and dataclasses.is_dataclass(cls)


def _needs_residual(cls: type) -> bool:
    fields = {field.name: field for field in dataclasses.fields(cls)}
    return "residual" in fields and not isinstance(fields["residual"].default, str | None)


def declarations(kind: str, cls: type, given: Mapping[str, Setting]) -> list[Check]:
    """Checks of what a class says of itself."""
    if kind == "method":
        return methods.declarations(cls, given)
    return SUITES[kind].declarations(cls)


def behaviour(
    kind: str,
    cls: type,
    realities: Mapping[str, type[AbstractSimulator]],
    given: Mapping[str, Setting],
    settings: Mapping[str, Setting],
) -> list[Check]:
    """Checks of what a class does; its declarations must be sound."""
    if kind == "method":
        return methods.behaviour(cls, next(iter(realities.values())), given, settings)
    if kind == "effect":
        return effects.behaviour(cls, realities)
    return SUITES[kind].behaviour(cls)


def _show(console: Console, finding: Finding) -> None:
    mark, style = ("ok   ", "green") if not finding.problem else ("WRONG", "bold red")
    console.print(Text.assemble((mark, style), f" {finding.sentence}"), soft_wrap=True)
    if finding.problem:
        console.print(Text(f"      {finding.problem}."), soft_wrap=True)
