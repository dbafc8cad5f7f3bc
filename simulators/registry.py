"""Plug-ins by name, through entry points; each is imported only when it is asked for.

Third parties register classes under the same groups that the built-in ones use. A plug-in that
cannot be imported is named in a warning and stops nobody else.
"""

import difflib
import functools
import importlib.metadata
import warnings
from collections.abc import Iterable
from typing import Any

GROUPS = {
    "method": "bench.methods",
    "task": "bench.tasks",
    "simulator": "bench.simulators",
    "residual": "bench.residuals",
    "effect": "bench.effects",
    "command": "bench.commands",
}
"""Entry-point group of each kind of plug-in."""


class UnknownPluginError(ValueError):
    """A name that nobody registered."""


class BrokenPluginError(ValueError):
    """A registered plug-in that could not be imported."""


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """One line that says what is wrong, what was probably meant, and what there is."""
    known = sorted(known)
    hint = did_you_mean(name, known)
    return f"No {kind} is registered as '{name}'.{hint} Registered: {', '.join(known)}."


def did_you_mean(name: str, known: Iterable[str], likeness: float = 0.5) -> str:
    """A question after the name in `known` that `name` is like, empty where none is.

    `likeness` is the least ratio of `difflib.SequenceMatcher`, from 0 to 1.
    """
    close = difflib.get_close_matches(name, sorted(known), n=1, cutoff=likeness)
    return f" Did you mean '{close[0]}'?" if close else ""


@functools.cache
def _entry_points(kind: str) -> dict[str, Any]:
    # Any: they are of the backport's class once some package has imported importlib_metadata.
    return {point.name: point for point in importlib.metadata.entry_points(group=GROUPS[kind])}


def names(kind: str) -> list[str]:
    """Names of all registered plug-ins of a kind, sorted; nothing is imported."""
    return sorted(_entry_points(kind))


def distribution(kind: str, name: str) -> str:
    """The installed package, with version, that registers a plug-in."""
    dist = _entry_points(kind)[name].dist
    return f"{dist.name} {dist.version}" if dist else "unknown"


@functools.cache
def load(kind: str, name: str) -> Any:
    """The class, or a command's function, registered as `name`.

    Raises:
        UnknownPluginError: Nobody registered that name.
        BrokenPluginError: Its module does not import, or ends the program.
    """
    points = _entry_points(kind)
    if name not in points:
        raise UnknownPluginError(unknown(kind, name, points))
    try:
        return points[name].load()
    except (Exception, SystemExit) as error:  # also of modules that call sys.exit
        raise BrokenPluginError(
            f"The {kind} '{name}' of {distribution(kind, name)} cannot be imported: "
            f"{type(error).__name__}: {error}"
        ) from error


def load_all(kind: str) -> dict[str, Any]:
    """Every plug-in of a kind that imports; each other one is named in a warning."""
    found = {}
    for name in names(kind):
        try:
            found[name] = load(kind, name)
        except BrokenPluginError as error:
            warnings.warn(str(error), stacklevel=2)
    return found
