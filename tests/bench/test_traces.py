"""Where a row comes from: commit, program, machine, device."""

import subprocess
from pathlib import Path

import pandas as pd
import pytest
from clones import edit, planned

from bench.plan import provenance as origins
from bench.store.tables import Tables

ROOT = Path(__file__).parents[2]


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
    look = origins._read
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


def test_a_checkout_that_moved_while_a_sweep_ran_is_said(monkeypatch):
    then = origins._read() | {"dirty": True}
    monkeypatch.setattr(origins, "provenance", lambda: then)
    monkeypatch.setattr(origins, "_read", lambda: dict(then))
    assert origins.moved() == ""
    monkeypatch.setattr(origins, "_read", lambda: then | {"commit": "f" * 40})
    assert f"to {'f' * 10} while the sweep ran" in origins.moved()
    monkeypatch.setattr(origins, "_read", lambda: dict(then))
    monkeypatch.setattr(origins, "provenance", lambda: then | {"dirty": False})
    assert "got changes that are in no commit" in origins.moved()


@pytest.mark.parametrize(
    ("told", "name"),
    [
        (
            "cpu family\t: 25\nmodel\t\t: 1\nmodel name\t: AMD EPYC\n",
            "AMD EPYC (family 25, model 1)",
        ),
        ("model name\t: ARMv8\n", "ARMv8"),
    ],
)
def test_processors_of_one_name_are_told_apart(monkeypatch, told, name):
    monkeypatch.setattr(Path, "read_text", lambda *_, **__: told + told.replace("1", "7"))
    assert origins.processor() == name
