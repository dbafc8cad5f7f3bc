import errno
import json
import os
import signal
import subprocess
import sys
import textwrap

import filelock
import jax
import numpy as np
import pandas as pd
import pytest
from outcomes import FailingDisk, make_template, outcome, plan

from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite
from bench.store.record import Outcome, UnreadableRunError
from bench.store.resume import make_standing, stale_lines
from bench.store.store import ClaimedError, Store
from bench.store.tables import TableError, Tables
from tasks.spread import Spread


@pytest.fixture
def planned(plugins):
    return plan().runs


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "results")


def test_what_is_restored_is_what_was_stored(store, planned):
    run = planned[0]
    stored = outcome(run)
    store.commit(run, stored)
    restored = store.trained(run.name, make_template())
    assert restored.ledger == stored.trained.ledger
    assert restored.status == "budget"
    assert restored.notes["fit"] == 0.5
    assert np.isnan(restored.notes["unknown"])
    np.testing.assert_array_equal(restored.curves["reward"], stored.trained.curves["reward"])
    obs = jax.random.normal(jax.random.key(3), (2, Spread(n_drones=2).obs_size))
    np.testing.assert_array_equal(restored.policy(obs), stored.trained.policy(obs))
    assert not np.allclose(restored.policy(obs), make_template()(obs))


def test_nothing_in_a_folder_is_pickled(store, planned):
    store.commit(planned[0], outcome(planned[0]))
    folder = store.runs / planned[0].name
    assert {path.suffix for path in folder.iterdir()} == {".json", ".npz", ".parquet"}
    with np.load(folder / "policy.npz", allow_pickle=False) as arrays:
        assert len(arrays.files) == 6
    content = json.loads((folder / "run.json").read_text())
    assert content["resolved"]["settings"]["inner"] == {"epochs": 3, "lr": 0.5}
    assert content["key"] == planned[0].key


def test_a_policy_of_another_shape_is_refused(store, planned):
    store.commit(planned[0], outcome(planned[0]))
    with pytest.raises(UnreadableRunError, match="does not fit its run"):
        store.trained(planned[0].name, make_template(n_neighbors=1))


def test_a_failed_run_has_no_policy_and_can_be_replaced(store, planned):
    run = planned[0]
    store.commit(run, Outcome("failed", cause="bad luck", details="Traceback"))
    assert store.read(run.name)["cause"] == "bad luck"
    with pytest.raises(UnreadableRunError, match="failed: bad luck"):
        store.trained(run.name, make_template())
    store.commit(run, outcome(run))
    assert store.read(run.name)["status"] == "budget"
    assert store.names() == [run.name]
    assert not list(store.runs.glob(".part-*"))


def test_a_finished_run_is_never_replaced(store, planned):
    run = planned[0]
    assert store.commit(run, outcome(run, reward=-1.0))
    before = {path.name: path.read_bytes() for path in (store.runs / run.name).iterdir()}
    assert not store.commit(run, outcome(run, reward=-2.0))
    assert not store.commit(run, Outcome("failed", cause="too late"))
    assert before == {path.name: path.read_bytes() for path in (store.runs / run.name).iterdir()}


KILLED_EVERYWHERE = """
    import os, sys
    from pathlib import Path
    import bench.store.store as module
    from outcomes import MortalDisk, outcome, plan

    runs = plan().runs
    outcomes = {run.name: outcome(run) for run in runs}
    files = {id(o): module.run_files(o) for o in outcomes.values()}
    module.run_files = lambda o: files.get(id(o), {})  # nothing but the disk after the fork

    def work(directory, left):
        store = module.Store(directory, MortalDisk(left))
        store.tidy()
        if store.status(runs[0].name) == "":
            store.commit(runs[0], module.Outcome("failed", cause="first attempt"))
        for run in runs:
            store.commit(run, outcomes[run.name])

    def child(directory, left):
        if (pid := os.fork()) == 0:
            work(directory, left)
            os._exit(0)
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])

    point, statuses = 0, None
    while statuses != [0, 0]:
        directory = Path(sys.argv[1]) / f"{point:03d}"
        statuses = [child(directory, point) for _ in range(2)]
        assert set(statuses) <= {0, -9}, statuses
        names = module.Store(directory).names()
        for name in names:
            module.Store(directory).read(name)  # nothing half-written has the name of a run
        assert child(directory, 10**9) == 0
        point += 1
    print(point)
"""


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_kills_at_every_point_of_a_commit_twice_in_a_row_change_nothing(store, planned, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(KILLED_EVERYWHERE), str(tmp_path)],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    n_points = int(done.stdout)
    assert n_points > 40
    for run in planned:
        store.commit(run, outcome(run))
    uninterrupted = store.tables(store.sound(pytest.fail), ())
    for point in range(n_points):
        survivor = Store(tmp_path / f"{point:03d}")
        survivor.tidy()
        assert {path.name for path in survivor.runs.iterdir()} == {run.name for run in planned}
        tables = survivor.tables(survivor.sound(pytest.fail), ())
        for name in ("results", "curves", "trajectories"):
            pd.testing.assert_frame_equal(getattr(tables, name), getattr(uninterrupted, name))
        runs = (t.runs.drop(columns="committed") for t in (tables, uninterrupted))
        pd.testing.assert_frame_equal(*runs)  # but for when they were


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EIO])
@pytest.mark.parametrize("file", ["policy.npz", "run.json"])
def test_a_disk_that_fails_leaves_the_store_as_it_was(store, planned, code, file):
    first, second = planned
    store.commit(first, outcome(first))
    failing = Store(store.directory, FailingDisk(code, lambda path: path.name == file))
    with pytest.raises(OSError, match=os.strerror(code)):
        failing.commit(second, outcome(second))
    assert store.names() == [first.name]
    assert not list(store.runs.glob(".part-*"))
    assert list(store.sound(pytest.fail)) == [first.name]
    store.commit(second, outcome(second))
    assert store.names() == sorted([first.name, second.name])


def test_a_damaged_run_in_a_read_only_store_is_left_out_where_it_is(store, planned):
    good, bad = planned
    for run in planned:
        store.commit(run, outcome(run))
    os.truncate(store.runs / bad.name / "policy.npz", 10)
    warnings = []
    sound = Store(store.directory, FailingDisk(errno.EROFS)).sound(warnings.append)
    assert list(sound) == [good.name]
    assert "It stays where it is: Read-only file system." in warnings[0]
    assert set(store.tables(sound, ()).results["run"]) == {good.name}


def test_what_killed_processes_left_is_removed(store, planned):
    run = planned[0]
    store.commit(run, outcome(run))
    left = store.runs / ".part-x"
    left.mkdir()
    (left / "policy.npz").write_bytes(b"half")
    (store.runs / ".part-file").write_bytes(b"")
    for name in (run.name, planned[1].name):
        (store.runs / ".checkpoints" / name).mkdir(parents=True)
    store.tidy()
    assert {p.name for p in store.runs.iterdir()} == {run.name, ".checkpoints"}
    # What has not ended yet goes on from its checkpoint.
    assert [p.name for p in (store.runs / ".checkpoints").iterdir()] == [planned[1].name]


def test_a_stale_lock_and_a_stale_claim_hold_nobody_up(store, planned):
    """They are files whose process is gone; the system has let go of its locks."""
    script = f"""
        import os, signal
        from bench.store.store import Store
        store = Store({str(store.directory)!r})
        with store.lock(lambda: None), store.claim("x"):
            os.kill(os.getpid(), signal.SIGKILL)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert (store.runs / ".lock").exists()
    assert (store.runs / ".claims" / "x.lock").exists()
    with store.lock(pytest.fail), store.claim("x", longest=0.0):
        pass
    assert not (store.runs / ".claims" / "x.lock").exists()


def test_a_run_that_another_process_is_at_is_not_started(store):
    with store.claim("x"):
        with pytest.raises(
            ClaimedError, match="another process has been training this run for 0 s"
        ):
            store.claim("x", longest=0.0).__enter__()
        with store.claim("y", longest=0.0):
            pass
    with store.claim("x", longest=0.0):
        pass


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda folder: os.truncate(folder / "policy.npz", 100), "policy.npz has changed"),
        (lambda folder: (folder / "metrics.json").unlink(), "metrics.json: No such file"),
        (lambda folder: (folder / "run.json").write_text("{"), "run.json does not describe a run"),
        (lambda folder: (folder / "run.json").write_bytes(b"\xff"), "run.json is not text"),
        (lambda folder: (folder / "run.json").unlink(), "run.json: No such file"),
        (lambda folder: (folder / "run.json").write_text("[]"), "run.json does not describe a run"),
    ],
)
def test_a_damaged_run_is_put_in_quarantine_with_its_reason(store, planned, damage, reason):
    good, bad = planned
    for run in planned:
        store.commit(run, outcome(run))
    damage(store.runs / bad.name)
    warnings = []
    assert list(store.sound(warnings.append)) == [good.name]
    assert len(warnings) == 1
    assert bad.name in warnings[0]
    assert reason in warnings[0]
    kept, why = sorted((store.runs / ".quarantine").iterdir())
    assert kept.name.startswith(bad.name)
    assert why.name == f"{kept.name}.reason.txt"
    assert reason in why.read_text()
    assert store.names() == [good.name]
    assert set(store.tables(store.sound(pytest.fail), ()).results["run"]) == {good.name}


def test_a_run_in_the_folder_of_another_is_damaged(store, planned):
    first, second = planned
    store.commit(first, outcome(first))
    (store.runs / first.name).rename(store.runs / second.name)
    with pytest.raises(UnreadableRunError, match=r"run\.json belongs to the run"):
        store.read(second.name)


def test_tables_have_a_row_per_metric_and_one_per_run(store, planned):
    first, second = planned
    store.commit(first, outcome(first))
    store.commit(second, Outcome("failed", cause="bad luck"))
    tables = store.tables(store.sound(pytest.fail), {run.name for run in planned})
    rows = tables.results.set_index("metric")
    assert rows.loc["reward", ["run", "value", "unit", "simulator", "status"]].tolist() == [
        first.name,
        -3.0,
        "1",
        "crazyflow",
        "budget",
    ]
    assert np.isnan(rows.loc["lf_reward", "value"])
    assert set(tables.results["calibration_flights"]) == {7}
    causes = tables.runs.set_index("run")["cause"].to_dict()
    assert causes == {first.name: "", second.name: "bad luck"}
    assert len(tables.curves) == 2
    assert len(tables.trajectories) == 1


def test_of_two_runs_of_one_thing_the_current_one_counts(store, planned, monkeypatch):
    old = planned[0]
    store.commit(old, outcome(old, reward=-1.0))
    import fakes

    monkeypatch.setattr(fakes.Instant, "version", "2")
    new = expand(Suite("test", "", ("spread",), (2,), 1, (Row("instant"),))).runs[0]
    store.commit(new, outcome(new, reward=-2.0))
    sound = store.sound(pytest.fail)
    assert set(sound) == {old.name, new.name}
    assert set(store.tables(sound, set()).results["run"]) == {new.name}
    assert set(store.tables(sound, {old.name}).results["run"]) == {old.name}


def test_tables_survive_a_round_trip(store, planned, tmp_path):
    store.commit(planned[0], outcome(planned[0]))
    tables = store.tables(store.sound(pytest.fail), ())
    tables.save(tmp_path / "tables")
    loaded = Tables.load(tmp_path / "tables")
    for name in ("results", "curves", "trajectories", "runs"):
        pd.testing.assert_frame_equal(getattr(loaded, name), getattr(tables, name))
    assert {path.suffix for path in (tmp_path / "tables").iterdir()} == {".parquet"}


def test_a_folder_without_tables_or_with_others_is_refused(store, planned, tmp_path):
    with pytest.raises(TableError, match=r"holds no results\.parquet"):
        Tables.load(tmp_path)
    store.commit(planned[0], outcome(planned[0]))
    store.tables(store.sound(pytest.fail), ()).save(tmp_path)
    curves = pd.read_parquet(tmp_path / "curves.parquet")
    curves.drop(columns="reward").to_parquet(tmp_path / "curves.parquet")
    with pytest.raises(TableError, match=r"curves\.parquet cannot be used: .*reward"):
        Tables.load(tmp_path)
    curves.assign(more=1.0).to_parquet(tmp_path / "curves.parquet")
    with pytest.raises(TableError, match=r"curves\.parquet cannot be used: .*more"):
        Tables.load(tmp_path)


def test_a_second_sweep_waits_for_the_first(store):
    waited = []
    with store.lock(lambda: waited.append("first")):
        other = filelock.FileLock(store.runs / ".lock", is_singleton=False)
        with pytest.raises(filelock.Timeout):
            other.acquire(timeout=0)
    assert waited == []
    with other:
        waits = store.lock(lambda: (waited.append("second"), other.release()))
        with waits:
            pass
    assert waited == ["second"]
    other.acquire(timeout=0)  # free again, and not only once `waits` is collected


def test_failed_runs_are_tried_again_if_asked_for_and_interrupted_ones_always(store, plugins):
    planned = plan(seeds=4)
    fine, failed, interrupted, missing = planned.runs
    store.commit(fine, outcome(fine))
    store.commit(failed, Outcome("failed", cause="bad luck"))
    store.commit(interrupted, Outcome("failed", cause="killed", interrupted=True))
    sound = store.sound(pytest.fail)
    standing = make_standing(planned, sound, Tables.empty(), retry_failed=False)
    assert standing.done == [fine]
    assert standing.failed == [failed]
    assert standing.missing == [interrupted, missing]
    again = make_standing(planned, sound, Tables.empty(), retry_failed=True)
    assert again.missing == planned.runs[1:]


def test_a_changed_source_under_an_unchanged_version_is_named(store, planned, monkeypatch):
    for run in planned:
        store.commit(run, outcome(run))
    sound = store.sound(pytest.fail)
    tables = store.tables(sound, ())
    assert stale_lines(planned, tables, sound) == []
    assert stale_lines(planned, tables, {}) == []  # nor by the rows, where folders are gone
    import bench.plan.expansion

    monkeypatch.setattr(bench.plan.expansion, "own_source", lambda cls: cls.__name__)
    monkeypatch.setattr(
        bench.plan.expansion, "shared_sources", lambda classes: {"tasks.contract": "new"}
    )
    (line,) = stale_lines(plan().runs, tables, {})
    assert line == "2 rows were made by other source code under the same versions."
    lines = stale_lines(plan().runs, tables, sound)
    plug_ins, modules = lines
    assert plug_ins.startswith("the source of evaluation, method instant, simulator crazyflow, ")
    assert "has changed, but no `version` has; used as they are: 2 stored runs. C" in plug_ins
    assert modules.startswith("the source of module tasks.contract has changed, which no version")
    names = {f"module tasks.m{i}": "new" for i in range(9)}
    old = {name: {"sources": dict.fromkeys(names, "old")} for name in sound}
    monkeypatch.setattr(
        bench.plan.expansion,
        "shared_sources",
        lambda classes: {name.removeprefix("module "): "new" for name in names},
    )
    (line,) = stale_lines(plan().runs, tables, old)
    assert "tasks.m5 and 3 more has changed, which" in line
    assert "tasks.m6" not in line


def test_the_sources_of_a_run_are_those_of_all_that_it_imports(planned):
    sources = planned[0].sources
    assert {"module tasks.contract", "module simulators.flight"} <= set(sources)
    assert not any(name.startswith("module bench") for name in sources)
