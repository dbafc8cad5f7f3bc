"""The leaderboard: means of what counts, ties as ties, lost runs in sight, names harmless."""

import dataclasses
import math
import re
from pathlib import Path

import pytest
import tables_for_tests
from markdown_it import MarkdownIt
from tables_for_tests import Sheet

from bench.report.leaderboard import COLUMNS, leaderboard_rows, made_by_text, write_leaderboard
from bench.stats.endings import endings
from bench.stats.leaderboard_rows import AXES
from bench.stats.standings import axis_lines, standings
from bench.text import markdown
from bench.text.numbers import number, seconds, significant

KEPT = Path(__file__).parent / "kept" / "leaderboard.md"


def rows_by_method(tables):
    return {(row["task"], row["method"]): row for row in leaderboard_rows(tables)}


@pytest.fixture(scope="module")
def typical():
    return tables_for_tests.typical()


def test_leaderboard_equals_the_kept_copy(typical, tmp_path):
    path = tmp_path / "new" / "leaderboard.md"
    write_leaderboard(typical, path)
    assert path.read_text(encoding="utf-8") == KEPT.read_text(encoding="utf-8")


def test_failed_and_diverged_runs_are_named_and_the_diverged_ones_averaged(typical):
    rows = rows_by_method(typical)
    scratch, affine = rows["spread", "hf_scratch"], rows["spread", "hybrid (affine)"]
    assert (scratch["reward_mean"], scratch["n"], scratch["lost"]) == (-70.5, 2, 1)
    assert scratch["runs"] == "2 ok, 1 failed (seed 2)"
    assert (affine["reward_mean"], affine["n"], affine["lost"]) == ((-80.0 - 9999.0) / 2, 2, 1)
    assert affine["runs"] == "1 ok, 1 diverged (seed 1)"


def test_rows_are_ordered_by_the_settled_reward_and_show_the_whole_one():
    sheet = Sheet().add("late", rewards=(-50.0, -51.0), reward=-100.0, settling_time=4.0)
    sheet.add("early", rewards=(-60.0, -61.0), reward=-70.0, settling_time=0.5)
    late, early = leaderboard_rows(sheet.tables())
    assert (late["method"], late["rank"], late["reward_mean"]) == ("late", 1, -50.5)
    assert (early["method"], early["rank"], early["reward_mean"]) == ("early", 2, -60.5)
    shown = {column.heading: column.text(late) for column in COLUMNS}
    assert shown["settled reward (n)"] == "-50.5 ± 0.7 (n = 2)"
    assert (shown["reward"], shown["settling time [s]"]) == ("-100.0", "4.0")


def test_tables_of_the_first_protocol_are_ordered_by_the_whole_reward():
    sheet = Sheet().add("late", rewards=(-50.0, -51.0), reward=-100.0)
    tables = sheet.add("early", rewards=(-60.0, -61.0), reward=-70.0).tables()
    old = tables.results.loc[tables.results["metric"] != "settled_reward"]
    rows = leaderboard_rows(dataclasses.replace(tables, results=old))
    assert [(row["method"], row["reward_mean"]) for row in rows] == [("early", -70), ("late", -100)]


def test_the_upper_reference_has_a_row_and_takes_no_rank_from_anybody(typical):
    rows = [row for row in leaderboard_rows(typical) if row["task"] == "spread"]
    first = rows[0]
    assert (first["method"], first["n"], first["reward_mean"]) == ("upper_reference", 2, -45.5)
    assert (first["rank"], first["best"], set(first["axis_ranks"].values())) == (
        None,
        False,
        {None},
    )
    assert min(row["rank"] for row in rows[1:]) == 1
    for axis in AXES:
        ranks = sorted(r for row in rows if (r := row["axis_ranks"][axis]) is not None)
        assert all(rank == 1 + sum(r < rank for r in ranks) for rank in ranks)


def test_budget_runs_count_and_are_named(typical):
    row = rows_by_method(typical)["circle", "hf_scratch"]
    assert (row["reward_mean"], row["runs"]) == (-140.0, "1 budget (seed 0)")


def test_methods_that_cannot_be_told_apart_share_a_rank(typical):
    rows = rows_by_method(typical)
    assert rows["spread", "hf_hotstart"]["rank"] == rows["spread", "hybrid (mlp)"]["rank"] == 1
    assert rows["spread", "hybrid (affine)"]["rank"] == 1  # 2 seeds, one of which diverged
    assert rows["spread", "lf_baseline"]["rank"] == 5
    assert rows["spread", "hf_scratch"]["rank"] == 6


def test_one_seed_claims_no_order(typical):
    rows = [row for row in leaderboard_rows(typical) if row["task"] == "circle"]
    assert [row["rank"] for row in rows] == [None, None, None]
    assert [row["reward_mean"] for row in rows] == [-140.0, -150.0, -200.0]
    assert not any(row["best"] for row in rows)


def test_the_document_says_which_programs_made_its_rows_and_where():
    sheet = Sheet().add(rewards=(-1.0, -2.0, -3.0)).add(rewards=(-1.0,), first_seed=3)
    origins = [
        {"commit": 40 * "a", "dirty": False, "machine": "one"},
        {"commit": 40 * "a", "dirty": False, "machine": "one"},
        {"commit": 40 * "a", "dirty": True, "machine": "two"},
        {"commit": "", "dirty": False, "machine": ""},  # from before rows could be traced
    ]
    for run, origin in zip(sheet.runs, origins, strict=True):
        run.update(origin)
    assert made_by_text(sheet.tables()) == (
        "Rows made: 2 of 4 at aaaaaaaaaa on one; 1 of 4 at aaaaaaaaaa with changes on two."
    )
    for run in sheet.runs:
        run.update(origins[-1])
    assert made_by_text(sheet.tables()) == made_by_text(tables_for_tests.empty()) == ""


def test_a_method_whose_runs_all_failed_is_listed_last():
    tables = Sheet().add().add("hf_scratch", rewards=(0.0, 0.0), status="failed").tables()
    row = leaderboard_rows(tables)[-1]
    assert (row["method"], row["n"], row["rank"], row["runs"]) == (
        "hf_scratch",
        0,
        None,
        "2 failed (seed 0, 1)",
    )
    assert math.isnan(row["reward_mean"])


def test_a_run_that_failed_is_listed_only_where_it_was_meant_to_fly():
    sheet = Sheet().add()
    sheet.add("recalibrated", variant="reality=crazyflow+Drag(c=2)", status="failed", cause="x")
    found = endings(sheet.tables())
    ended = {cell.deployed_effects: {e.method for e in entries} for cell, entries in found.items()}
    assert ended == {"": {"lf_baseline"}, "Drag(c=2)": {"recalibrated"}}


def test_a_finished_run_without_a_finite_reward_is_named():
    row = leaderboard_rows(Sheet().add(rewards=(-1.0, math.nan)).tables())[0]
    assert (row["n"], row["runs"]) == (1, "2 ok, no reward from seed 1")


def test_overall_table_counts_ties_as_best(typical):
    found = {s.method: s for s in standings(leaderboard_rows(typical))}
    assert (found["hf_hotstart"].best, found["hybrid (mlp)"].best) == (1, 1)
    assert (found["lf_baseline"].cells, found["lf_baseline"].ranked) == (2, 1)
    assert found["lf_baseline"].mean_rank == 5.0
    assert found["hf_scratch"].lost == 1


def test_no_rows_make_a_leaderboard_that_says_so(tmp_path):
    write_leaderboard(tables_for_tests.empty(), tmp_path / "leaderboard.md")
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    assert "There are no runs in these tables." in text
    assert "|" not in text


def test_hostile_names_are_shown_and_do_nothing(typical, tmp_path):
    write_leaderboard(typical, tmp_path / "leaderboard.md")
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    html = MarkdownIt("commonmark", {"html": True}).enable("table").render(text)
    assert "<script" not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;|x</td>" in html
    widths = {len(re.findall(r"<t[dh][ >]", row)) for row in html.split("<tr>")[1:]}
    assert widths == {5, 8, 16}


@pytest.mark.parametrize(
    "name", ["a|b", "a\nb", "`a`", "[a](javascript:b)", "**a**", "<img src=x>", "a&amp;", "\\|"]
)
def test_escaped_text_is_shown_literally_in_a_table(name):
    text = markdown.table(["x", "y"], [[markdown.escape(name), "1"]])
    html = MarkdownIt("commonmark", {"html": True}).enable("table").render(text)
    cell = re.search(r"<td[^>]*>(.*?)</td>", html).group(1)
    shown = cell.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    assert shown == name.replace("\n", " ")


def test_costs_have_two_significant_digits():
    costs = (0.0, 0.034, 0.5, 6.66, 9.99, 40.0, 193.4, 1234.5, -0.04, math.nan, math.inf)
    assert [significant(cost) for cost in costs] == [
        "0",
        "0.034",
        "0.5",
        "6.7",
        "10",
        "40",
        "193",
        "1234",
        "-0.04",
        "-",
        "-",
    ]


def test_numbers_and_durations_read_well():
    assert [number(x, 1) for x in (math.nan, -0.04, 1.25, -3.0)] == ["-", "0.0", "1.2", "-3.0"]
    assert [seconds(x) for x in (math.nan, 90.0, 600.0, 9000.0)] == [
        "-",
        "90 s",
        "10.0 min",
        "2.5 h",
    ]


def test_every_axis_has_its_own_ranks(typical):
    rows = rows_by_method(typical)
    assert rows["spread", "hybrid (mlp)"]["axis_ranks"]["fleet_minutes"] == 5
    assert rows["spread", "hf_hotstart"]["axis_ranks"]["fleet_minutes"] == 6
    assert rows["spread", "hf_scratch"]["axis_ranks"]["fleet_minutes"] == 1
    assert rows["spread", "hf_scratch"]["axis_ranks"]["training_crashes"] == 6
    assert rows["spread", "hf_scratch"]["axis_ranks"]["crashes"] == 1
    assert rows["circle", "hf_scratch"]["axis_ranks"]["crashes"] is None  # one seed
    lines = {line[0]: line[1:] for line in axis_lines(leaderboard_rows(typical))}
    assert lines["hf_scratch"][:4] == ["0 of 1", "1 of 1", "0 of 1", "1 of 1"]
