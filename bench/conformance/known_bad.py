"""Combinations of versions and settings that are known to break, and how each is mended."""

import dataclasses
from collections.abc import Mapping

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


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


def problems(facts: Facts) -> list[str]:
    """Everything that is known to break, one line each with its remedy."""
    return [*scipy_before_crazyflow(facts), *unmet_requirements(facts)]
