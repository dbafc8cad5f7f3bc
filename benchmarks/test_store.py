"""The store at 10,000 runs: what one more costs, and what looking at all of them costs."""

import dataclasses
import json
import sys
from pathlib import Path

import pytest

from bench.plan import expand
from bench.record import Outcome
from bench.store import Store
from bench.suite import Row, Suite

N_RUNS = 10_000


@pytest.fixture(scope="module")
def planned():
    rows = (Row("lf_baseline"),)
    first = expand(Suite("benchmark", "", ("spread",), (2,), 1, rows)).runs[0]
    return [
        dataclasses.replace(first, seed=seed, resolved={**first.resolved, "seed": seed})
        for seed in range(N_RUNS + 100)
    ]


@pytest.fixture(scope="module")
def outcome():
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "bench"))
    import outcomes

    return outcomes.outcome


@pytest.fixture(scope="module")
def store(planned, outcome, tmp_path_factory):
    """Committed without waiting for the disk, but for that the same."""
    from bench.disk import Disk

    class Hasty(Disk):
        def write(self, path, content):
            path.write_bytes(content)

        def flush_folder(self, path):
            pass

    directory = tmp_path_factory.mktemp("results")
    ended = outcome(planned[0])
    hasty = Store(directory, Hasty())
    for run in planned[:N_RUNS]:
        hasty.commit(run, ended)
    return Store(directory)


def test_one_more_run_is_committed(benchmark, store, planned, outcome):
    ended = outcome(planned[0])
    more = iter(planned[N_RUNS:])
    assert benchmark.pedantic(lambda: store.commit(next(more), ended), rounds=20)


def test_all_runs_are_scanned(benchmark, store):
    sound = benchmark.pedantic(lambda: store.sound(pytest.fail), rounds=1)
    assert len(sound) >= N_RUNS


def test_a_failed_run_is_committed(benchmark, store, planned):
    more = iter(planned[N_RUNS + 50 :])
    failed = Outcome("failed", cause="bad luck", details="Traceback")
    assert benchmark.pedantic(lambda: store.commit(next(more), failed), rounds=20)
    content = json.loads((store.runs / planned[N_RUNS + 50].name / "run.json").read_text())
    assert content["status"] == "failed"
