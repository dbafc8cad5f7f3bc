"""Draws and flies the cases of a blind run, in a process of its own that leaves nothing behind.

`python -m blind.run.generate` takes its settings as one JSON object; with none but `out`, it
flies what is gone of a draw that is there.
"""

import datetime
import json
import secrets
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from blind.draw.cases import (
    Case,
    draw_cases,
    read_labels,
    reference_sets_in,
    undisturbed_case,
    write_case,
    write_labels,
    write_undisturbed,
)
from blind.draw.folders import Folders, write_json
from blind.run.answering import sources_digest
from blind.run.children import leave_with_parent

PACKAGES = ("fidelity-bench", "crazyflow", "rotorpy", "jax", "numpy", "scipy")
"""Packages whose versions are written down."""


def generate(
    folders: Folders, reality: str, counts: Mapping[str, int], seed: int | None, undisturbed: int
) -> None:
    """Writes cases, labels and undisturbed flight sets, and `run.json` last.

    Args:
        folders: Where to; nothing may be there yet.
        reality: Where cases are flown.
        counts: Number of cases by kind.
        seed: Seed of everything but the labels' salt; from the operating system if None.
        undisturbed: Number of flight sets on which baselines are calibrated.
    """
    entropy = secrets.randbits(128) if seed is None else seed
    _fly_undisturbed(folders, reality, entropy, undisturbed)
    cases = draw_cases(counts, reality, entropy)
    for case in cases:
        write_case(folders.cases, folders.labels.parent, case)
    sha256 = write_labels(folders.labels, cases)
    write_json(
        folders.state,
        {
            "reality": reality,
            "counts": dict(counts),
            "seed": seed,
            "entropy": entropy,
            "undisturbed": undisturbed,
            "sha256": sha256,
            "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "versions": {name: _version(name) for name in PACKAGES},
            "generator": sources_digest(with_generator=True),
        },
    )


def fly_again(folders: Folders) -> None:
    """Flies what is gone of a draw whose `run.json` and labels are there."""
    state = folders.read_state()
    _fly_undisturbed(folders, state["reality"], state["entropy"], state["undisturbed"])
    for case in read_labels(folders.labels, Case.of, state["sha256"]).values():
        write_case(folders.cases, folders.labels.parent, case)


def _fly_undisturbed(folders: Folders, reality: str, entropy: int, count: int) -> None:
    """Flies references, and `count` sets to calibrate baselines on, that are not there."""
    own, others = np.random.default_rng([entropy, 1]), np.random.default_rng([entropy, 2])
    wanted = [(folders.reference, own)]
    wanted += [(folders.undisturbed / str(i), own) for i in range(1, count + 1)]
    wanted += [(folders.references / str(i), others) for i in range(reference_sets_in(reality))]
    for folder, rng in wanted:
        write_undisturbed(folder, undisturbed_case(reality, rng))


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


if __name__ == "__main__":
    leave_with_parent()
    settings = json.loads(sys.argv[1])
    place = Folders(Path(settings.pop("out")))
    if settings:
        generate(place, **settings)
    else:
        fly_again(place)
