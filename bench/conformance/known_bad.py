"""Combinations of versions and settings that are known to break, and how each is mended."""

import dataclasses
from collections.abc import Callable, Mapping

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version


@dataclasses.dataclass(frozen=True)
class Facts:
    """What an installation consists of, as far as the rules look at it."""

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


def jax_that_crazyflow_refuses(facts: Facts) -> list[str]:
    """Crazyflow 0.4.0 excludes this one release in its own requirements."""
    if "crazyflow" in facts.versions and facts.versions.get("jax") == "0.10.2":
        return ["jax 0.10.2 does not work with crazyflow. Run: pip install 'jax!=0.10.2'"]
    return []


def mujoco_of_two_lines(facts: Facts) -> list[str]:
    """mujoco-mjx states no upper bound on mujoco, so pip mixes release lines."""
    own, mjx = (facts.versions.get(name) for name in ("mujoco", "mujoco-mjx"))
    if own and mjx and Version(own).release[:2] != Version(mjx).release[:2]:
        return [
            f"mujoco {own} and mujoco-mjx {mjx} are of different release lines. "
            f"Run: pip install mujoco=={own} mujoco-mjx=={own}"
        ]
    return []


def jaxlib_beyond_jax(facts: Facts) -> list[str]:
    """A jaxlib newer than its jax is untested by their makers."""
    jax, jaxlib = (facts.versions.get(name) for name in ("jax", "jaxlib"))
    if jax and jaxlib and Version(jaxlib) > Version(jax):
        return [f"jaxlib {jaxlib} is newer than jax {jax}. Run: pip install jaxlib=={jax}"]
    return []


def rliable_with_pandas_3(facts: Facts) -> list[str]:
    """Rliable 1.2 uses what pandas 3 has removed."""
    pandas = facts.versions.get("pandas")
    if "rliable" in facts.versions and pandas and Version(pandas) >= Version("3"):
        return [
            f"rliable {facts.versions['rliable']} breaks with pandas {pandas}. It is not needed "
            "here; run: pip uninstall rliable"
        ]
    return []


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


RULES: tuple[Callable[[Facts], list[str]], ...] = (
    jax_that_crazyflow_refuses,
    mujoco_of_two_lines,
    jaxlib_beyond_jax,
    rliable_with_pandas_3,
    scipy_before_crazyflow,
    unmet_requirements,
)
"""Each returns a line for each problem that it finds."""


def problems(facts: Facts) -> list[str]:
    """Everything that is known to break, one line each with its remedy."""
    return [line for rule in RULES for line in rule(facts)]
