"""Scores and pools: what 0 and 1 mean, who is pooled with whom, what is left out and why."""

import math

import pandas as pd
import pytest
from markdown_it import MarkdownIt
from tables_for_tests import SPAWN_SETTLED, Sheet

from bench.report.leaderboard import write_leaderboard
from bench.report.page import write_report
from bench.report.pictures.pooled import pooled_panels
from bench.report.pooled_text import improvement_lines, pool_lines, pool_remarks
from bench.stats.pooled import pools
from bench.stats.scores import (
    PRIMARY,
    STEADY,
    fallen_references,
    scored,
    steadied_references,
    upper_returns,
)
from bench.stats.statistics import Cell, Entry
from bench.store.tables import Tables
from methods.training.evaluate import standing_rewards, takeoff_steps
from tasks.circle import Circle


def two_cells(**others):
    """`hf_hotstart` is best, `hybrid (mlp)` ties with it, `lf_baseline` is worst."""
    sheet = Sheet()
    for team_size, base in ((3, 0.0), (12, -20.0)):
        cell = {"team_size": team_size, **others}
        sheet.add_upper(base - 40.0, **cell)
        sheet.add("lf_baseline", rewards=(base - 60.0, base - 61.0, base - 62.0), **cell)
        sheet.add("hf_hotstart", rewards=(base - 50.0, base - 51.0, base - 52.5), **cell)
        sheet.add("hybrid", "mlp", rewards=(base - 50.5, base - 50.9, base - 53.1), **cell)
    return sheet


def test_the_return_at_the_spawn_is_what_a_hand_computes():
    task = Circle(n_drones=3)
    found = standing_rewards(task, seed=0)
    # On the ground 1 m below its ring a drone has |offset| = 1 m but for jitter, |v* - v| = 1 m/s.
    assert found.sum(axis=1).mean() == pytest.approx(-500.0 * (1.0 + 0.5 * 1.0), rel=0.01)
    settled = found[:, takeoff_steps(task) :].sum(axis=1).mean()
    assert settled == pytest.approx(-400.0 * (1.0 + 0.5 * 1.0), rel=0.01)


def test_a_score_is_0_at_the_spawn_and_1_at_the_upper_reference():
    middle = 0.5 * (SPAWN_SETTLED - 40.0)
    sheet = Sheet().add_upper(-40.0).add(rewards=(SPAWN_SETTLED, -40.0, middle, -40.0 + 86.0))
    found = scored(sheet.tables())
    assert found["value"].tolist() == pytest.approx([0.0, 1.0, 0.5, 1.1])
    assert set(found["metric"]) == {"score"}
    assert set(found["method"]) == {"lf_baseline"}  # the reference competes with nobody


def test_the_zero_of_a_score_is_that_of_its_own_run():
    """Of other settings of a task, say, whose return at the spawn is another one."""
    sheet = Sheet().add_upper(-40.0).add(rewards=(-100.0,))
    sheet.add(rewards=(-100.0,), first_seed=1, spawn_settled_reward=-160.0)
    sheet.add(rewards=(-100.0,), first_seed=2, spawn_settled_reward=math.nan)
    assert scored(sheet.tables())["value"].tolist() == pytest.approx([800.0 / 860.0, 0.5])


def test_the_upper_reference_is_the_mean_of_its_seeds_in_the_same_cell():
    sheet = Sheet().add_upper(-40.0).add_upper(-50.0, first_seed=1)
    sheet.add_upper(-1.0, variant="observe_attitude=true").add_upper(-2.0, team_size=12)
    sheet.add(rewards=(-45.0,)).add(task="circle", rewards=(-45.0,))
    tables = sheet.tables()
    assert upper_returns(tables) == {Cell("spread", 3): -45.0, Cell("spread", 12): -2.0}
    found = scored(tables)
    assert found[["task", "value"]].to_numpy().tolist() == [["spread", 1.0]]


def test_a_diverged_upper_reference_gives_no_score_and_the_pool_says_so():
    """What fell below everybody is no 1 that others could be measured by."""
    sheet = two_cells().add("lf_baseline", task="circle", rewards=(-70.0, -71.0))
    sheet.add("hybrid", "mlp", task="circle", rewards=(-70.0, -71.0))
    sheet.add("hf_hotstart", task="circle", rewards=(-70.0, -71.0))
    tables = sheet.add_upper(-2000.0, task="circle", status="diverged").tables()
    assert Cell("circle", 3) not in upper_returns(tables)
    assert set(scored(tables)["task"]) == {"spread"}
    (pool,) = pools(tables)
    assert "Not pooled: circle, N = 3: its upper reference diverged." in pool_remarks(pool)


def test_a_steady_variant_stands_for_an_upper_reference_that_diverged():
    sheet = Sheet().add(rewards=(-45.0,)).add(task="circle", rewards=(-45.0,))
    sheet.add_upper(-2000.0, task="circle", status="diverged")
    sheet.add_upper(-45.0, task="circle", variant=STEADY)
    sheet.add_upper(-1.0).add_upper(-90.0, variant=STEADY)  # holds by default
    sheet.add(team_size=12, rewards=(-45.0,)).add_upper(-2000.0, team_size=12, status="diverged")
    sheet.add_upper(-900.0, team_size=12, variant=STEADY, status="diverged")
    tables = sheet.tables()
    assert upper_returns(tables) == {Cell("circle", 3): -45.0, Cell("spread", 3): -1.0}
    assert steadied_references(tables) == {Cell("circle", 3)}
    assert fallen_references(tables) == {Cell("spread", 12)}
    assert dict(scored(tables)[["task", "value"]].to_numpy())["circle"] == 1.0


def test_a_pool_ranks_with_ties():
    (pool,) = pools(two_cells().tables())
    assert pool.cells == [Cell("spread", 3), Cell("spread", 12)]
    found = {row.entry.label: (row.rank, row.groups) for row in pool.rows}
    assert found["hf_hotstart"] == found["hybrid (mlp)"] == ((1, 2), "a")
    assert found["lf_baseline"] == ((3, 3), "b")
    assert [line[0] for line in pool_lines(pool)] == ["1 to 2", "1 to 2", "3"]
    assert [line[-2:] for line in pool_lines(pool)] == [["6 (2 x 3)", "0"]] * 3
    assert improvement_lines(pool)[-1] == ["lf_baseline", "0.00*", "0.00*", "-"]


def test_cells_and_entries_that_are_not_pooled_are_named():
    sheet = two_cells()
    sheet.add("hf_scratch", team_size=12, rewards=(-70.0,))
    sheet.add("hybrid", "sindy", task="circle", rewards=(-70.0, -71.0)).add_upper(task="circle")
    sheet.add("own", task="theirs", rewards=(-1.0, -2.0))
    (pool,) = pools(sheet.tables())
    assert [row.entry.label for row in pool.rows][-1] == "lf_baseline"
    few = "fewer than 2 seeds"
    assert pool_remarks(pool) == [
        f"Not pooled: circle, N = 3: {few} of hf_hotstart, hybrid (mlp), lf_baseline.",
        "Not pooled: theirs, N = 3: no upper reference.",
        f"Not pooled: hf_scratch: {few} in 2 of 2 cells.",
        f"Not pooled: hybrid (sindy): {few} in 2 of 2 cells.",
        "Not pooled: own: it has no score.",
    ]


def test_entries_with_different_gaps_share_what_all_of_them_have():
    """Five cells, three entries of which each lacks another: two cells with all four entries."""
    lacks = {"lf_baseline": 2, "hf_hotstart": 3, "hf_scratch": 5, "": 0}

    def pooled(sizes):
        sheet = Sheet()
        for team_size in sizes:
            sheet.add_upper(team_size=team_size)
            for method, lacking in lacks.items():
                if team_size != lacking:
                    cell = {"team_size": team_size, "rewards": (-60.0, -61.0)}
                    sheet.add(method or "hybrid", "" if method else "mlp", **cell)
        (pool,) = pools(sheet.tables())
        return pool

    pool = pooled((2, 3, 5, 7, 12))
    held = len(pool.cells) * len(pool.rows)
    # 2 cells x 4 entries = 3 cells x 3 or 4 cells x 2 are 9 at most: the largest wins.
    assert held == 9
    pool = pooled(range(2, 12))
    assert (len(pool.cells), len(pool.rows)) == (7, 4)


def test_two_entries_over_two_cells_are_pooled_before_many_in_one():
    sheet = Sheet().add_upper(team_size=2).add_upper(team_size=3)
    for method in ("lf_baseline", "hf_hotstart", "hf_scratch", "grey_box", "online"):
        sheet.add(method, team_size=2, rewards=(-60.0, -61.0))
    for method in ("lf_baseline", "hf_hotstart"):
        sheet.add(method, team_size=3, rewards=(-60.0, -61.0))
    (pool,) = pools(sheet.tables())
    assert (len(pool.cells), len(pool.rows)) == (2, 2)


def test_lost_runs_are_counted_beside_the_pool_even_where_their_cell_is_not_in_it():
    sheet = two_cells()
    sheet.add("lf_baseline", task="circle", rewards=(-70.0, -71.0)).add_upper(task="circle")
    sheet.add("hf_hotstart", task="circle", rewards=(-70.0,), status="diverged")
    sheet.add("hf_hotstart", task="circle", rewards=(-71.0,), status="failed", first_seed=1)
    sheet.add("hf_hotstart", rewards=(-9.0,), first_seed=3, status="failed")
    (pool,) = pools(sheet.tables())
    lost = {row.entry.label: (row.n, row.lost) for row in pool.rows}
    assert lost == {"hf_hotstart": (6, 3), "hybrid (mlp)": (6, 0), "lf_baseline": (6, 0)}


def test_lost_runs_are_counted_where_nobody_flew():
    sheet = two_cells()
    sheet.add("hybrid", "mlp", task="circle", rewards=(-70.0,), status="failed")
    (pool,) = pools(sheet.tables())
    assert {row.entry.label: row.lost for row in pool.rows}["hybrid (mlp)"] == 1


def test_diverged_runs_are_pooled_with_the_policy_that_they_left():
    sheet = two_cells()
    for team_size in (3, 12):
        rewards = (-300.0, -301.0, -302.0)
        sheet.add("hf_scratch", rewards=rewards, status="diverged", team_size=team_size)
    (pool,) = pools(sheet.tables())
    last = pool.rows[-1]
    assert (last.entry, last.rank, last.n, last.lost) == (Entry("hf_scratch"), (4, 4), 6, 6)


def test_a_seed_that_one_entry_lost_is_in_no_entry():
    sheet = Sheet()
    for team_size in (3, 12):
        sheet.add_upper(team_size=team_size)
        sheet.add("hf_hotstart", rewards=(-50.0, -51.0), team_size=team_size)
        sheet.add("lf_baseline", rewards=(-50.0, -51.0, -500.0), team_size=team_size)
    (pool,) = pools(sheet.tables())
    first, second = pool.rows
    assert (first.n, second.n) == (4, 4)
    assert first.iqm.value == second.iqm.value
    assert first.mean == second.mean
    assert first.rank == second.rank == (1, 2)


def test_one_cell_or_one_seed_is_no_pool():
    one_cell = Sheet().add("a", rewards=(-1.0, -2.0)).add("b", rewards=(-3.0, -4.0)).add_upper(0.0)
    assert pools(one_cell.tables()) == []
    one_seed = Sheet().add("a").add("b").add_upper()
    one_seed.add("a", team_size=5).add("b", team_size=5).add_upper(team_size=5)
    assert pools(one_seed.tables()) == []
    for name in ("a", "b"):
        one_seed.add(name, first_seed=1).add(name, first_seed=1, team_size=5)
    assert len(pools(one_seed.tables())) == 1
    assert pools(Sheet().tables()) == []


def test_worlds_are_pooled_apart():
    tables = two_cells().tables()
    lower = tables.results["metric"].eq(PRIMARY) & tables.results["method"].ne("upper_reference")
    values = tables.results["value"] - 5.0 * lower
    windy = tables.results.assign(deployed_effects="wind(x=1)", value=values)
    results = pd.concat([tables.results, windy], ignore_index=True)
    both = pools(Tables(results, tables.curves, tables.trajectories, tables.runs))
    assert [pool.cells[0].deployed_effects for pool in both] == ["", "wind(x=1)"]
    assert both[0].rows[0].iqm.value > both[1].rows[0].iqm.value


def test_the_document_has_the_pool_with_harmless_names(tmp_path):
    sheet = two_cells()
    for team_size in (3, 12):
        sheet.add("<script>x</script>|y", team_size=team_size, rewards=(-70.0, -71.0))
    write_leaderboard(sheet.tables(), tmp_path / "leaderboard.md")
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    html = MarkdownIt("commonmark", {"html": True}).enable("table").render(text)
    assert "<h2>Pooled over 2 cells</h2>" in html
    assert "<script" not in html
    assert "beats &lt;script&gt;x&lt;/script&gt;|y</th>" in html
    assert not math.isnan(pools(sheet.tables())[0].rows[0].iqm.low)


def test_the_page_has_the_pool_with_its_figures_and_harmless_names(tmp_path):
    sheet = two_cells()
    for team_size in (3, 12):
        sheet.add("<script>x</script>|y", team_size=team_size, rewards=(-70.0, -71.0))
    write_report(sheet.tables(), tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text()
    assert "<script>x" not in html
    assert 'id="pool-1">Pooled over 2 cells' in html
    for heading in ("Interquartile means", "Performance profiles", "Who beats whom"):
        assert heading in html
    panels, keys = pooled_panels(pools(sheet.tables())[0], "salt")
    assert [key.label for key in keys] == [row.entry.label for row in pools(sheet.tables())[0].rows]
    for panel in panels:
        assert "<script>x" not in panel.svg
        assert "&lt;script&gt;x&lt;/script&gt;|y" in panel.svg
    assert "hf_hotstart 0.9877" in panels[0].alt
