"""The leaderboard: means of what counts, ties as ties, lost runs in sight, names harmless."""

import math
import re
from pathlib import Path

import pytest
import tables_for_tests
from markdown_it import MarkdownIt
from tables_for_tests import SPAWN_SETTLED, Sheet

from bench.report.leaderboard import (
    COLUMNS,
    VARIANT_COLUMNS,
    filled,
    leaderboard_rows,
    made_by_text,
    split,
    write_leaderboard,
)
from bench.report.standings import axis_lines, standings
from bench.stats.leaderboard_rows import AXES
from bench.stats.statistics import difference, endings
from bench.text import markdown
from bench.text.numbers import measured, number, places, seconds, significant

KEPT = Path(__file__).parent / "kept" / "leaderboard.md"


def rows_by_method(tables):
    return {(row["cell"].task, row["method"]): row for row in leaderboard_rows(tables)}


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
    assert (late["method"], late["rank"].text, late["reward_mean"]) == ("late", "1", -50.5)
    assert (early["method"], early["rank"].text, early["reward_mean"]) == ("early", "2", -60.5)
    shown = {column.heading: column.text(late) for column in COLUMNS}
    assert shown["settled reward (n)"] == "-50 ± 1 (n = 2)"
    assert (shown["reward"], shown["settling time [s]"]) == ("-100", "4")


def test_the_upper_reference_has_a_row_and_takes_no_rank_from_anybody(typical):
    rows = [row for row in leaderboard_rows(typical) if row["cell"].task == "spread"]
    first = rows[0]
    assert (first["method"], first["n"], first["reward_mean"]) == ("upper_reference", 2, -45.5)
    assert (first["rank"], first["best"], {*first["axis_ranks"].values()} - {None}) == (
        None,
        False,
        set(),
    )
    ranks = [row["rank"] for row in rows if row["rank"]]
    assert [rank.place for rank in ranks] == list(range(1, len(ranks) + 1))
    for axis in AXES:
        places = [r.place for row in rows if (r := row["axis_ranks"].get(axis)) is not None]
        assert sorted(places) == list(range(1, len(places) + 1))


def test_budget_runs_count_and_are_named(typical):
    row = rows_by_method(typical)["circle", "hf_scratch"]
    assert (row["reward_mean"], row["runs"]) == (-140.0, "1 budget (seed 0)")


def test_methods_that_are_not_separated_share_a_letter_and_scatter_earns_no_rank(typical):
    rows = rows_by_method(typical)
    shown = {
        method: (row["rank"].text, row["rank"].ties)
        for (task, method), row in rows.items()
        if task == "spread" and row["rank"]
    }
    assert shown == {
        "hf_hotstart": ("1 to 2", "a"),
        "hybrid (mlp)": ("1 to 2", "a"),
        "lf_baseline": ("3", "b"),
        "hf_scratch": ("4 to 5", "c"),
        "hybrid (affine)": ("4 to 5", "a,b,c"),  # 2 seeds, one of which diverged
    }
    text = {c.heading: c.text(rows["spread", "hybrid (affine)"]) for c in COLUMNS}
    assert (
        text["behind the best"] == "5000 (-58000 to 68000)"
    )  # how far it may lie, and that is far


def test_settings_other_than_the_default_stand_apart_beside_their_default(typical):
    (columns, ranked), (others, variants) = split(leaderboard_rows(typical))
    assert (columns, others) == (COLUMNS, VARIANT_COLUMNS)
    assert all(row["default"] is None for row in ranked)
    (row,) = variants
    assert (row["method"], row["rank"]) == ("hybrid (mlp), observe_attitude=true", None)
    # Differences 0.5, 4.1 and 0.9 by seed.
    assert row["beside_default"].mean == pytest.approx(-5.5 / 3.0)
    text = {c.heading: c.text(row) for c in VARIANT_COLUMNS}
    assert text["above its default"] == "-2 (-7 to 3)"


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


def test_columns_in_which_nobody_has_anything_are_left_out(typical):
    rows = [row for row in leaderboard_rows(typical) if row["cell"].task == "circle"]
    shown = [column.heading for column in filled(COLUMNS, rows)]
    assert not {"rank", "ties", "95 % t-interval", "behind the best"} & set(shown)
    assert "settled reward (n)" in shown


def test_one_seed_claims_no_order(typical):
    rows = [row for row in leaderboard_rows(typical) if row["cell"].task == "circle"]
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


def test_overall_table_says_how_far_a_tie_may_be_off():
    sheet = Sheet().add_upper(-40.0)
    sheet.add("a", rewards=(-50.0, -51.0, -52.5)).add("b", rewards=(-50.5, -50.9, -53.1))
    sheet.add("c", rewards=(-55.0, -59.0, -450.0)).add("d", rewards=(-60.0, -61.0, -62.0))
    found = {s.method: s for s in standings(leaderboard_rows(sheet.tables()))}
    assert list(found) == ["a", "b", "d", "c"]  # and the upper reference competes with nobody
    assert [(s.best, s.tied, s.may_be_first) for s in found.values()] == [
        (1, 0, 1),
        (0, 1, 1),
        (0, 0, 0),
        (0, 1, 0),  # not separated, and no candidate for the first rank
    ]
    scale = -40.0 - SPAWN_SETTLED
    ends = difference(
        dict(enumerate((-50.0, -51.0, -52.5))), dict(enumerate((-55.0, -59.0, -450.0)))
    )
    assert found["c"].behind == pytest.approx(ends.high / scale)
    assert found["c"].behind > 0.5 > 0.01 > found["b"].behind > 0.0


def test_overall_table_counts_cells_and_lost_runs(typical):
    found = {s.method: s for s in standings(leaderboard_rows(typical))}
    assert (found["hf_hotstart"].best, found["hybrid (mlp)"].tied) == (1, 1)
    assert (found["lf_baseline"].cells, found["lf_baseline"].ranked) == (2, 1)
    assert found["lf_baseline"].place == 3.0
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
    assert widths == {7, 8, 14, 16, 18}


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


def test_every_axis_has_its_own_ranks(typical):
    ranks = {
        method: {axis: rank.first for axis, rank in row["axis_ranks"].items() if rank}
        for (task, method), row in rows_by_method(typical).items()
        if task == "spread" and row["rank"]
    }
    assert ranks["hybrid (mlp)"]["fleet_minutes"] == 4
    assert ranks["hf_hotstart"]["fleet_minutes"] == 5
    assert ranks["hf_scratch"]["fleet_minutes"] == 1
    assert ranks["hf_scratch"]["training_crashes"] == 5
    assert ranks["hf_scratch"]["crashes"] == 1
    circle = rows_by_method(typical)["circle", "hf_scratch"]
    assert not {*circle["axis_ranks"].values()} - {None}  # one seed
    lines = {line[0]: line[1:] for line in axis_lines(leaderboard_rows(typical))}
    assert lines["hf_scratch"][:4] == ["0 of 1", "1 of 1", "0 of 1", "1 of 1"]
