"""`python -m tests.mutation`: which mutants of the store, the statistics and the meter survive.

A sample of all mutants of these modules is drawn with `--seed`; the test files of a mutant's module
run once for each, until the first failure. A mutant survives if all pass: then no test notices that
change. Some survivors behave as the module does and cannot be killed.

Every mutant has a process of its own, forked from one that has imported the libraries. Tests that
start processes see the module as it is on the disk.
"""

import argparse
import importlib
import importlib.machinery
import os
import random
import resource
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.mutation.mutants import Mutant, mutants

ROOT = Path(__file__).parents[2]
LIBRARIES = (
    "beartype",
    "crazyflow",
    "equinox",
    "hypothesis",
    "jax",
    "matplotlib.pyplot",
    "networkx",
    "optax",
    "pandas",
    "pandera.pandas",
    "pyarrow.parquet",
    "pydantic",
    "pytest",
    "rich.progress",
    "scipy.stats",
)
"""Imported before the first fork; none of them starts a thread."""
TESTED: dict[str, tuple[str, ...]] = {
    "bench/store/kept.py": ("test_kept_rows", "test_restoring", "test_policies"),
    "bench/store/missing.py": ("test_outlook", "test_lost_parents"),
    "bench/store/record.py": ("test_record", "test_store", "test_structure"),
    "bench/store/resume.py": ("test_store", "test_lost_parents", "test_kept_rows"),
    "bench/store/store.py": ("test_store", "test_policies", "test_execute"),
    "bench/store/tables.py": ("test_merging", "test_store", "test_kept_rows"),
    "bench/stats/against.py": ("test_against",),
    "bench/stats/bootstrap.py": ("test_bootstrap",),
    "bench/stats/compare.py": ("test_compare",),
    "bench/stats/forecast.py": ("test_outlook",),
    "bench/stats/pooled.py": ("test_pooled", "test_compare"),
    "bench/stats/ranking.py": ("test_ranking",),
    "bench/stats/scores.py": ("test_pooled", "test_compare"),
    "bench/stats/statistics.py": ("test_statistics", "test_verdicts"),
    "bench/stats/verdicts.py": ("test_verdicts",),
    "methods/running/metered.py": ("test_meter",),
    "methods/training/meter.py": ("test_meter",),
}
"""Test files of each module, in the tests' folder of its wing."""
SLOWEST_S = 300
"""Processor time [s] after which a mutant counts as noticed: it loops."""


def main() -> int:
    """Exit status: 0, or 1 if the tests fail without a mutant."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m tests.mutation")
    parser.add_argument("--sample", type=int, default=60, help="how many mutants")
    parser.add_argument("--seed", type=int, default=0, help="which ones")
    parser.add_argument("--only", default="", help="modules whose path holds this")
    asked = parser.parse_args()
    os.environ |= {"JAX_PLATFORMS": "cpu", "SCIPY_ARRAY_API": "1", "MPLBACKEND": "agg"}
    for name in LIBRARIES:
        importlib.import_module(name)
    modules = [name for name in TESTED if asked.only in name]
    every = [(name, m) for name in modules for m in mutants((ROOT / name).read_text())]
    drawn = random.Random(asked.seed).sample(every, min(asked.sample, len(every)))
    drawn.sort(key=lambda pair: modules.index(pair[0]))
    survivors = 0
    for place, (name, mutant) in enumerate(drawn):
        if (place == 0 or drawn[place - 1][0] != name) and not _passes(name, None):
            print(f"The tests of {name} fail without a mutant.", flush=True)  # noqa: T201
            return 1
        survived = _passes(name, mutant)
        survivors += survived
        word = "SURVIVED" if survived else "noticed "
        line = f"{word} {name}:{mutant.line}: {mutant.was} -> {mutant.became}"
        print(" ".join(line.split()), flush=True)  # noqa: T201
    print(f"{len(drawn) - survivors} of {len(drawn)} mutants were noticed.")  # noqa: T201
    return 0


def _passes(name: str, mutant: Mutant | None) -> bool:
    """Whether the module's tests pass, in a fork, with a mutant in the module's place."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1] == 0
    code = 1
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (SLOWEST_S, SLOWEST_S))
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        if mutant is not None:
            _replace(ROOT / name, mutant.source)
        code = _tested(TESTED[name], "methods" if name.startswith("methods/") else "bench")
    finally:
        os._exit(code)


def _tested(files: Sequence[str], folder: str) -> int:
    """Exit status of pytest."""
    import pytest

    paths = [str(ROOT / "tests" / folder / f"{file}.py") for file in files]
    left_out = [f"-pno:{plugin}" for plugin in ("cacheprovider", "benchmark", "xdist")]
    options = ["-x", "-q", "--assert=plain", "-m", "not exhaustive"]
    return int(pytest.main([*left_out, *options, *paths]))


def _replace(path: Path, source: str) -> None:
    """From now on, what Python imports from `path` is `source`, compiled anew."""
    loader = importlib.machinery.SourceFileLoader
    get_data, path_stats = loader.get_data, loader.path_stats

    def mutated(self: importlib.machinery.SourceFileLoader, where: str) -> bytes:
        return source.encode() if Path(where) == path else get_data(self, where)

    def stats(self: importlib.machinery.SourceFileLoader, where: str) -> dict:
        if Path(where) == path:
            raise OSError("No time of change: compiled code of this module is not used.")
        return dict(path_stats(self, where))

    loader.get_data, loader.path_stats = mutated, stats


if __name__ == "__main__":
    sys.exit(main())
