"""Tables are the record, folders of runs a cache: which rows a sweep in a clone changes."""

import json
import math
import shutil

import pytest
from clones import assert_kept, bump, edit, files, forget, lines, rows, trained_methods

import bench.store.resume
from bench.plan import provenance as origins
from bench.store.tables import Tables


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
        assert "were made by another program" in error
        assert "Nothing was run. Give --replace to train these runs again" in error
        assert files(out) == before


def test_replaced_rows_alone_change(sweep, trainer, out, monkeypatch):
    sweep("--method", "instant", "--method", "failing", "--method", "dying")
    forget(out)
    before, old = lines(out), rows(out)
    bump(monkeypatch, "Instant")
    status, said, _ = sweep("--method", "instant", "--replace")
    assert status == 0
    assert "that will be replaced: 2." in said
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
    assert "that will be replaced: 2." in said
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
    assert sweep("--method", "instant", "--replace")[1].startswith("Rows of ")


def test_what_starts_from_a_replaced_run_is_replaced_too(sweep, trainer, out, monkeypatch):
    """Else its row would be of a policy that is no longer there."""
    sweep()
    edit(monkeypatch)
    status, said, _ = sweep("--replace")
    assert (status, sorted(trained_methods(trainer))) == (0, ["child"] * 2 + ["instant"] * 2)
    assert "that will be replaced: 4." in said
    other = bench.store.resume.packages() | {"jax": "0.0.1"}
    monkeypatch.setattr(bench.store.resume, "packages", lambda: other)
    assert "that will be replaced: 4." in sweep("--replace")[1]


def test_rows_of_restored_runs_may_be_missing(sweep, out):
    """A sweep that stopped after it had restored a parent, and before its tables were written."""
    sweep()
    for file in out.glob("*.parquet"):
        file.unlink()
    for content in (out / "runs").glob("*/run.json"):
        said = json.loads(content.read_text()) | {"sources": {}}
        content.write_text(json.dumps(said))
    assert sweep()[0] == 0


def test_replace_that_stops_at_a_failure_keeps_the_rows_that_were_not_reached(
    sweep, trainer, out, monkeypatch
):
    sweep("--method", "instant")
    before = files(out)
    old = lines(out)["runs"]
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
    assert not any(program in line for line in old)


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


def test_a_run_that_failed_by_itself_is_not_tried_again_in_a_clone(sweep, trainer, out):
    trainer.failing = {"failing"}
    assert sweep("--method", "failing", "--seeds", "1")[0] == 1
    forget(out)
    before = lines(out)
    trainer.failing = set()
    status, said, error = sweep("--method", "failing", "--seeds", "1")
    assert (status, trainer.trained) == (1, [])
    assert "Failed earlier: 1; --retry-failed tries them again." in said
    assert "the propellers fell off" in error
    assert lines(out) == before
    assert (
        "1 failed: the propellers fell off"
        in sweep("--method", "failing", "--seeds", "1", command="plan")[1]
    )
    assert sweep("--method", "failing", "--seeds", "1", "--retry-failed")[0] == 0
    assert rows(out)["failing", 0]["status"] == "budget"


def test_an_interrupted_run_is_tried_again_in_a_clone(sweep, trainer, out):
    trainer.dying = {"instant"}
    assert sweep("--method", "instant", "--seeds", "1")[0] == 1
    assert rows(out)["instant", 0]["cause"].startswith("interrupted: its worker process")
    forget(out)
    trainer.dying = set()
    assert sweep("--method", "instant", "--seeds", "1")[0] == 0
    assert trained_methods(trainer) == ["instant"]
