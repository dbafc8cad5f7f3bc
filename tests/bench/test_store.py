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

from bench.plan import expand
from bench.store import Outcome, Store, UnreadableRunError
from bench.suite import Row, Suite
from bench.tables import TableError, Tables, table
from methods.contract import Ledger, Trained
from methods.policy import make_policy
from simulators.point_mass import PointMass
from tasks.spread import Spread


@pytest.fixture
def planned(plugins):
    suite = Suite("test", "", ("spread",), (2,), 2, (Row("instant"),))
    return expand(suite).runs


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "results")


def make_template(seed=0, n_neighbors=3):
    simulator = PointMass()
    task = Spread(n_drones=2, n_neighbors=n_neighbors)
    return make_policy(task, simulator.spec, simulator.action_space, jax.random.key(seed))


def outcome(run, reward=-3.0):
    column = np.asarray([-5.0, -4.0], np.float32)
    names = ("reward", "smooth_reward", "crashes", "grad_norm")
    trained = Trained(
        policy=make_template(seed=1),
        ledger=Ledger(hf_fleet_seconds=90.0, epochs=2, calibration_flights=7),
        curves=dict.fromkeys(names, column),
        status="budget",
        notes={"fit": 0.5, "unknown": float("nan")},
    )
    return Outcome(
        status="budget",
        trained=trained,
        metrics={"reward": reward, "lf_reward": float("nan")},
        curves=table("curves", pd.DataFrame({"run": run.name, "epoch": [0, 1]} | trained.curves)),
        trajectory=table(
            "trajectories",
            [{"run": run.name, "drone": 0, "t": 0.1, "pos_x": 1.0, "pos_y": 2.0, "pos_z": 3.0}],
        ),
    )


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
    with pytest.raises(UnreadableRunError, match="is not the shared policy of its task"):
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


@pytest.mark.parametrize("moment", ["_write_json", "_flush"])
def test_a_kill_in_the_middle_of_a_commit_leaves_nothing_half(store, planned, moment, monkeypatch):
    run = planned[0]
    script = f"""
        import os, signal
        import bench.store as module
        from bench.plan import expand
        from bench.suite import Row, Suite
        module.{moment} = lambda *a: os.kill(os.getpid(), signal.SIGKILL)
        run, _ = expand(Suite("test", "", ("spread",), (2,), 2, (Row("instant"),))).runs
        failed = module.Outcome("failed", "killed", "Traceback")
        module.Store({str(store.directory)!r}).commit(run, failed)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert store.names() == []
    assert len(list(store.runs.glob(".part-*"))) == 1
    store.tidy()
    assert list(store.runs.iterdir()) == []
    store.commit(run, outcome(run))
    assert store.names() == [run.name]


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda folder: os.truncate(folder / "policy.npz", 100), "policy.npz is not as"),
        (lambda folder: (folder / "metrics.json").unlink(), "metrics.json: No such file"),
        (lambda folder: (folder / "run.json").write_text("{"), "run.json is not that of a run"),
        (lambda folder: (folder / "run.json").write_bytes(b"\xff"), "run.json is not text"),
        (lambda folder: (folder / "run.json").unlink(), "run.json: No such file"),
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
    (kept,) = (store.runs / ".quarantine").iterdir()
    assert kept.name.startswith(bad.name)
    assert store.names() == [good.name]


def test_a_run_in_the_folder_of_another_is_damaged(store, planned):
    first, second = planned
    store.commit(first, outcome(first))
    (store.runs / first.name).rename(store.runs / second.name)
    with pytest.raises(UnreadableRunError, match=r"run\.json is that of"):
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
    csv = pd.read_csv(tmp_path / "tables" / "results.csv", keep_default_na=False)
    assert csv.columns.tolist() == tables.results.columns.tolist()


def test_a_folder_without_tables_or_with_others_is_refused(store, planned, tmp_path):
    with pytest.raises(TableError, match=r"holds no results\.parquet"):
        Tables.load(tmp_path)
    store.commit(planned[0], outcome(planned[0]))
    store.tables(store.sound(pytest.fail), ()).save(tmp_path)
    curves = pd.read_parquet(tmp_path / "curves.parquet")
    curves.drop(columns="reward").to_parquet(tmp_path / "curves.parquet")
    with pytest.raises(TableError, match=r"curves\.parquet cannot be used: .*reward"):
        Tables.load(tmp_path)


def test_a_second_sweep_waits_for_the_first(store):
    waited = []
    with store.lock(lambda: waited.append("first")):
        other = filelock.FileLock(store.runs / ".lock", is_singleton=False)
        with pytest.raises(filelock.Timeout):
            other.acquire(timeout=0)
    assert waited == []
    with other:

        def release():
            waited.append("second")
            other.release()

        store.lock(release).release()
    assert waited == ["second"]
