"""Registered names, checked without importing any plug-in."""

import functools
import tomllib
from pathlib import Path

from simulators import registry

WORLDS = Path(__file__).with_name("named_worlds.toml")
"""Realities with a name."""
SENSING = "sensing"
"""Name of what drones see in the text of a reality; it is no registered effect."""


@functools.cache
def worlds() -> dict[str, str]:
    """Realities with a name, as text."""
    found = tomllib.loads(WORLDS.read_text(encoding="utf-8"))
    return {name: " ".join(text.split()) for name, text in found.items()}


def world_text(reality: str) -> str:
    """What a reality is: the text behind a name, or the text itself."""
    return worlds().get(reality.strip(), reality)


def require(kind: str, name: str) -> None:
    """Refuses a name that is not registered.

    Raises:
        UnknownPluginError: Nobody registered that name.
    """
    known = registry.names(kind)
    if name not in known:
        raise registry.UnknownPluginError(registry.unknown(kind, name, known))


def kind_of(plugin: str) -> tuple[str, str]:
    """Kind and name of a plug-in given as NAME, or as KIND:NAME.

    Raises:
        UnknownPluginError: Nobody registered that name, or several kinds have it.
    """
    kind, _, name = plugin.partition(":")
    if name:
        require(kind, name)
        return kind, name
    kinds = [kind for kind in registry.GROUPS if plugin in registry.names(kind)]
    if len(kinds) == 1:
        return kinds[0], plugin
    if kinds:
        ways = " or ".join(f"{kind}:{plugin}" for kind in kinds)
        raise registry.UnknownPluginError(
            f"'{plugin}' is registered as {' and '.join(kinds)}. Ask for {ways}."
        )
    every = [name for kind in registry.GROUPS for name in registry.names(kind)]
    raise registry.UnknownPluginError(
        f"{registry.unknown('plug-in', plugin, every)} A class that is not registered yet is "
        "given as module:Class."
    )
