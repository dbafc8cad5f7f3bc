"""`bench submit` and `bench verify`: own rows as a folder, and one seed trained again."""

import json
import math

import fakes
import pandas as pd
import pytest

from bench.cli.app import main
from bench.plan.sources import own_source
from bench.sharing.submission.agreement import agreement, worst
from bench.store.record import checksum
from bench.store.tables import Tables


@pytest.fixture
def submitted(sweep, write_suite, out, tmp_path, capsys):
    """A function that trains seeds of `instant` and `child` and submits the rows of one."""

    def submit(method="instant", seeds=4):
        sweep(of=write_suite("instant", "child", seeds=seeds))
        folder = tmp_path / "submission"
        assert main(["submit", str(out), "--method", method, "--out", str(folder)]) == 0
        capsys.readouterr()
        return folder

    return submit


@pytest.fixture
def call(capsys):
    """A function that runs a command and returns its exit status and all that it says."""

    def run(*arguments):
        status = main([*map(str, arguments)])
        said = capsys.readouterr()
        return status, " ".join((said.out + said.err).split())

    return run


def test_a_submission_says_what_its_rows_are_and_where_they_come_from(submitted, out):
    folder = submitted()
    record = json.loads((folder / "submission.json").read_text())
    own, all_rows = Tables.load(folder), Tables.load(out)
    assert {*own.runs["method"]} == {"instant"}
    assert {*all_rows.runs["method"]} == {"instant", "child"}
    assert record["runs"] == own.column("key")
    assert (record["package"], record["class"]) == ("fakes 1.0", "fakes:Instant")
    assert record["source"] == own_source(fakes.Instant)
    assert record["commits"] == sorted({*own.runs["commit"]})
    assert {*record["files"]} == {"results.parquet", "runs.parquet", "curves.parquet"}
    assert "| instant, horizon=5 | spread, N = 2 | 4 |" in (folder / "README.md").read_text()


def test_the_same_program_reproduces_a_row_to_the_digit(submitted, call, trainer):
    folder = submitted()
    trainer.trained.clear()
    status, said = call("verify", folder, "--seed", "2")
    assert status == 0
    assert said.count("match, reproduced to the digit") == 2
    assert [name.rpartition("-")[0] for name in trainer.trained] == ["instant-spread-n2-s2"]


def test_the_parents_of_a_row_are_trained_with_it(submitted, call, trainer, tmp_path):
    folder = submitted("child")
    trainer.trained.clear()
    status, _ = call("verify", folder, "--seed", "1", "--out", tmp_path / "again")
    assert status == 0
    assert [name.rpartition("-")[0] for name in trainer.trained] == [
        "instant-spread-n2-s1",
        "child-spread-n2-s1",
    ]
    assert {*Tables.load(tmp_path / "again").runs["method"]} == {"instant", "child"}


@pytest.mark.parametrize(
    ("seeds", "shift", "status", "reason"),
    [
        (4, 1.0, 0, "match, within what one more seed would give"),
        (4, -9000.0, 3, "differs, outside of what one more seed would give"),
        (2, 1.0, 4, "the scatter of the seeds is not known (2 seeds in the folder"),
        (1, -9000.0, 4, "the scatter of the seeds is not known (1 seed in the folder"),
    ],
)
def test_another_machine_is_compared_by_the_scatter_of_the_seeds(
    submitted, call, trainer, seeds, shift, status, reason
):
    folder = submitted(seeds=seeds)
    trainer.shift["instant"] = shift
    found, said = call("verify", folder, "--seed", "0")
    assert (found, reason in said) == (status, True), said


def test_a_training_that_fails_is_no_match(submitted, call, trainer):
    folder = submitted()
    trainer.failing.add("instant")
    status, said = call("verify", folder)
    assert status == 1
    assert "the propellers fell off" in said


def test_files_that_were_changed_are_refused(submitted, call):
    folder = submitted()
    frame = pd.read_parquet(folder / "results.parquet")
    frame["value"] += 1.0
    frame.to_parquet(folder / "results.parquet", index=False)
    status, said = call("verify", folder)
    assert status == 2
    assert "results.parquet has changed since it was submitted" in said
    (folder / "curves.parquet").unlink()
    assert "must hold curves.parquet, results.parquet, runs.parquet" in call("verify", folder)[1]
    (folder / "submission.json").write_text("{}")
    assert "does not describe a submission" in call("verify", folder)[1]


@pytest.mark.parametrize(
    ("column", "value", "wrong"),
    [
        ("method", "child", "is of 'child', not of 'instant'"),
        ("key", "0123456789abcdef", "does not have the name that its key 0123456789abcdef"),
        ("status", "failed", "ended as 'failed', which its metrics contradict"),
    ],
)
def test_rows_that_contradict_themselves_are_refused(submitted, call, column, value, wrong):
    folder = submitted()
    path, record = folder / "runs.parquet", folder / "submission.json"
    frame = pd.read_parquet(path)
    frame.loc[1, column] = value
    frame.to_parquet(path, index=False)
    content = json.loads(record.read_text())
    content["files"]["runs.parquet"] = checksum(path.read_bytes())
    record.write_text(json.dumps(content))
    status, said = call("verify", folder)
    assert (status, wrong in said) == (2, True), said


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (lambda rows: rows.assign(seed=rows["seed"] + 1), "is said of another cell or seed"),
        (lambda rows: pd.concat([rows, rows.iloc[:1]]), "is there twice"),
        (lambda rows: pd.concat([rows, rows.iloc[:1].assign(run="x")]), "belongs to no row"),
    ],
)
def test_metrics_that_contradict_their_rows_are_refused(submitted, call, change, wrong):
    folder = submitted()
    path, record = folder / "results.parquet", folder / "submission.json"
    change(pd.read_parquet(path)).to_parquet(path, index=False)
    content = json.loads(record.read_text())
    content["files"][path.name] = checksum(path.read_bytes())
    record.write_text(json.dumps(content))
    status, said = call("verify", folder)
    assert (status, wrong in said) == (2, True), said


def test_a_row_is_never_compared_with_itself(submitted, call, out):
    folder = submitted()
    for place in (out, folder):
        status, said = call("verify", folder, "--out", place)
        assert (status, "holds the submitted row itself" in said) == (2, True), said


def test_another_version_of_the_method_can_neither_be_submitted_nor_compared(
    submitted, call, trainer, out, tmp_path, monkeypatch
):
    folder = submitted()
    trainer.trained.clear()
    monkeypatch.setattr(fakes.Instant, "version", "2")
    status, said = call("verify", folder)
    assert status == 4
    assert "method instant is version 2 here and 1 there" in said
    assert trainer.trained == []
    again = tmp_path / "again"
    status, said = call("submit", out, "--method", "instant", "--out", again)
    assert (status, "Nothing was written" in said) == (2, True)
    assert not again.exists()


def test_rows_of_other_source_code_cannot_be_submitted(submitted, call, out, tmp_path):
    submitted()
    tables = Tables.load(out)
    tables.runs["program"] = "0123456789abcdef"
    tables.save(out)
    status, said = call("submit", out, "--method", "instant", "--out", tmp_path / "again")
    assert (status, "source code has changed" in said) == (2, True)


def test_a_row_that_is_not_there_is_named_with_those_that_are(submitted, call, out, tmp_path):
    folder = submitted(seeds=1)
    status, said = call("verify", folder, "--seed", "7")
    assert (status, "The submission has: spread, N = 2, seed 0." in said) == (2, True)
    status, said = call("submit", out, "--method", "flown", "--out", tmp_path / "again")
    assert (status, "They have: child, instant." in said) == (2, True)


def test_seeds_that_scatter_down_to_a_team_that_does_nothing_tell_nothing():
    seeds = [-5.0, -60.0, -100.0]
    found = agreement(-50.0, -5.0, seeds, idle=-120.0)
    assert found.outcome == "cannot tell"
    assert "a team which stays at its spawn (-120.0) would pass" in found.reason
    assert agreement(-50.0, -5.0, seeds, idle=-900.0).outcome == "match"


def test_the_interval_is_that_of_one_more_seed():
    seeds = [1.0, 2.0, 3.0]  # s = 1; t(0.975, 2) = 4.3027
    half = 4.3027 * math.sqrt(1.0 + 1.0 / 3.0)
    assert agreement(2.0 + 0.999 * half, 1.0, seeds).outcome == "match"
    assert agreement(2.0 + 1.001 * half, 1.0, seeds).outcome == "differs"
    assert agreement(40.0, 40.5, [40.5, 40.5, 40.5]).outcome == "differs"


def test_one_difference_decides():
    match, unknown = agreement(1.0, 1.0, [1.0]), agreement(1.0, 2.0, [2.0])
    differs = agreement(9.0, 1.0, [1.0, 1.1, 1.2])
    assert worst([match]) == "match"
    assert worst([match, unknown]) == "cannot tell"
    assert worst([unknown, differs, match]) == "differs"
