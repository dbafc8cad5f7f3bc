"""`bench run --reuse DIR`: finished runs of another folder are not trained again."""

import pytest
from clones import assert_kept, forget, lines, trained_methods

from bench.cli.app import main
from bench.execution import policies
from bench.execution.policies import keep
from bench.plan.expansion import expand
from bench.plan.suite import load_suite
from bench.store.reuse import reusable
from bench.store.tables import Tables

FIRST = """
tasks = ["spread"]
team_sizes = [2]
seeds = 2
[[methods]]
method = "instant"
"""
SECOND = FIRST + '[[methods]]\nmethod = "child"\n'


@pytest.fixture
def suites(tmp_path, monkeypatch):
    """Suites by name: `second` asks for the runs of `first` and for their children."""
    monkeypatch.setattr(policies, "runs_to_resume", set)
    found = {"first": FIRST, "second": SECOND}
    for name, text in found.items():
        (tmp_path / f"{name}.toml").write_text(text)
    return {name: tmp_path / f"{name}.toml" for name in found}


@pytest.fixture
def done(sweep, suites, out):
    """The folder of suite `first`, run and kept, elsewhere; its run folders are gone."""
    sweep(of=suites["first"])
    keep(out, (), ())
    forget(out)
    return out.rename(out.with_name("done"))


def test_rows_are_copied_and_parents_restored_from_the_other_folder(
    sweep, suites, done, out, trainer
):
    before = lines(done)
    status, said, _ = sweep("--reuse", str(done), of=suites["second"])
    assert status == 0
    assert "Runs finished already: 2 of 4. To do: 2" in said
    assert "Restored from kept policies, because others start from them: 2." in said
    assert trained_methods(trainer) == ["child", "child"]
    assert_kept(before, lines(out))
    assert lines(done) == before


def test_without_the_option_everything_is_trained(sweep, suites, done, trainer):
    sweep(of=suites["second"])
    assert trained_methods(trainer) == ["child", "child", "instant", "instant"]


def test_the_plan_counts_them_as_finished(sweep, suites, done):
    status, said, _ = sweep("--reuse", str(done), command="plan", of=suites["second"])
    assert status == 0
    assert "4 runs, 2 finished" in said


def test_a_run_of_another_key_and_a_failed_one_are_not_taken(suites, done):
    plan = expand(load_suite(str(suites["first"])))
    tables = Tables.load(done)
    assert set(reusable(plan, [done]).runs["run"]) == {run.name for run in plan.runs}
    moved, failed = (run.name for run in plan.runs)
    runs = tables.runs.set_index("run")
    runs.loc[moved, "key"] = "0" * 64
    runs.loc[failed, "status"] = "failed"
    Tables(tables.results, tables.curves, tables.trajectories, runs.reset_index()).save(done)
    assert reusable(plan, [done]).runs.empty


def test_of_a_run_in_two_folders_the_first_counts(suites, done, tmp_path):
    plan = expand(load_suite(str(suites["first"])))
    tables = Tables.load(done)
    there = Tables(
        tables.results, tables.curves, tables.trajectories, tables.runs.assign(machine="another")
    )
    there.save(tmp_path / "there")
    assert set(reusable(plan, [done, tmp_path / "there"]).runs["machine"]) != {"another"}
    assert set(reusable(plan, [tmp_path / "there", done]).runs["machine"]) == {"another"}


@pytest.mark.parametrize("command", ["run", "plan"])
def test_a_folder_without_tables_is_named(command, tmp_path, capsys):
    assert main([command, "quick", "--reuse", str(tmp_path)]) == 2
    assert str(tmp_path) in "".join(capsys.readouterr().err.split("\n"))
