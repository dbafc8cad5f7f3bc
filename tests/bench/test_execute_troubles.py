"""Executors that lose what they are given, and runs that may not be done here."""

import dataclasses
import io

import pytest
from at_once import AtOnce
from outcomes import FailingDisk
from rich.console import Console

from bench.execution.execute import Execution
from bench.execution.executor import Ended
from bench.execution.progress import SweepProgress
from bench.execution.worker import do_run
from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite
from bench.store.record import Outcome
from bench.store.store import Store


def test_a_full_disk_costs_the_runs_that_cannot_be_stored(plugins, tmp_path, monkeypatch):
    """Nothing can be stored, not even that they failed; the sweep ends and says so."""
    full = AtOnce(lambda slot, task: Ended(slot, error="[Errno 28] No space left on device"))
    runs = expand(Suite("test", "", ("spread",), (2,), 2, (Row("child"),))).runs
    store = Store(tmp_path, FailingDisk())
    console = Console(file=io.StringIO(), width=200)
    status = Execution(runs, store, full, SweepProgress(runs, console)).result()
    assert status == {run.name: "failed" for run in runs}
    assert store.names() == []
    text = console.file.getvalue()
    assert text.count("No space left on device; and this could not be stored: No space left") == 2
    assert text.count("failed; and this could not be stored") == 2  # the children


def test_what_failed_by_itself_stays_so_when_its_group_dies_later(plugins, tmp_path):
    """Its cause and traceback are kept, and it is not tried again unless asked for."""
    runs = expand(Suite("test", "", ("spread",), (2,), 3, (Row("failing"),))).runs
    runs = [run for run in runs if run.method == "failing"]
    store = Store(tmp_path)
    store.commit(runs[1], Outcome("failed", cause="from an earlier sweep"))

    def fail_and_die(slot, task):
        store.commit(runs[0], Outcome("failed", cause="the propellers fell off", details="why"))
        return Ended(slot, error="its worker process was ended by SIGKILL")

    display = SweepProgress(runs, Console(file=io.StringIO(), width=200))
    status = Execution(runs, store, AtOnce(fail_and_die), display, together=3).result()
    assert status == {run.name: "failed" for run in runs}
    found = [store.read(run.name) for run in runs]
    assert [content["interrupted"] for content in found] == [False, True, True]
    assert found[0]["cause"] == "the propellers fell off"
    assert (store.runs / runs[0].name / "traceback.txt").read_text() == "why"


def test_a_child_of_two_that_failed_earlier_fails_once(plugins, tmp_path, monkeypatch):
    *_, run = expand(Suite("test", "", ("spread",), (2,), 1, (Row("child"),))).runs
    child = dataclasses.replace(run, parents={"one": "one", "other": "other"})
    grand = dataclasses.replace(run, parents={"one": "one", "child": child.name}, seed=7)
    ended = []
    display = SweepProgress([child, grand], Console(quiet=True))
    monkeypatch.setattr(display, "finished", lambda run, *_: ended.append(run.name))
    store, failed = Store(tmp_path), ["one", "other"]
    status = Execution([child, grand], store, AtOnce(pytest.fail), display, failed=failed).result()
    assert status == {child.name: "failed", grand.name: "failed"}
    assert ended == [child.name, grand.name]
    assert store.read(child.name)["cause"] == "parent one failed"


def test_a_run_that_was_planned_for_another_device_is_not_done(plugins, tmp_path):
    (run,) = expand(Suite("test", "", ("spread",), (2,), 1, (Row("instant"),))).runs
    numerics = {**run.resolved["numerics"], "backend": "gpu"}
    other = dataclasses.replace(run, resolved={**run.resolved, "numerics": numerics})
    with pytest.raises(RuntimeError, match=r"planned for JAX on gpu, but on .* JAX uses cpu"):
        do_run(other, tmp_path, lambda *_: None)
