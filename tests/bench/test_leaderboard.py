"""The leaderboard: means of what counts, ties as ties, lost runs in sight, names harmless."""

import math
import re
from pathlib import Path

import pytest
import tables_for_tests
from markdown_it import MarkdownIt
from tables_for_tests import Sheet

from bench import markdown
from bench.endings import endings
from bench.leaderboard import leaderboard_rows, write_leaderboard
from bench.numbers import number, seconds
from bench.standings import axis_lines, standings

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


def test_failed_and_diverged_runs_are_named_and_never_averaged(typical):
    rows = rows_by_method(typical)
    scratch, affine = rows["spread", "hf_scratch"], rows["spread", "hybrid (affine)"]
    assert (scratch["reward_mean"], scratch["n"], scratch["lost"]) == (-70.5, 2, 1)
    assert scratch["runs"] == "2 ok, 1 failed (seed 2)"
    assert (affine["reward_mean"], affine["n"], affine["lost"]) == (-80.0, 1, 1)
    assert affine["runs"] == "1 ok, 1 diverged (seed 1)"


def test_budget_runs_count_and_are_named(typical):
    row = rows_by_method(typical)["circle", "hf_scratch"]
    assert (row["reward_mean"], row["runs"]) == (-140.0, "1 budget (seed 0)")


def test_methods_that_cannot_be_told_apart_share_a_rank(typical):
    rows = rows_by_method(typical)
    assert rows["spread", "hf_hotstart"]["rank"] == rows["spread", "hybrid (mlp)"]["rank"] == 1
    assert rows["spread", "lf_baseline"]["rank"] == 4
    assert rows["spread", "hf_scratch"]["rank"] == 5


def test_one_seed_claims_no_order(typical):
    rows = [row for row in leaderboard_rows(typical) if row["task"] == "circle"]
    assert [row["rank"] for row in rows] == [None, None, None]
    assert [row["reward_mean"] for row in rows] == [-140.0, -150.0, -200.0]
    assert not any(row["best"] for row in rows)


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
    assert found["lf_baseline"].mean_rank == 4.0
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
    assert widths == {5, 8, 14}


@pytest.mark.parametrize(
    "name", ["a|b", "a\nb", "`a`", "[a](javascript:b)", "**a**", "<img src=x>", "a&amp;", "\\|"]
)
def test_escaped_text_is_shown_literally_in_a_table(name):
    text = markdown.table(["x", "y"], [[markdown.escape(name), "1"]])
    html = MarkdownIt("commonmark", {"html": True}).enable("table").render(text)
    cell = re.search(r"<td[^>]*>(.*?)</td>", html).group(1)
    shown = cell.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    assert shown == name.replace("\n", " ")


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
    assert rows["spread", "hybrid (mlp)"]["axis_ranks"]["fleet_minutes"] == 4
    assert rows["spread", "hf_hotstart"]["axis_ranks"]["fleet_minutes"] == 5
    assert rows["spread", "hf_scratch"]["axis_ranks"]["fleet_minutes"] == 1
    assert rows["spread", "hf_scratch"]["axis_ranks"]["training_crashes"] == 5
    assert rows["spread", "hf_scratch"]["axis_ranks"]["crashes"] == 1
    assert rows["spread", "hybrid (affine)"]["axis_ranks"]["crashes"] is None  # one seed
    lines = {line[0]: line[1:] for line in axis_lines(leaderboard_rows(typical))}
    assert lines["hf_scratch"][:4] == ["0 of 1", "1 of 1", "0 of 1", "1 of 1"]
