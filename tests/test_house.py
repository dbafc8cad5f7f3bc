"""Sizes of the house: folders that one can overlook, modules that one can read."""

import re
import statistics
from collections import Counter
from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[1]
PACKAGES = ("bench", "blind", "diagnosis", "methods", "simulators", "tasks")
MOST_MODULES = 12
"""Modules of a folder; `simulators/effects` has one for each effect."""
MOST_LINES = 400
"""Lines of a module, of tests too."""
MOST_PAIRS = 60
"""Pairs of wings of the harness of which one imports from the other."""
MEDIAN_LINES = 110
"""Lines of the median module of what we ship."""


def modules(*packages):
    return [path for package in packages for path in sorted((HOUSE / package).rglob("*.py"))]


@pytest.mark.parametrize("package", PACKAGES)
def test_no_folder_holds_more_modules_than_one_can_overlook(package):
    own = [path for path in modules(package) if path.name != "__init__.py"]
    assert own
    sizes = Counter(path.parent.relative_to(HOUSE).as_posix() for path in own)
    sizes.pop("simulators/effects", None)
    assert {folder: n for folder, n in sizes.items() if n > MOST_MODULES} == {}


@pytest.mark.parametrize("package", [*PACKAGES, "tests", "benchmarks"])
def test_no_module_is_longer_than_one_can_read(package):
    lengths = {
        path.relative_to(HOUSE).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for path in modules(package)
    }
    assert lengths
    assert {path: n for path, n in lengths.items() if n > MOST_LINES} == {}


def test_the_wings_of_the_harness_are_few_and_know_few_others():
    own = {path.name for path in (HOUSE / "bench").iterdir() if (path / "__init__.py").exists()}
    assert len(own) <= MOST_MODULES
    pairs = {
        (wing, other)
        for wing in own
        for path in modules(f"bench/{wing}")
        for other in re.findall(r"^\s*from bench\.(\w+)", path.read_text(encoding="utf-8"), re.M)
        if other in own - {wing}
    }
    assert pairs
    assert len(pairs) <= MOST_PAIRS


def test_half_of_all_modules_are_short():
    lengths = [len(path.read_text(encoding="utf-8").splitlines()) for path in modules(*PACKAGES)]
    assert statistics.median(lengths) <= MEDIAN_LINES
