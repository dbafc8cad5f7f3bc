"""`bench plan`: what is there, what is missing and why, what it will cost; nothing is touched."""

import dataclasses

import jax
import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from tables_for_tests import Sheet

from bench.cli.app import main
from bench.execution.outlook import expectations, past_rows, show_plan
from bench.plan.expansion import Plan, expand
from bench.plan.suite import Row, Suite
from bench.stats.forecast import Guess, Past, guess, longest_chain, past_of_states, past_of_tables
from bench.store.missing import State, states
from bench.store.store import Outcome, Store
from bench.store.tables import Tables, table
from methods.contract import Ledger, Trained
from methods.training.policy import make_policy
from simulators.point_mass import PointMass
from tasks.spread import Spread


@pytest.fixture
def runs(plugins):
    """`instant` and its child, seeds 0 and 1."""
    return expand(Suite("test", "", ("spread",), (2,), 2, (Row("child"),))).runs


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "results")


def finished(run):
    simulator = PointMass()
    policy = make_policy(
        Spread(n_drones=2), simulator.spec, simulator.action_space, jax.random.key(0)
    )
    column = np.zeros(1, np.float32)
    names = ("reward", "smooth_reward", "crashes", "grad_norm")
    curves = {"run": [run.name], "epoch": [0]} | dict.fromkeys(names, column)
    trained = Trained(
        policy=policy,
        ledger=Ledger(hf_fleet_seconds=120.0, train_seconds=30.0, epochs=1),
        curves=dict.fromkeys(names, column),
    )
    return Outcome(
        status="ok",
        trained=trained,
        metrics={"reward": -3.0},
        curves=table("curves", pd.DataFrame(curves)),
        trajectory=table("trajectories", []),
    )


def make_past(**changes):
    same = {"run": "r", "method": "child", "residual": "", "variant": "", "task": "spread"}
    return Past(**(same | {"team_size": 2, "seconds": 10.0, "minutes": 4.0} | changes))


def content(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_reasons_say_why_a_run_is_missing_and_leave_the_store_alone(runs, store):
    first, child, second, other = runs
    store.commit(first, finished(first))
    store.commit(child, Outcome(status="failed", cause="the propellers fell off"))
    store.commit(second, finished(second))
    (store.runs / second.name / "policy.npz").write_bytes(b"")
    before = content(store.directory)
    found = {state.run.name: state for state in states(runs, store, Tables.empty())}
    assert found[first.name].reason == ""
    assert found[first.name].content["status"] == "ok"
    assert found[child.name].reason == "failed: the propellers fell off"
    assert found[second.name].reason == "damaged: policy.npz has changed since it was written"
    assert found[other.name].reason == "never run"
    assert content(store.directory) == before


def test_a_row_says_how_a_run_failed_whose_folder_is_damaged(runs, store):
    """As `bench run` takes it: it is tried again only if asked for."""
    run, empty = runs[0], Tables.empty()
    store.commit(run, Outcome(status="failed", cause="the propellers fell off"))
    (store.runs / run.name / "run.json").write_text("{")
    row = {"run": run.name, "status": "failed", "cause": "the propellers fell off"}
    runs_of_one = Sheet().add(rewards=(-1.0,)).tables().runs
    recorded = dataclasses.replace(empty, runs=runs_of_one.assign(**row))
    for tables, reason in ((recorded, "failed: the propellers"), (empty, "damaged: run.json")):
        (found,) = states([run], store, tables)
        assert found.reason.startswith(reason)
        assert found.failed == (tables is recorded)


def test_what_failed_by_itself_and_its_children_cost_nothing_unless_tried_again(
    runs, store, capsys
):
    first, *_ = runs
    store.commit(first, Outcome(status="failed", cause="the propellers fell off"))
    plan = Plan(runs, [])
    show_plan("test", plan, store.directory, 1, False, Console(width=200))
    said = capsys.readouterr().out
    assert "4 runs, 0 finished" in said
    assert "2 to do." in said
    assert "2 failed earlier, or start from one that did; --retry-failed tries them" in said
    assert "1 failed: the propellers fell off" in said
    show_plan("test", plan, store.directory, 1, False, Console(width=200), retry_failed=True)
    said = capsys.readouterr().out
    assert "4 to do." in said
    assert "failed earlier" not in said


def test_a_run_that_was_killed_is_called_interrupted_not_failed(runs, store):
    run = runs[0]
    store.commit(run, Outcome(status="failed", cause="its worker was killed", interrupted=True))
    (state,) = states([run], store, Tables.empty())
    assert state.reason == "interrupted: its worker was killed"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"versions": {"task spread": "9"}}, 'version of task spread "1" -> "9"'),
        ({"parents": {"instant": "0000"}}, "its parent instant is another run"),
        ({"numerics": {"x64": True}}, "x64 false -> true"),
        ({"defaults": {"simulator crazyflow": {"freq": 9}}}, "simulator crazyflow's freq 500 -> 9"),
    ],
)
def test_what_has_changed_since_a_run_was_stored_is_named(runs, store, change, reason):
    _, child, *_ = runs
    store.commit(child, finished(child))
    new = {name: {**child.resolved[name], **value} for name, value in change.items()}
    if "defaults" in change:
        kept = child.resolved["defaults"]
        name = "simulator crazyflow"
        new["defaults"] = {**kept, name: {**kept[name], "freq": 9}}
    changed = dataclasses.replace(child, resolved={**child.resolved, **new})
    (found,) = states([changed], store, Tables.empty())
    assert found.reason == f"changed: {reason}"


def test_costs_come_from_the_nearest_past_runs(runs):
    run = runs[1]
    cell = [make_past(seconds=10.0), make_past(seconds=20.0)]
    size = make_past(team_size=4, seconds=60.0, minutes=40.0)
    far = make_past(team_size=18, seconds=9.0, minutes=9.0)
    task = make_past(task="circle", seconds=7.0)
    variant = make_past(variant="lr=1", seconds=5.0)
    other = make_past(method="instant")
    assert guess(run, [other, variant, task, size, *cell]) == (15.0, 4.0, "same cell")
    assert guess(run, [other, variant, task, far, size]) == (40.0, 20.0, "other team size")
    assert guess(run, [other, variant, task]) == (7.0, 4.0, "other task")
    assert guess(run, [other, variant]) == (5.0, 4.0, "other variant")
    assert guess(run, [other]) is None


@pytest.mark.parametrize(
    ("epochs", "calibrated", "seconds", "minutes"),
    [(400, False, 1.0, 0.4), (400, True, 1.0, 4.0), (20, False, 10.0, 4.0), (np.nan, False, 10, 4)],
)
def test_a_run_of_fewer_epochs_costs_less_but_for_its_calibration(
    runs, epochs, calibrated, seconds, minutes
):
    run = dataclasses.replace(runs[1], resolved={"settings": {"trainer": {"epochs": 40}}})
    past = make_past(variant="x=1", epochs=epochs, calibrated=calibrated)
    found = guess(run, [past])
    assert found is not None
    assert found[:2] == pytest.approx((seconds, minutes))


def test_a_trainer_that_is_no_table_says_nothing_of_epochs(runs):
    run = dataclasses.replace(runs[1], resolved={"settings": {"trainer": "adam"}})
    found = guess(run, [make_past(variant="x=1", epochs=400)])
    assert found is not None
    assert found[:2] == pytest.approx((10.0, 4.0))


def test_past_runs_are_those_of_tables_and_of_the_store(runs, store):
    tables = Sheet().add("child", team_size=2, fleet_minutes=6.0, train_seconds=12.0).tables()
    (found,) = past_of_tables(tables)
    assert (found.method, found.seconds, found.minutes) == ("child", 12.0, 6.0)
    store.commit(runs[1], finished(runs[1]))
    (found,) = past_of_states(states(runs, store, Tables.empty()))
    assert (found.run, found.seconds, found.minutes) == (runs[1].name, 30.0, 2.0)


def test_jobs_do_not_undercut_the_longest_chain(runs):
    times = {run.name: 100.0 for run in runs}
    assert longest_chain(runs, times) == 200.0
    missing = [State(run, None, "never run") for run in runs]
    past = [make_past(seconds=100.0), make_past(method="instant", seconds=100.0, minutes=0.0)]
    guesses = {run.name: guess(run, past) for run in runs}
    one, two, many = (expectations(missing, guesses, jobs, 2)[0] for jobs in (1, 2, 99))
    assert one.startswith("Expected: 8 HF fleet-minutes and 6.7 min of training, 6.7 min on 1 w")
    assert "3.3 min on 2 workers" in two
    assert "3.3 min on 99 workers" in many
    assert expectations([], {}, 1, 0) == ["Nothing to do."]
    idle = {run.name: Guess(0.0, 0.0, "no training") for run in runs}
    assert f"5 past runs: {len(runs)} that train nothing." in expectations(missing, idle, 1, 5)[-1]


def test_damaged_tables_are_named_and_stop_nobody(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Sheet().add("child").tables().save(tmp_path / "results" / "good")
    (tmp_path / "results" / "bad").mkdir()
    (tmp_path / "results" / "bad" / "results.parquet").write_bytes(b"x")
    assert len(past_rows(tmp_path / "elsewhere", Console())) == 1
    assert "Past rows left out" in capsys.readouterr().out


def test_the_command_shows_the_plan_and_writes_nothing(
    plugins, write_suite, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    suite = write_suite("child", "shattered")
    before = content(tmp_path)
    out = tmp_path / "out"
    assert main(["plan", str(suite), "--out", str(out), "--every"]) == 1  # a plug-in is broken
    text = capsys.readouterr().out
    assert "2 runs, 0 finished in" in text
    assert "Left out: The method 'shattered'" in text
    assert "2 never run: instant spread n2 s0" in text
    assert "2 unknown, because no past run is like them" in text
    assert "child spread n2 s0 (horizon=5): never run; cost unknown" in text
    assert content(tmp_path) == before
    assert not out.exists()
    assert main(["plan", str(suite), "--jobs", "0"]) == 2
