"""Where a result comes from: commit, program, machine, device; written down with every run."""

import functools
import hashlib
import json
import platform
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import TypedDict

import jax

HOUSE = Path(__file__).parents[2]
"""Where the program lies."""
CODE = ("bench", "blind", "methods", "tasks", "simulators", "diagnosis")
"""Its folders, changes in which make a commit dirty."""


class Provenance(TypedDict):
    """Columns of the table `runs`; a text is empty where nothing is known."""

    commit: str
    """Commit of the program, from git."""
    dirty: bool
    """Whether its code had changes that are in no commit."""
    machine: str
    """Processor."""
    device: str
    """What JAX computed on."""


@functools.cache
def provenance() -> Provenance:
    """That of this process, as it is at the first call: when a sweep, or a worker, starts."""
    return _read()


def moved() -> str:
    """What has changed in the checkout since `provenance` was read, as a sentence; or nothing."""
    then, now = provenance(), _read()
    if then["commit"] != now["commit"]:
        what = f"moved from commit {then['commit'][:10]} to {now['commit'][:10]}"
    elif now["dirty"] and not then["dirty"]:
        what = "got changes that are in no commit"
    else:
        return ""
    return (
        f"the checkout {what} while the sweep ran. Each row names the commit that its worker "
        "started from."
    )


def _read() -> Provenance:
    changes = _git("status", "--porcelain", "--", *CODE)
    device = jax.devices()[0]
    return Provenance(
        commit=_git("rev-parse", "HEAD"),
        dirty=bool(changes),
        machine=processor(),
        device=f"{device.platform} {device.device_kind}",
    )


def digest(sources: Mapping[str, str]) -> str:
    """One hash of all code that a run's plug-ins run; comments and layout do not change it."""
    return hashlib.sha256(json.dumps(sorted(sources.items())).encode()).hexdigest()[:16]


def _git(*arguments: str) -> str:
    """What git says; empty where the program is not in a repository, or git is not there."""
    if not (HOUSE / ".git").exists():
        return ""
    try:
        said = subprocess.run(
            ["git", "-C", str(HOUSE), *arguments], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return said.stdout.strip()


def processor() -> str:
    """The processor's name with family and model, as far as the system tells.

    Virtual machines call different processors by one name. Two machines, both "AMD EPYC", gave
    settled rewards of -10.96 and -10.98 in 400 epochs of the LF baseline with one program. Family
    and model of the second were not kept, so nobody knows whether they would tell the two apart.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    pairs = [line.partition(":") for line in lines]
    said = {key.strip(): value.strip() for key, _, value in reversed(pairs)}  # the first processor
    name = said.get("model name", platform.machine())
    if "cpu family" not in said or "model" not in said:
        return name
    return f"{name} (family {said['cpu family']}, model {said['model']})"
