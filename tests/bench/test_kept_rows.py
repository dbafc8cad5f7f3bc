"""Tables are the record, folders of runs a cache: what a sweep does in a clone, and to whose rows.

A clone has the tables that were committed and no `runs/`.
"""

import dataclasses
import math
import shutil
import subprocess
from pathlib import Path

import at_once
import pandas as pd
import pytest

import bench.plan.expansion
import bench.store.resume
from bench.cli.app import main
from bench.plan import provenance as origins
from bench.plan.expansion import expand
from bench.plan.suite import load_suite
from bench.store.resume import REPRODUCED, make_standing, reproduces
from bench.store.store import Store
from bench.store.tables import IDENTITY, Tables

ROOT = Path(__file__).parents[2]


@pytest.fixture
def trainer(plugins, monkeypatch):
    return at_once.install(monkeypatch, documents=False)


@pytest.fixture
def sweep(trainer, write_suite, tmp_path, capsys):
    """A function that runs a suite and returns exit status, stdout and stderr."""
    suite = write_suite("instant", "child", seeds=2)

    def run(*arguments, command="run", of=suite):
        trainer.trained.clear()
        jobs = ("--jobs", "1") if command == "run" else ()
        status = main([command, str(of), "--out", str(tmp_path / "out"), *jobs, *arguments])
        said = capsys.readouterr()
        return status, " ".join(said.out.split()), " ".join(said.err.split())

    return run


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def planned(write_suite, *rows, **changes):
    return expand(load_suite(str(write_suite(*rows, **changes)))).runs


def forget(out):
    """Makes a clone."""
    shutil.rmtree(out / "runs")


def files(out):
    """Content of every file of tables and runs; what a lock leaves is no content."""
    return {
        path: path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def lines(out):
    """Rows of both tables that are the record, as text that tells any two values apart."""
    tables = Tables.load(out)
    names = ("results", "runs")
    return {name: getattr(tables, name).to_csv(index=False).splitlines() for name in names}


def assert_kept(before, after):
    """All rows of `before` stand in `after`, to the last digit and in their order."""
    for name, rows in before.items():
        assert [line for line in after[name] if line in {*rows}] == rows


def rows(out):
    """Program and status of each run, by method and seed."""
    runs = Tables.load(out).runs
    assert not runs.duplicated([*IDENTITY]).any()
    return runs.set_index(["method", "seed"])[["run", "program", "status", "cause"]].T.to_dict()


def trained_methods(trainer):
    return sorted(name.split("-")[0] for name in trainer.trained)


def bump(monkeypatch, *methods, version="2"):
    """Another version of some fake methods, so another key."""
    import fakes

    for method in methods:
        monkeypatch.setattr(getattr(fakes, method), "version", version)


def edit(monkeypatch):
    """Another source under the same versions."""
    monkeypatch.setattr(bench.plan.expansion, "own_source", lambda cls: f"new {cls.__name__}")


def test_a_filtered_run_in_a_clone_adds_rows_and_keeps_all_others(sweep, trainer, out):
    sweep()
    assert trained_methods(trainer) == ["child", "child", "instant", "instant"]
    forget(out)
    before = lines(out)
    status, said, _ = sweep("--method", "child", "--seeds", "3")
    assert status == 0
    assert "Runs finished already: 4 of 6. To do: 2, on 1 worker." in said
    assert trained_methods(trainer) == ["child", "instant"]
    assert_kept(before, lines(out))
    assert {*rows(out)} == {(m, s) for m in ("instant", "child") for s in range(3)}
    before = lines(out)
    forget(out)
    assert sweep("--method", "dying", "--seeds", "1")[0] == 0
    assert_kept(before, lines(out))
    assert {*rows(out)} >= {("dying", 0), ("child", 2)}
    assert len(rows(out)) == 7


def test_rows_whose_key_is_current_are_finished_without_a_folder(sweep, trainer, out):
    sweep()
    forget(out)
    before = files(out)
    status, said, _ = sweep()
    assert (status, trainer.trained) == (0, [])
    assert "Runs finished already: 4 of 4. To do: nothing." in said
    assert {path: files(out)[path] for path in before} == before
    assert "4 runs, 4 finished in" in sweep(command="plan")[1]


def test_a_run_whose_folder_was_lost_before_it_was_recorded_is_trained_again(sweep, trainer, out):
    trainer.most = 3
    status, _, said = sweep()
    assert status == 130
    assert "Interrupted: 3 of 4 runs are finished and kept." in said
    assert not (out / "runs.parquet").exists()
    for folder in (out / "runs").glob("child-*"):
        shutil.rmtree(folder)
    trainer.most = math.inf
    assert sweep()[0] == 0
    assert "child" in trained_methods(trainer)
    assert len(rows(out)) == 4


def test_an_interruption_in_a_clone_counts_the_rows_that_are_there(sweep, trainer, out):
    sweep()
    forget(out)
    before = files(out)
    trainer.most = 0
    status, _, said = sweep("--seeds", "3")
    assert status == 130
    assert "Interrupted: 4 of 6 runs are finished and kept." in said
    assert {path: files(out)[path] for path in before} == before


def test_rows_of_another_key_are_refused_with_all_as_it_was(sweep, trainer, out, monkeypatch):
    sweep()
    for clone in (False, True):
        if clone:
            forget(out)
        before = files(out)
        with monkeypatch.context() as changed:
            bump(changed, "Instant")
            status, said, error = sweep("--seeds", "1")
            (told,) = sweep("--seeds", "1", command="plan")[1:2]
            assert ("2 changed: its row is of another program, see `--replace`" in told) == clone
            assert ('1 changed: version of method instant "1" -> "2"' in told) != clone
        assert (status, said, trainer.trained) == (2, "", [])
        assert error.startswith("bench: 2 rows of ")
        assert "are of another program" in error
        assert "Nothing was run. Give --replace to train these runs again" in error
        assert files(out) == before


def test_replaced_rows_alone_change(sweep, trainer, out, monkeypatch):
    sweep("--method", "instant", "--method", "failing", "--method", "dying")
    forget(out)
    before, old = lines(out), rows(out)
    bump(monkeypatch, "Instant")
    status, said, _ = sweep("--method", "instant", "--replace")
    assert status == 0
    assert "2 rows of" in said
    assert "will be replaced." in said
    assert trained_methods(trainer) == ["instant", "instant"]
    new = rows(out)
    assert new.keys() == old.keys()
    changed = {identity for identity in old if old[identity]["run"] != new[identity]["run"]}
    assert changed == {("instant", 0), ("instant", 1)}
    others = {
        name: [line for line in own if not line.startswith("instant-")]
        for name, own in before.items()
    }
    assert_kept(others, lines(out))
    assert sweep("--method", "instant")[1].startswith("Runs finished already: 2 of 2.")


def test_a_replaced_row_leaves_only_once_the_new_run_is_there(sweep, trainer, out, monkeypatch):
    sweep()
    before, old = lines(out), rows(out)
    bump(monkeypatch, "Instant")
    trainer.failing = {"instant"}
    status, _, error = sweep("--replace")
    assert status == 1
    assert "4 of 4 runs failed; the first: instant" in error
    assert "the propellers fell off" in error
    assert (lines(out), rows(out)) == (before, old)
    trainer.most = 1
    trainer.failing = set()
    assert sweep("--replace", "--retry-failed")[0] == 130
    assert (lines(out), rows(out)) == (before, old)
    trainer.most = math.inf
    assert sweep("--replace", "--retry-failed")[0] == 0
    assert all(rows(out)[i]["run"] != old[i]["run"] for i in old)
    assert rows(out).keys() == old.keys()


def test_another_source_under_the_same_key_is_used_with_a_warning_and_counted(
    sweep, trainer, out, monkeypatch
):
    sweep()
    assert "4 of 4 rows are of this program." in sweep(command="plan")[1]
    sweep("--seeds", "1")
    forget(out)
    before = files(out)
    edit(monkeypatch)
    status, _, error = sweep()
    assert (status, trainer.trained) == (0, [])
    assert "4 rows were made by other source code under the same versions." in error
    assert {path: files(out)[path] for path in before} == before
    assert "0 of 4 rows are of this program." in sweep(command="plan")[1]
    assert sweep("--method", "instant", "--seeds", "1", "--replace")[0] == 0
    assert "1 of 4 rows are of this program." in sweep(command="plan")[1]


@pytest.mark.parametrize("clone", [False, True])
def test_replace_trains_again_what_another_source_or_machine_made(
    sweep, trainer, out, monkeypatch, clone
):
    sweep()
    old = rows(out)
    if clone:
        forget(out)
    edit(monkeypatch)
    trainer.shift = {"instant": -0.5}
    before = Tables.load(out)
    status, said, _ = sweep("--replace", "--method", "instant")
    assert (status, trained_methods(trainer)) == (0, ["instant", "instant"])
    assert "2 rows of" in said
    after, new = Tables.load(out), rows(out)
    for method, seed in old:
        name = old[method, seed]["run"]
        assert new[method, seed]["run"] == name  # under the same key
        apart = after.metrics(name)["reward"] - before.metrics(name)["reward"]
        assert apart == pytest.approx(-0.5 * (method == "instant"))
        same = new[method, seed]["program"] == old[method, seed]["program"]
        assert same == (method == "child")
    kept = [*(out / "runs" / ".quarantine").glob("instant-*.reason.txt")] if not clone else []
    assert len(kept) == 2 * (not clone)
    here = origins.provenance() | {"machine": "another one"}
    monkeypatch.setattr(bench.store.resume, "provenance", lambda: here)
    assert sweep("--method", "instant", "--replace")[1].startswith("2 rows of")


def test_replace_that_stops_at_a_failure_keeps_the_rows_that_were_not_reached(
    sweep, trainer, out, monkeypatch
):
    sweep("--method", "instant")
    before = files(out)
    (old,) = {row["program"] for row in rows(out).values()}
    edit(monkeypatch)
    trainer.failing = {"instant"}
    status, _, error = sweep("--method", "instant", "--replace", "--fail-fast")
    assert status == 1
    assert "Stopped at the first failure: 1 runs are still to do." in error
    assert {p: files(out)[p] for p in before if p.parent == out} == {
        p: content for p, content in before.items() if p.parent == out
    }
    trainer.failing = set()
    assert sweep("--method", "instant", "--replace", "--retry-failed")[0] == 0
    (program,) = {row["program"] for row in rows(out).values()}
    assert program != old


def test_a_failed_row_of_another_program_gives_way_to_the_run_that_went_well(
    sweep, trainer, out, monkeypatch
):
    trainer.failing = {"failing"}
    assert sweep("--method", "failing", "--seeds", "1")[0] == 1
    assert rows(out)["failing", 0]["status"] == "failed"
    trainer.failing = set()
    bump(monkeypatch, "Failing")
    for clone in (True, False):
        if clone:
            forget(out)
        assert sweep("--method", "failing", "--seeds", "1")[0] == 0
        assert rows(out)["failing", 0]["status"] == "budget"
    assert trainer.trained == []


def lost_parents(sweep, out):
    """A clone with the rows of `instant` alone; what is to be done, their children, needs them."""
    sweep("--method", "instant")
    forget(out)
    return lines(out)


def test_lost_parents_are_trained_again_and_their_rows_stay(sweep, trainer, out):
    before = lost_parents(sweep, out)
    status, said, _ = sweep()
    assert status == 0
    assert "Runs finished already: 2 of 4. To do: 2, on 1 worker." in said
    assert "Trained again, because others start from their lost policies: 2." in said
    assert trained_methods(trainer) == ["child", "child", "instant", "instant"]
    assert_kept(before, lines(out))
    assert len(rows(out)) == 4


def test_parents_of_finished_children_are_not_trained_again(sweep, trainer, out):
    sweep()
    forget(out)
    assert sweep("--seeds", "3")[0] == 0
    assert [name.partition("-s2-")[1] for name in trainer.trained] == ["-s2-"] * 2


def test_a_parent_that_does_not_reproduce_its_row_is_put_in_quarantine(sweep, trainer, out):
    before = lost_parents(sweep, out)
    trainer.shift = {"instant": -0.25}
    status, _, error = sweep("--seeds", "1")
    assert status == 1
    parent = rows(out)["instant", 0]["run"]
    assert trainer.trained == [parent]  # nothing starts from a policy that is not of its row
    assert_kept(before, lines(out))
    assert rows(out)["instant", 0]["status"] == "budget"
    child = rows(out)["child", 0]
    assert child["status"] == "failed"
    assert child["cause"].startswith(
        f"parent {parent} failed: trained again, its settled_reward is "
    )
    assert "give --replace to train it and what starts from it anew" in child["cause"]
    assert "2 of 2 runs failed; the first: child" in error
    assert "trained again, its settled_reward is" in error
    assert not (out / "runs" / parent).exists()
    (kept,) = (out / "runs" / ".quarantine").glob(f"{parent}-*.reason.txt")
    assert kept.read_text().startswith("trained again, its settled_reward is ")
    assert kept.with_name(kept.name.removesuffix(".reason.txt")).is_dir()

    trainer.shift = {}  # on the machine that made the row, say
    assert sweep("--seeds", "1")[0] == 0
    assert rows(out)["child", 0]["status"] == "budget"
    assert_kept(before, lines(out))


def test_a_lost_parent_whose_worker_dies_is_trained_again_next_time(sweep, trainer, out):
    before = lost_parents(sweep, out)
    trainer.dying = {"instant"}
    assert sweep("--seeds", "1")[0] == 1
    assert "ended by SIGKILL" not in rows(out)["instant", 0]["cause"]
    assert rows(out)["child", 0]["status"] == "failed"
    trainer.dying = set()
    status, said, _ = sweep("--seeds", "1")
    assert (status, trained_methods(trainer)) == (0, ["child", "instant"])
    assert "from their lost policies: 1." in said
    assert rows(out)["child", 0]["status"] == "budget"
    assert_kept(before, lines(out))


def test_a_damaged_folder_costs_no_row(sweep, trainer, out):
    sweep()
    before = files(out)
    for policy in (out / "runs").glob("*/policy.npz"):
        policy.write_bytes(b"")
    status, _, error = sweep()
    assert (status, trainer.trained) == (0, [])
    assert error.count("policy.npz is not as it was written") == 4
    assert {p: files(out)[p] for p in before if p.parent == out} == {
        p: content for p, content in before.items() if p.parent == out
    }


def test_a_real_training_reproduces_its_row(plugins, write_suite, tmp_path, monkeypatch):
    """`instant` and `child` as workers do them, in this process."""
    suite, out = write_suite("instant", "child"), tmp_path / "out"

    def do(slot, task):
        return at_once.Ended(slot, task(lambda *_: None))

    monkeypatch.setattr("bench.execution.sweep.make_executor", lambda *_: at_once.AtOnce(do))
    assert main(["run", str(suite), "--out", str(out), "--method", "instant"]) == 0
    before = lines(out)
    forget(out)
    assert main(["run", str(suite), "--out", str(out), "--jobs", "1"]) == 0
    assert_kept(before, lines(out))
    assert {key: row["status"] for key, row in rows(out).items()} == {
        ("instant", 0): "ok",
        ("child", 0): "ok",
    }


METRICS = {"settled_reward": -3.0, "reward": -40.0, "training_reward": -5.0, "crashes": 1.0}


@pytest.mark.parametrize("metric", ["settled_reward", "reward", "training_reward"])
def test_a_number_that_is_not_that_of_the_row_is_named(metric):
    other = METRICS | {metric: METRICS[metric] * (1.0 + 2.0 * REPRODUCED)}
    assert f"trained again, its {metric} is" in reproduces(other, METRICS)
    assert reproduces(METRICS | {metric: METRICS[metric] * (1.0 + 0.5 * REPRODUCED)}, METRICS) == ""
    nothing = METRICS | {metric: math.nan}
    assert f"its {metric} is nan" in reproduces(nothing, METRICS)
    assert "its row says nan" in reproduces(METRICS, nothing)
    assert reproduces(nothing, nothing) == ""


def test_seconds_and_costs_need_not_be_reproduced():
    assert reproduces(METRICS | {"train_seconds": 1.0}, METRICS | {"train_seconds": 9.0}) == ""


def test_a_grandparent_that_is_lost_is_trained_again_too(plugins, write_suite):
    plan = expand(load_suite(str(write_suite("child"))))
    parent, child = plan.runs
    grand = dataclasses.replace(child, parents={"child": child.name}, seed=7)
    whole = dataclasses.replace(plan, runs=[*plan.runs, grand])
    recorded = Tables.empty()
    identities = [dict(zip(IDENTITY, run.identity, strict=True)) for run in plan.runs]
    texts = dict.fromkeys(("cause", "settings", "versions"), "")
    made = [
        {"run": run.name, "status": "ok", **identity, **texts, **bench.store.tables.UNKNOWN}
        for run, identity in zip(plan.runs, identities, strict=True)
    ]
    recorded = dataclasses.replace(recorded, runs=bench.store.tables.table("runs", made))
    standing = make_standing(whole, {}, recorded)
    assert standing.missing == [grand]
    assert standing.done == [parent, child]
    assert sorted(run.name for run in standing.again) == sorted([parent.name, child.name])
    there = {child.name: {"status": "ok"}}
    assert make_standing(whole, there, recorded).again == []
    assert make_standing(whole, {child.name: {"status": "failed"}}, recorded).again == [
        child,
        parent,
    ]


def test_every_row_can_be_traced(sweep, trainer, out, write_suite):
    trainer.failing = {"failing"}
    assert sweep(of=write_suite("child", "failing", seeds=2))[0] == 1
    runs = {run.name: run for run in planned(write_suite, "child", "failing", seeds=2)}
    found = Tables.load(out).runs
    assert set(found["run"]) == set(runs)
    assert found["status"].value_counts().to_dict() == {"budget": 4, "failed": 2}
    (commit,) = {*found["commit"]}
    if (ROOT / ".git").exists():
        kind = ["git", "-C", str(ROOT), "cat-file", "-t", commit]
        assert subprocess.run(kind, capture_output=True, check=True).stdout == b"commit\n"
    else:
        assert commit == ""
    for row in found.to_dict("records"):
        run = runs[row["run"]]
        assert (row["key"], row["program"]) == (run.key, run.program)
        assert len(row["program"]) == 16
        assert row["dirty"] in (True, False)
        assert row["machine"]
        assert row["device"].startswith("cpu")
        assert pd.Timestamp(row["committed"]).tzinfo is not None
    for column in ("key", "committed", "program", "machine", "device"):
        assert (found[column] != "").all()


def test_a_row_says_whether_the_code_had_changes_that_are_in_no_commit(tmp_path, monkeypatch):
    def git(*arguments):
        given = ("-c", "user.name=a", "-c", "user.email=a@b.example", "-c", "commit.gpgsign=false")
        subprocess.run(["git", "-C", str(tmp_path), *given, *arguments], check=True)

    monkeypatch.setattr(origins, "HOUSE", tmp_path)
    look = origins.provenance.__wrapped__
    assert (look()["commit"], look()["dirty"]) == ("", False)
    for folder in origins.CODE:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "module.py").write_text("x = 1\n")
    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "first")
    commit = look()["commit"]
    assert len(commit) == 40
    assert not look()["dirty"]
    (tmp_path / "reports.md").write_text("no code")
    assert not look()["dirty"]
    (tmp_path / "methods" / "module.py").write_text("x = 2\n")
    assert look() == origins.provenance() | {"commit": commit, "dirty": True}


def test_the_program_of_a_run_is_a_hash_of_its_sources_alone(plugins, write_suite, monkeypatch):
    before = planned(write_suite, "child")
    again = planned(write_suite, "child", seeds=3)
    assert {run.program for run in before if run.method == "child"} == {
        run.program for run in again if run.method == "child"
    }
    assert len({run.program for run in before}) == 2
    assert origins.digest({"a": "1", "b": "2"}) == origins.digest({"b": "2", "a": "1"})
    edit(monkeypatch)
    after = planned(write_suite, "child")
    assert [run.key for run in after] == [run.key for run in before]
    assert {run.program for run in after}.isdisjoint(run.program for run in before)


def test_a_folder_from_before_runs_could_be_traced_has_a_row(plugins, write_suite, tmp_path):
    (run,) = planned(write_suite, "instant")
    store = Store(tmp_path / "results")
    store.commit(run, at_once.outcome(run))
    sound = store.sound(pytest.fail)
    for column in ("provenance", "program"):
        del sound[run.name][column]
    (row,) = store.tables(sound, ()).runs.to_dict("records")
    assert (row["key"], row["program"], row["machine"], row["dirty"]) == (run.key, "", "", False)
