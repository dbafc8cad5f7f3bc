"""The store at 10,000 runs: what one more costs, and what looking at all of them costs."""

import dataclasses
import json
import os

import pytest
from outcomes import outcome

from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite
from bench.store.record import Outcome
from bench.store.store import Store

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
def store(planned, tmp_path_factory):
    """One is committed, the others have its files and a run.json of their own."""
    store = Store(tmp_path_factory.mktemp("results"))
    first, *others = planned[:N_RUNS]
    store.commit(first, outcome(first))
    folder = store.runs / first.name
    content = json.loads((folder / "run.json").read_text())
    for run in others:
        (store.runs / run.name).mkdir()
        for file in content["files"]:
            os.link(folder / file, store.runs / run.name / file)
        own = content | {"run": run.name, "key": run.key, "seed": run.seed}
        (store.runs / run.name / "run.json").write_text(json.dumps(own, indent=1))
    return store


def test_one_more_run_is_committed(benchmark, store, planned):
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
