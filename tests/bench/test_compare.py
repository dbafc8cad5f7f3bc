"""`bench compare`: the answer, what it rests on, and the exit status."""

import itertools
import json
import re

import numpy as np
import pandas as pd
import pytest
from tables_for_tests import SPAWN_SETTLED, Sheet

from bench.cli.app import main
from bench.report.leaderboard import write_leaderboard
from bench.stats.compare import Side, compare, load_side
from bench.stats.pooled import pools
from bench.stats.statistics import Entry
from bench.stats.verdicts import Verdict
from bench.store.tables import Tables
from bench.text.errors import UsageError
from bench.text.numbers import measured

GOOD, BAD = (-50.0, -51.0, -52.5), (-60.0, -61.5, -62.0)


def sides(sheet, a="good", b="bad"):
    tables = sheet.tables() if isinstance(sheet, Sheet) else sheet
    return [Side(name, tables, Entry(name)) for name in (a, b)]


def both(**cell):
    return Sheet().add("good", rewards=GOOD, **cell).add("bad", rewards=BAD, **cell)


def two_cells():
    sheet = both().add_upper().add_upper(team_size=12)
    sheet.add("good", rewards=BAD, team_size=12).add(
        "bad", rewards=(-80.0, -82.0, -81.0), team_size=12
    )
    return sheet


def other_seeds(*team_sizes):
    """Tables of two cells; with these team sizes the two methods share no seed."""
    sheet = Sheet()
    for n in (3, 12):
        sheet.add_upper(team_size=n).add("good", rewards=GOOD, team_size=n)
        sheet.add("bad", rewards=BAD, team_size=n, first_seed=100 if n in team_sizes else 0)
    return sheet


def test_one_cell_is_decided_by_the_t_interval_of_settled_rewards():
    found = compare(*sides(both()))
    assert found.verdict is Verdict.SUPPORTED
    assert "Settled reward -51.2 ± 1.3 (n = 3) against -61.2 ± 1.0 (n = 3)" in found.lines[0]
    assert "t-interval" in found.lines[0]
    assert compare(*sides(both())[::-1]).verdict is Verdict.REFUTED


def test_the_means_that_are_shown_are_of_the_seeds_that_are_compared():
    sheet = Sheet().add("good", rewards=(-9.0, -9.11)).add("bad", rewards=(-10.0, -10.1, -1.0))
    found = compare(*sides(sheet))
    assert found.verdict is Verdict.SUPPORTED
    assert "-9.1 ± 0.1 (n = 2) against -10.1 ± 0.1 (n = 2): difference 1.0" in found.lines[0]


def test_several_cells_are_decided_by_pooled_scores():
    found = compare(*sides(two_cells()))
    assert found.verdict is Verdict.SUPPORTED
    apart = np.mean([np.mean(GOOD) - np.mean(BAD), np.mean(BAD) + 81.0]) / (-40.0 - SPAWN_SETTLED)
    assert found.lines[0].startswith(f"Score higher by {apart:.4f} (0.0155 to 0.0192), mean over ")
    assert found.lines[0].endswith("(3 seeds).")
    assert "Probability that a run of the first is better: 1.00, 95 %" in found.lines[1]
    assert "2 cells: spread, N = 3; spread, N = 12, 3 seeds of good, 3 seeds" in found.lines[2]
    assert compare(*sides(two_cells())[::-1]).verdict is Verdict.REFUTED


def test_cells_that_have_no_score_are_left_out_and_those_without_common_seeds_unpaired():
    sheet = two_cells().add("good", task="own", rewards=GOOD).add("bad", task="own", rewards=BAD)
    found = compare(*sides(sheet))
    assert found.lines[:2] == compare(*sides(two_cells())).lines[:2]
    assert "Left out, because without an upper reference there is no score: own, N = 3." in (
        found.lines
    )
    found = compare(*sides(other_seeds(12)))
    assert found.verdict is Verdict.SUPPORTED
    assert "(6 seeds)" in found.lines[0]
    assert found.lines[2].startswith("Compared in 2 cells: spread, N = 3; spread, N = 12, ")
    assert compare(*sides(other_seeds(3, 12))).verdict is Verdict.SUPPORTED


def test_a_lost_seed_does_not_make_a_method_better_in_several_cells():
    """Both are the same; the one that lost its hardest seeds is not the better one."""
    sheet = Sheet()
    for team_size in (3, 5, 7, 9, 12):
        sheet.add_upper(team_size=team_size)
        sheet.add("good", rewards=(-50.0, -51.0, -52.0), team_size=team_size)
        sheet.add("bad", rewards=(-50.1, -50.9, -52.0, -90.0, -95.0), team_size=team_size)
    found = compare(*sides(sheet))
    assert found.verdict is Verdict.UNDECIDED
    assert found.lines[0].startswith("Score higher by 0.00000 (")
    assert found.lines[0].endswith("(3 seeds).")
    better, fewer = Sheet(), Sheet()  # all seeds of the other one would make it better
    for team_size in (3, 5, 7, 9, 12):
        for sheet, seeds in ((better, 8), (fewer, 3)):
            rewards = (-50.1, -50.9, -52.0, *(-90.0,) * 5)
            sheet.add("bad", rewards=rewards, team_size=team_size).add_upper(team_size=team_size)
            own = (-50.0, -51.0, -52.0, *(-5.0,) * 5)
            sheet.add("good", rewards=own[:seeds], team_size=team_size)
    assert compare(*sides(better)).verdict is Verdict.SUPPORTED
    assert compare(*sides(fewer)).verdict is Verdict.UNDECIDED


def test_compare_and_the_leaderboard_give_one_number_for_one_comparison(tmp_path):
    """Although one method lacks a cell, another one lost a seed, and a run diverged."""
    rng = np.random.default_rng(3)
    names = ("first", "second", "third", "fourth")
    sheet = Sheet()
    for team_size in (3, 5, 7, 9, 12):
        sheet.add_upper(team_size=team_size)
        for place, name in enumerate(names):
            lost = (name, team_size) == ("second", 5)
            if (name, team_size) != ("third", 3):
                rewards = rng.normal(-60.0 - place, 1.5, 4 - lost)
                sheet.add(name, rewards=rewards, first_seed=lost, team_size=team_size)
            if lost:
                sheet.add(name, status="failed", team_size=team_size)
    sheet.add("fourth", rewards=(-300.0,), first_seed=4, status="diverged")
    tables = sheet.tables()
    (pool,) = pools(tables)
    assert (len(pool.cells), len(pool.rows)) == (4, 4)
    write_leaderboard(tables, tmp_path / "leaderboard.md")
    board, _, text = (tmp_path / "leaderboard.md").read_text().partition("probability that a run")
    lines = [line.strip("| ").split(" | ") for line in text.partition("\n\n")[0].splitlines()]
    shown = {name: [x.replace("\\*", "*") for x in numbers] for name, *numbers in lines[2:]}
    entries = [row.entry for row in pool.rows]
    for (i, one), (j, other) in itertools.permutations(enumerate(entries), 2):
        found = compare(Side("a", tables, one), Side("b", tables, other))
        (line,) = [line for line in found.lines if line.startswith("Probability")]
        p = r"(\d\.\d\d)"
        numbers = rf"better: {p}, 95 % percentile-bootstrap interval {p} to {p}\."
        value, low, high = map(float, re.search(numbers, line).groups())
        assert value == pytest.approx(pool.improvement[i][j].value, abs=0.0051)
        assert shown[one.label][j].rstrip("*") == f"{value:.2f}"
        if i == 0:  # the board's distance from the first is the difference that decides here
            behind = pool.rows[j].behind
            said = measured(behind.mean, behind.low, behind.high)
            assert found.lines[0].startswith(f"Score higher by {said}, mean over cells")
            assert f"| {other.label} |" in board
            assert f" | {said} | " in board.partition(f"| {other.label} |")[2].partition("\n")[0]
            assert (found.verdict is Verdict.SUPPORTED) == (behind.low > 0.0)
        if i < j:  # the other way round is the same interval from 1 downwards
            assert (low, high) == pytest.approx(pool.improvement[i][j][1:], abs=0.0051)
            assert shown[one.label][j].endswith("*") == (high < 0.5 or low > 0.5)


def test_what_the_seeds_do_not_decide_is_no_difference():
    sheet = Sheet().add("good", rewards=(-50.0, -58.0)).add("bad", rewards=(-52.0, -55.0))
    assert compare(*sides(sheet)).verdict is Verdict.UNDECIDED
    assert compare(*sides(both(), "good", "good")).verdict is Verdict.UNDECIDED
    assert compare(*sides(two_cells(), "bad", "bad")).verdict is Verdict.UNDECIDED


def changed(tables, about, **columns):
    """Tables in which the runs of `about` have other records."""
    runs = tables.runs.copy()
    for name, content in columns.items():
        runs.loc[runs["method"] == about, name] = json.dumps(content)
    return Tables(tables.results, tables.curves, tables.trajectories, runs)


@pytest.mark.parametrize(
    ("tables", "reason"),
    [
        (
            Sheet().add("good", rewards=GOOD).add("bad", task="circle", rewards=BAD).tables(),
            "they have no cell in common",
        ),
        (Sheet().add("good", rewards=GOOD).add("bad").tables(), "share 1 cells, none with 2 seeds"),
        (
            Sheet().add("good", rewards=GOOD).add("bad", rewards=BAD, status="failed").tables(),
            "they have no cell in common",
        ),
        (
            changed(both().tables(), "bad", settings={"task": {"horizon": 400}}),
            "on spread, N = 3, the task's `horizon` is missing against 400",
        ),
        (
            changed(both().tables(), "bad", versions={"simulator crazyflow": "2"}),
            "version of simulator crazyflow is missing against 2",
        ),
        (
            both().add("good", task="own", rewards=GOOD).add("bad", task="own", rewards=BAD),
            "without an upper reference there is no score: 2 cells: own, N = 3; spread, N = 3.",
        ),
    ],
)
def test_what_cannot_be_compared_is_refused_with_the_reason(tables, reason):
    found = compare(*sides(tables))
    assert found.verdict is Verdict.UNTESTED
    assert reason in found.lines[0]


def test_other_axes_and_lost_runs_stand_beside_the_answer():
    sheet = Sheet().add("good", rewards=GOOD, fleet_minutes=40.0, crashes=3.0)
    sheet.add("bad", rewards=BAD, fleet_minutes=400.0)
    sheet.add("bad", rewards=(-1.0,), first_seed=3, status="failed")
    lines = "\n".join(compare(*sides(sheet)).lines)
    assert "Failed or diverged: 0 of good, 1 of bad." in lines
    assert (
        "HF fleet-minutes: 40 against 400 (means over cells); lower in 1, higher in 0 of 1" in lines
    )
    assert "Crashes per episode: 3 against 1 (means over cells); lower in 0, higher in 1" in lines


def test_diverged_runs_count_with_the_policy_that_they_left():
    sheet = Sheet().add("good", rewards=GOOD).add("bad", rewards=BAD, status="diverged")
    found = compare(*sides(sheet))
    assert found.verdict is Verdict.SUPPORTED
    assert "against -61.2 ± 1.0 (n = 3)" in found.lines[0]
    assert "Failed or diverged: 0 of good, 3 of bad." in found.lines


def test_folders_are_compared_entry_by_entry_without_the_upper_reference():
    old, new = (two_cells().add_upper(first_seed=1).tables() for _ in range(2))
    better = new.results["metric"].eq("settled_reward") & new.results["method"].eq("bad")
    results = new.results.assign(value=new.results["value"].mask(better, -40.0))
    new = Tables(results, new.curves, new.trajectories, new.runs)
    found = compare(Side("new", new, None), Side("old", old, None))
    assert "4 cells: spread, N = 3 (good); spread, N = 3 (bad)" in "\n".join(found.lines)
    assert found.verdict is Verdict.SUPPORTED
    assert not any("upper_reference" in line for line in found.lines)
    assert compare(Side("old", old, None), Side("old", old, None)).verdict is Verdict.UNDECIDED
    mixed = compare(Side("new", new, None), Side("old", old, Entry("good")))
    assert mixed.verdict is Verdict.UNTESTED


def test_the_command_ends_with_a_status_of_its_own_for_each_answer(tmp_path, capsys):
    tied = (-61.0, -60.5, -62.5)
    sheet = both().add("alike", rewards=tied).add("hybrid", "mlp", rewards=GOOD)
    sheet.add("lonely").tables().save(tmp_path / "without")
    sheet.add_upper().tables().save(tmp_path)
    there = ("--results", str(tmp_path))
    assert main(["compare", "good", "bad", *there]) == 0
    assert "good is better than bad." in capsys.readouterr().out
    assert main(["compare", "bad", "hybrid-mlp", *there]) == 3
    assert main(["compare", "bad", "alike", *there]) == 4
    assert main(["compare", "hybrid (mlp)", "lonely", *there]) == 5
    assert main(["compare", str(tmp_path), str(tmp_path)]) == 4
    assert main(["compare", *2 * [str(tmp_path / "without")]]) == 5
    capsys.readouterr()
    assert main(["compare", "god", "bad", *there]) == 2
    assert "Did you mean 'good'?" in capsys.readouterr().err


def test_a_side_is_a_folder_an_entry_or_both(tmp_path):
    tables = both().tables()
    tables.save(tmp_path)
    assert load_side(str(tmp_path), None).entry is None
    assert load_side(f"{tmp_path}:good", None).entry == Entry("good")
    colon = tmp_path / "C:results"
    tables.save(colon)
    assert load_side(str(colon), None).entry is None
    assert load_side("good", tmp_path).entry == Entry("good")
    with pytest.raises(UsageError, match=r"'good' is no folder\. Name one: FOLDER:METHOD"):
        load_side("good", None)
    assert isinstance(load_side("good", tmp_path).tables.results, pd.DataFrame)


def test_the_upper_reference_is_compared_in_one_cell_alone():
    sheet = two_cells().add_upper(first_seed=1).add_upper(first_seed=1, team_size=12)
    found = compare(*sides(sheet, b="upper_reference"))
    assert found.verdict is Verdict.UNTESTED
    assert "upper_reference defines what a score of 1 is" in found.lines[0]
    assert "to compare over 2 cells" in found.lines[0]
