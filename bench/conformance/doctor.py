"""What this installation consists of and whether anything in it is known to break."""

import dataclasses
import importlib.metadata
import os
import platform
import re
import sys
from collections.abc import Iterable, Mapping

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.execution.executor import cores
from simulators import registry

OWN = "fidelity-bench"
"""Name of this distribution."""
OWNERS = (OWN, "crazyflow", "jax", "mujoco-mjx")
"""Distributions whose requirements are compared with what is installed."""
OF_DEVELOPERS = {"dev", "docs"}
"""Extras that no command needs."""
VARIABLES = (
    "JAX_PLATFORMS",
    "JAX_ENABLE_X64",
    "XLA_FLAGS",
    "SCIPY_ARRAY_API",
    "RAY_ADDRESS",
)
"""Variables of the environment that change what happens."""


@dataclasses.dataclass(frozen=True)
class Facts:
    """What an installation consists of, as far as `problems` looks at it."""

    versions: Mapping[str, str]
    """Installed packages and their versions."""
    requirements: Mapping[str, tuple[str, ...]]
    """What installed packages say that they need, by package."""
    variables: Mapping[str, str]
    """Environment of the process."""
    modules: frozenset[str]
    """What was imported before this program imported anything heavy."""


def doctor() -> int:
    """Prints everything; exit status 1 if a problem was found."""
    facts = gather()
    console = Console()
    _show(console, "Machine", machine())
    _show(console, "Packages", [(name, facts.versions[name]) for name in _named(facts)])
    optional = {name: extra for name, extra in brought(facts).items() if extra}
    absent = [(n, f"extra {x}") for n, x in optional.items() if n not in facts.versions]
    if absent:
        _show(console, "Not installed, not needed", absent)
    variables = [(name, facts.variables[name]) for name in VARIABLES if name in facts.variables]
    if variables:
        _show(console, "Environment", variables)
    found = problems(facts)
    _show(console, "Plug-ins", plugin_lines(found))
    _show(console, "Devices", device_lines(found))
    for line in found:
        console.print(Text(f"Problem: {line}", "bold red"), soft_wrap=True)
    if not found:
        console.print("No problem found.")
    return 1 if found else 0


def gather() -> Facts:
    """The facts of this process and its installation."""
    modules = frozenset(sys.modules)
    versions: dict[str, str] = {
        canonicalize_name(dist.metadata["Name"]): dist.version
        for dist in importlib.metadata.distributions()
        if dist.metadata["Name"]
    }
    requirements = {
        owner: tuple(importlib.metadata.requires(owner) or ())
        for owner in OWNERS
        if owner in versions
    }
    return Facts(versions, requirements, dict(os.environ), modules)


def problems(facts: Facts) -> list[str]:
    """Everything that is known to break, one line each with its remedy."""
    return [*scipy_before_crazyflow(facts), *unmet_requirements(facts)]


def unmet_requirements(facts: Facts) -> list[str]:
    """A line for each package that is missing or has a version that another one refuses."""
    found = []
    for owner, texts in facts.requirements.items():
        for requirement in map(Requirement, texts):
            if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
                continue
            version = facts.versions.get(canonicalize_name(requirement.name))
            needed = f"{owner} needs {requirement.name}{requirement.specifier}"
            if version is None:
                found.append(f"{needed}, which is not installed. Install it with pip.")
            elif not requirement.specifier.contains(version, prereleases=True):
                found.append(
                    f"{needed}, but {version} is installed. "
                    f"Run: pip install '{requirement.name}{requirement.specifier}'"
                )
    return found


def scipy_before_crazyflow(facts: Facts) -> list[str]:
    """Crazyflow must set SCIPY_ARRAY_API before SciPy is imported."""
    value = facts.variables.get("SCIPY_ARRAY_API")
    if value == "1":
        return []
    if "scipy" in facts.modules:
        return [
            "SciPy was imported before crazyflow (by a .pth file or sitecustomize, if not by you), "
            "which crazyflow refuses. Set SCIPY_ARRAY_API=1."
        ]
    if value is not None:
        return [
            f"SCIPY_ARRAY_API is '{value}', and crazyflow refuses to be imported after a SciPy "
            "that was. Set SCIPY_ARRAY_API=1 or unset it."
        ]
    return []


def machine() -> list[tuple[str, str]]:
    """Python, system, cores and memory."""
    found = [
        ("python", f"{platform.python_version()} ({sys.executable})"),
        ("system", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("cores", str(cores())),
    ]
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        found.append(("memory", f"{size / 2**30:.1f} GiB"))
    return found


def plugin_lines(found: list[str]) -> list[tuple[str, str]]:
    """How many plug-ins of each kind can be imported; what cannot is added to `found`."""
    lines = []
    for kind in registry.GROUPS:
        names, broken = registry.names(kind), 0
        for name in names:
            try:
                registry.load(kind, name)
            except registry.BrokenPluginError as error:
                broken += 1
                found.append(" ".join(str(error).split()))
        lines.append(
            (f"{kind}s", f"{len(names)}, of which {broken} broken" * bool(names) or "none")
        )
    return lines


def device_lines(found: list[str]) -> list[tuple[str, str]]:
    """What JAX computes on; a JAX that finds nothing is added to `found`."""
    try:
        import jax

        devices = jax.devices()
    except Exception as error:
        found.append(f"JAX finds no device: {' '.join(str(error).split())}")
        return [("jax", "none")]
    return [(f"{device.platform} {device.id}", device.device_kind) for device in devices]


def brought(facts: Facts) -> dict[str, str]:
    """The extra with which each package comes that commands use; empty for what always does."""
    found: dict[str, str] = {}
    for requirement in map(Requirement, facts.requirements.get(OWN, ())):
        extra = re.search(r"extra == .(\w+)", str(requirement.marker or ""))
        if extra is None or extra[1] not in OF_DEVELOPERS:
            found.setdefault(canonicalize_name(requirement.name), extra[1] if extra else "")
    return found


def _named(facts: Facts) -> list[str]:
    """Packages worth showing: what we need ourselves, jaxlib, and what is optional."""
    return sorted({OWN, "jaxlib", *brought(facts)} & set(facts.versions))


def _show(console: Console, title: str, lines: Iterable[tuple[str, str]]) -> None:
    table = Table(title=title, title_justify="left", title_style="bold", box=None)
    table.show_header = False
    table.add_column(min_width=14)
    table.add_column(overflow="fold")
    for name, value in lines:
        table.add_row(Text(name), Text(value))
    console.print(table)
