"""Parents whose folders are gone are trained again, and must come out as their rows say."""

import dataclasses
import math

import pytest
from clones import assert_kept, forget, lines, rows, trained_methods

import bench.store.tables
from bench.cli.app import main
from bench.plan.expansion import expand
from bench.plan.suite import load_suite
from bench.store.resume import REPRODUCED, make_standing, reproduces
from bench.store.tables import IDENTITY, Tables


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


def test_the_plan_counts_lost_parents_that_are_trained_again(
    sweep, trainer, out, write_suite, capsys
):
    lost_parents(sweep, out)
    suite = str(write_suite("instant", "child", seeds=2))
    assert main(["plan", suite, "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "4 runs, 0 finished in" in said
    assert "2 trained again, because others start from their lost policies: instant" in said


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
        f"interrupted: parent {parent} failed: trained again, its settled_reward is "
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


def test_a_real_training_reproduces_its_row(in_process, write_suite, tmp_path):
    """`instant` and `child` as workers do them, in this process."""
    suite, out = write_suite("instant", "child"), tmp_path / "out"
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
    texts = dict.fromkeys(bench.store.tables.SCHEMAS["runs"].columns, "") | {"dirty": False}
    made = [
        {**texts, "run": run.name, "status": "ok", **identity}
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
