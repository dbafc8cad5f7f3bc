"""`bench run --against DIR`: own rows beside those of another folder, which stays as it is."""

import json

import pytest
from clones import files
from tables_for_tests import Sheet

from bench.cli.app import main
from bench.stats.against import beside
from bench.store.tables import Tables


def theirs():
    sheet = Sheet().add_upper(-40.0)
    sheet.add("lf_baseline", rewards=(-50.0, -51.0, -52.0))
    sheet.add("hybrid", "mlp", rewards=(-45.0, -46.0, -47.0))
    return sheet.add("hybrid", "mlp", task="circle", rewards=(-5.0, -6.0))


def renamed(sheet):
    """Tables whose runs have names of their own."""
    for rows in (sheet.results, sheet.runs):
        for row in rows:
            row["run"] = f"own-{row['run']}"
    return sheet.tables()


def methods(tables):
    return {(row.method, row.task, row.seed) for row in tables.runs.itertuples()}


def test_own_rows_stand_beside_those_of_the_same_cell_alone():
    own = renamed(Sheet().add("mine", rewards=(-44.0, -45.0)))
    found = beside(own, theirs().tables(), "paper")
    assert {m for m, _, _ in methods(found.tables)} == {
        *("mine", "lf_baseline", "hybrid", "upper_reference"),
    }
    assert {task for _, task, _ in methods(found.tables)} == {"spread"}
    assert found.remarks == ("Beside 7 runs of paper, in spread, N = 3.",)
    assert set(found.tables.results["run"]) <= set(found.tables.runs["run"])


def test_what_both_trained_is_shown_as_the_other_folder_has_it():
    own = renamed(Sheet().add("mine", rewards=(-44.0, -45.0)).add(rewards=(-99.0, -98.0)))
    found = beside(own, theirs().tables(), "paper")
    values = found.tables.results
    kept = values.loc[
        values["method"].eq("lf_baseline") & values["metric"].eq("settled_reward"), "value"
    ]
    assert sorted(kept) == [-52.0, -51.0, -50.0]
    assert found.remarks[-1] == "Where both have a run, that of paper is shown: lf_baseline."


def test_one_seed_gets_a_description_and_no_claim():
    found = beside(renamed(Sheet().add("mine")), theirs().tables(), "paper")
    assert found.remarks[-1].startswith("One seed says what happened once")


def test_a_cell_that_the_others_lack_is_named():
    own = Sheet().add("mine", team_size=7, rewards=(-4.0, -5.0))
    own = renamed(own.add("mine", rewards=(-44.0, -45.0)))
    found = beside(own, theirs().tables(), "paper")
    assert "Nothing of paper to compare with: spread, N = 7." in found.remarks
    assert ("mine", 7) in {(r.method, r.team_size) for r in found.tables.runs.itertuples()}


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [
        ("settings", {"task": {"horizon": 9}}, "the task's `horizon` is 9 here and 500 there"),
        ("versions", {"task spread": "3"}, "version of task spread is 3 here and 2 there"),
    ],
)
def test_other_versions_and_settings_are_not_compared(column, value, reason):
    sheets = (Sheet().add("mine", rewards=(-44.0, -45.0)), theirs())
    for sheet in sheets:
        for row in sheet.runs:
            row["settings"] = json.dumps({"task": {"horizon": 500, "n_drones": 3}})
            row["versions"] = json.dumps({"task spread": "2"})
    for row in sheets[0].runs:
        row[column] = json.dumps(json.loads(row[column]) | value)
    found = beside(renamed(sheets[0]), sheets[1].tables(), "paper")
    assert found.remarks == (f"Not comparable: spread, N = 3: {reason}.",)
    assert {m for m, _, _ in methods(found.tables)} == {"mine"}


def test_nothing_of_the_other_folder_changes_and_own_tables_hold_own_rows(
    sweep, write_suite, tmp_path, out, capsys
):
    assert sweep()[0] == 0
    before = files(out)
    mine = tmp_path / "mine"
    suite = str(write_suite("instant", "child", "dying", seeds=2))
    asked = ["run", suite, "--method", "dying", "--out", str(mine), "--jobs", "1"]
    assert main([*asked, "--against", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"Beside 4 runs of {out}, in spread, N = 2." in said
    assert files(out) == before
    assert set(Tables.load(mine).runs["method"]) == {"dying"}


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--against", "nowhere"], "nowhere"),
        (["--against", "{out}", "--out", "{out}"], "--out and --against are both"),
    ],
)
def test_a_wrong_request_runs_nothing(sweep, out, capsys, more, message):
    sweep()
    assert main(["run", *(text.format(out=out) for text in more)]) == 2
    assert message in capsys.readouterr().err


def test_the_suite_is_the_one_that_the_other_folder_is_named_after(sweep, out, capsys):
    sweep()
    named = out.rename(out.with_name("quick"))
    wrong = ["run", "--against", str(named), "--method", "nobody", "--out", str(out)]
    assert main(wrong) == 2
    assert "nobody" in capsys.readouterr().err
