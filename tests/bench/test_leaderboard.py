"""The leaderboard: means of what counts, ties as ties, lost runs in sight, names harmless."""

import math
import re
from pathlib import Path

import pytest
import tables_for_tests
from markdown_it import MarkdownIt
from tables_for_tests import Sheet

from bench.report.leaderboard import (
    COLUMNS,
    leaderboard_rows,
    made_by_text,
    write_leaderboard,
)
from bench.stats.statistics import endings
from bench.text import markdown
from bench.text.numbers import measured, number, places, seconds, significant

KEPT = Path(__file__).parent / "kept" / "leaderboard.md"


@pytest.fixture(scope="module")
def typical():
    return tables_for_tests.typical()


def test_leaderboard_equals_the_kept_copy(typical, tmp_path):
    path = tmp_path / "new" / "leaderboard.md"
    write_leaderboard(typical, path)
    assert path.read_text(encoding="utf-8") == KEPT.read_text(encoding="utf-8")


def test_rows_are_ordered_by_the_settled_reward_and_show_the_whole_one():
    sheet = Sheet().add("late", rewards=(-50.0, -51.0), reward=-100.0, settling_time=4.0)
    sheet.add("early", rewards=(-60.0, -61.0), reward=-70.0, settling_time=0.5)
    late, early = leaderboard_rows(sheet.tables())
    assert (late["method"], late["rank"].text, late["reward"].mean) == ("late", "1", -50.5)
    assert (early["method"], early["rank"].text, early["reward"].mean) == ("early", "2", -60.5)
    shown = {column.heading: column.text(late) for column in COLUMNS}
    assert shown["settled reward (n)"] == "-50 ± 1 (n = 2)"
    assert (shown["reward"], shown["settling time [s]"]) == ("-100", "4")


def test_a_world_in_a_variant_is_no_other_setting():
    sheet = Sheet().add("hybrid", "mlp", rewards=(-50.0, -51.0))
    here = "deployed_in=crazyflow+Drag(c=2)"
    before = len(sheet.results)
    sheet.add("hybrid", "mlp", variant=here, rewards=(-60.0, -61.0))
    sheet.add("hybrid", "mlp", variant=f"{here}, tracked=true", rewards=(-70.0, -71.5))
    for row in sheet.results[before:]:
        row["deployed_effects"] = "Drag(c=2)"
    rows = {row["entry"].variant: row for row in leaderboard_rows(sheet.tables())}
    assert rows[here]["rank"].text == "1"
    assert rows[f"{here}, tracked=true"]["rank"] is None
    assert rows[f"{here}, tracked=true"]["beside_default"].mean == pytest.approx(-10.25)


def test_what_another_run_trained_has_no_rank_on_costs_of_training():
    here = "reality=crazyflow+Drag(c=2)"
    sheet = Sheet().add("hybrid", "mlp", variant=here, rewards=(-50.0, -51.0), fleet_minutes=0.5)
    sheet.add("lf_baseline", variant=here.replace("reality", "deployed_in"), rewards=(-60.0, -61.0))
    sheet.add("hf_scratch", variant=here, rewards=(-60.0, -61.0), fleet_minutes=9.0)
    for row in sheet.results:
        row["deployed_effects"] = "Drag(c=2)"
    rows = {row["entry"].method: row for row in leaderboard_rows(sheet.tables())}
    assert rows["lf_baseline"]["rank"] is not None
    found = {method: row["axis_ranks"]["fleet_minutes"] for method, row in rows.items()}
    assert (found["hybrid"].first, found["lf_baseline"]) == (1, None)
    assert rows["lf_baseline"]["axis_ranks"]["crashes"] is not None


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
    assert (row["method"], row["reward"].n, row["rank"], row["runs"]) == (
        "hf_scratch",
        0,
        None,
        "2 failed (seed 0, 1)",
    )
    assert math.isnan(row["reward"].mean)


def test_a_run_that_failed_is_listed_only_where_it_was_meant_to_fly():
    sheet = Sheet().add()
    sheet.add("recalibrated", variant="reality=crazyflow+Drag(c=2)", status="failed", cause="x")
    found = endings(sheet.tables())
    ended = {cell.deployed_effects: {e.method for e in entries} for cell, entries in found.items()}
    assert ended == {"": {"lf_baseline"}, "Drag(c=2)": {"recalibrated"}}


def test_a_finished_run_without_a_finite_reward_is_named():
    row = leaderboard_rows(Sheet().add(rewards=(-1.0, math.nan)).tables())[0]
    assert (row["reward"].n, row["runs"]) == (1, "2 ok, no reward from seed 1")


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
    assert widths == {12, 14, 16}


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


def test_numbers_have_the_digits_that_their_intervals_allow():
    halves = (0.00035, 0.00036, 0.02, 0.0354, 0.036, 0.094, 0.97, 3.5, 20.0, 5e6, math.nan, 0.0)
    assert [places(half) for half in halves] == [5, 4, 3, 3, 2, 2, 1, 1, 0, -5, 1, 1]
    assert measured(2.345, 1.1, 3.6) == "2.3 (1.1 to 3.6)"
    assert measured(0.00121, 0.00078, 0.00166) == "0.0012 (0.0008 to 0.0017)"
    assert measured(0.6789, math.nan, math.nan) == "0.679"
    assert measured(math.nan, math.nan, math.nan) == "-"
