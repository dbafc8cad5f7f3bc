"""Which method to choose, from tables whose answers are known by hand."""

import pytest
from tables_for_tests import SPAWN_SETTLED, Sheet, empty

from bench.paper.choosing import (
    BETTER,
    better_defaults,
    by_task,
    in_detail,
    reward_by_flight,
    whom,
)
from bench.paper.values import HOTSTART, HYBRID, LF, SCRATCH, name_of
from bench.stats.choices import BUDGETS, better_settings, choices, on_task
from bench.stats.scores import UPPER
from bench.stats.statistics import Entry
from bench.text import markdown

CLOSE = (0.0, 0.001, 0.002)
"""Scatter over seeds by which no two methods here are mistaken for each other."""


class Scores(Sheet):
    """A sheet that is filled by scores: the upper reference is one thousand above the spawn."""

    def give(self, entry, score, minutes=0.0, scatter=CLOSE, **cell):
        rewards = [SPAWN_SETTLED + 1000.0 * (score + x) for x in scatter]
        method, residual, variant = entry
        shared = {"variant": variant, "fleet_minutes": minutes, **cell}
        return self.add(method, residual, rewards=rewards, **shared)

    def bound(self, *tasks, team_size=3):
        for task in tasks:
            self.add_upper(SPAWN_SETTLED + 1000.0, task=task, team_size=team_size)
        return self


def ladder(**cell):
    """The more flight the better: four methods on one task."""
    sheet = Scores().bound("spread", **cell).give(LF, 0.2, **cell)
    sheet.give(Entry("grey_box"), 0.4, 0.5, **cell)
    sheet.give(HYBRID, 0.6, 40.0, **cell)
    return sheet.give(SCRATCH, 0.8, 900.0, **cell)


def chosen(sheet):
    return [(c.budget, c.best.method) for c in choices(sheet.tables())]


LADDER = [(0.0, "lf_baseline"), (0.5, "grey_box"), (50.0, "hybrid"), (5000.0, "hf_scratch")]


def test_the_best_that_can_be_afforded_is_chosen_and_told_once():
    assert chosen(ladder()) == LADDER
    assert BUDGETS == (0.0, 0.5, 5.0, 50.0, 500.0, 5000.0)


def test_a_choice_says_its_score_and_what_it_needs():
    found = choices(ladder().tables())[2]
    assert (found.team_size, found.best, found.minutes, found.tied) == (3, HYBRID, 40.0, ())
    assert found.score == pytest.approx(0.601)


def test_cheaper_and_better_leaves_nothing_to_choose_beyond():
    assert chosen(ladder().give(HOTSTART, 0.9, 5.0)) == [*LADDER[:2], (5.0, "hf_hotstart")]


def test_each_team_size_has_choices_of_its_own():
    sheet = ladder().bound("spread", team_size=12)
    sheet.give(LF, 0.3, team_size=12).give(SCRATCH, 0.1, 1.0, team_size=12)
    found = choices(sheet.tables())
    assert [(c.team_size, c.best.method) for c in found[3:]] == [
        (3, "hf_scratch"),
        (12, "lf_baseline"),
    ]


def test_who_is_not_shown_to_be_worse_is_tied_with_the_best():
    sheet = Scores().bound("spread").give(HYBRID, 0.6).give(LF, 0.2)
    sheet.give(HOTSTART, 0.59, scatter=(0.0, 0.04, -0.01))
    sheet.give(SCRATCH, 0.58, scatter=(0.05, 0.0, -0.03))
    (found,) = choices(sheet.tables())
    assert (found.best, [tie.entry for tie in found.tied]) == (HYBRID, [HOTSTART, SCRATCH])


def test_a_tie_says_how_far_below_a_scattered_method_may_lie():
    sheet = Scores().bound("spread").give(HYBRID, 0.9)
    sheet.give(HOTSTART, 0.2, scatter=(0.6, 0.0, -0.6))
    (found,) = choices(sheet.tables())
    (tie,) = found.tied
    assert (tie.entry, tie.score) == (HOTSTART, pytest.approx(0.2, abs=0.01))
    assert tie.low < 0.0 < 0.7 < tie.high
    assert tie.low + tie.high == pytest.approx(2.0 * (found.score - tie.score))
    page = "\n\n".join([*whom([found], sheet.tables(), False, ""), *in_detail([found])])
    assert f"**Hybrid** {found.score:.3f} |" in page  # who may be far worse stands in detail only
    assert f"hot start: {tie.score:.3f} (" in page
    assert "though they may be far worse" in page


def test_on_one_task_the_best_is_named_with_the_team_sizes_for_which_it_is():
    sheet = ladder().bound("spread", team_size=12).bound("circle")
    sheet.give(LF, 0.3, team_size=12).give(SCRATCH, 0.1, 900.0, team_size=12)
    sheet.give(LF, 0.9, task="circle").give(SCRATCH, 0.1, 900.0, task="circle")
    alone = {task: choices(on_task(sheet.tables(), task)) for task in ("circle", "spread")}
    page = "\n".join(by_task(alone))
    assert "| circle | **LF baseline** | **LF baseline** | **LF baseline** | **LF base" in page
    assert page.count("**LF baseline** (N = 12)") == 3  # from the smallest budget on it is alone
    assert "| spread | **LF baseline** | **grey box** (N = 3), **LF baseline** (N = 12) |" in page
    assert "**HF scratch** (N = 3), **LF baseline** (N = 12) |" in page
    assert by_task({"spread": alone["spread"]}) == []


def test_who_has_nearly_the_same_reward_as_the_best_stands_beside_it():
    sheet = Scores().bound("spread").give(HYBRID, 0.8).give(HOTSTART, 0.799, scatter=(0.004, 0, 0))
    sheet.give(SCRATCH, 0.78, scatter=(0.02, 0.02, -0.04))  # -120 where the best has -99
    (found,) = choices(sheet.tables())
    assert [(tie.entry, tie.near) for tie in found.tied] == [(HOTSTART, True), (SCRATCH, False)]
    page = "\n\n".join(whom([found], sheet.tables(), False, ""))
    assert f"**Hybrid** {found.score:.3f} (or hot start)" in page


def test_settings_above_every_default_of_the_same_bill_are_told():
    sheet = Scores().bound("spread").bound("circle").give(HYBRID, 0.6, 20.0).give(LF, 0.2)
    for entry, score, minutes in ((HYBRID, 0.6, 20.0), (LF, 0.2, 0.0), (HOTSTART, 0.5, 200.0)):
        sheet.give(entry, score, minutes, task="circle")
    sheet.give(HOTSTART, 0.5, 200.0)
    sheet.give(HOTSTART._replace(variant="limit=9"), 0.9, 200.0)
    sheet.give(HOTSTART._replace(variant="limit=1"), 0.6, 200.0)  # above its default alone
    sheet.give(LF._replace(variant="limit=9"), 0.55)  # no bill, and above what is free
    paid, free = better = better_settings(sheet.tables())
    assert (free.entry.method, free.above, free.tasks) == ("lf_baseline", LF, ("spread",))
    assert (paid.entry.variant, paid.above, paid.minutes) == ("limit=9", HYBRID, 200.0)
    assert (paid.score, paid.above_score) == pytest.approx((0.7, 0.6), abs=0.01)
    found = choices(sheet.tables())
    for these in (better, []):
        page = "\n\n".join(whom(found, sheet.tables(), these, "cells.md"))
        assert (f"](cells.md#{markdown.anchor(BETTER)})" in page) == bool(these)
        assert ("LF baseline with `limit=9`" in page) == bool(these)
    page = "\n\n".join(better_defaults(found, better))
    assert page.startswith(f"## {BETTER}\n\n")
    assert better_defaults(found, []) == []
    assert "**hot start** with `limit=9` on spread: 0.7" in page


def test_a_tie_that_only_a_larger_budget_allows_is_told_then():
    sheet = ladder().give(HOTSTART, 0.6, 200.0, scatter=(0.001, 0.002, 0.0))
    found = {c.budget: c for c in choices(sheet.tables())}
    assert found[50.0].tied == ()
    assert {found[500.0].best, *(tie.entry for tie in found[500.0].tied)} == {HYBRID, HOTSTART}


def test_all_tasks_weigh_alike_and_are_tested_together():
    sheet = Scores().bound("spread", "circle")
    for task, hybrid, hot in (("spread", 0.9, 0.5), ("circle", 0.4, 0.5)):
        sheet.give(HYBRID, hybrid, task=task).give(HOTSTART, hot, task=task)
    (found,) = choices(sheet.tables())
    assert (found.best, found.tied) == (HYBRID, ())
    assert found.score == pytest.approx(0.651)


def test_where_nothing_can_be_afforded_there_is_no_choice():
    sheet = Scores().bound("spread").give(SCRATCH, 0.8, 300.0)
    assert chosen(sheet) == [(500.0, "hf_scratch")]
    assert chosen(Scores().bound("spread").give(SCRATCH, 0.8, 5001.0)) == []
    assert choices(empty()) == []


def test_the_bill_is_the_mean_over_tasks_and_seeds():
    sheet = Scores().bound("spread", "circle")
    sheet.give(HYBRID, 0.6, 40.0).give(HYBRID, 0.6, 60.0, task="circle")
    assert chosen(sheet) == [(50.0, "hybrid")]


def test_who_misses_a_task_of_that_size_is_not_in_detail():
    sheet = Scores().bound("spread", "circle").bound("circle", team_size=12)
    sheet.give(LF, 0.2).give(LF, 0.2, task="circle").give(HYBRID, 0.9)
    # At another size there is only the task that it has.
    sheet.give(LF, 0.2, task="circle", team_size=12).give(HYBRID, 0.9, task="circle", team_size=12)
    assert [(c.team_size, c.best) for c in choices(sheet.tables())] == [(3, LF), (12, HYBRID)]


def test_a_task_without_upper_reference_is_not_missed():
    sheet = ladder().give(LF, 0.2, task="circle")
    assert chosen(sheet) == LADDER


def test_the_upper_reference_itself_is_never_in_detail():
    sheet = Scores().give(LF, 0.2).give(Entry(UPPER), 1.0)
    (found,) = choices(sheet.tables())
    assert (found.best, found.tied) == (LF, ())


def test_variants_and_other_worlds_are_never_in_detail():
    sheet = ladder().give(LF._replace(variant="x=1"), 0.99)
    before = len(sheet.results)
    sheet.give(HOTSTART, 0.99).bound("spread")
    for row in sheet.results[before:]:
        row["deployed_effects"] = "wind(x=1.5)"
    assert chosen(sheet) == LADDER


def test_a_residual_on_top_of_a_method_that_does_without_is_a_setting():
    sheet = ladder().give(Entry("grey_box", "mlp"), 0.9, 0.5)
    assert chosen(sheet) == LADDER


def test_one_seed_is_too_few_to_be_in_detail():
    assert chosen(ladder().give(HOTSTART, 0.99, scatter=(0.0,))) == LADDER


def test_a_task_on_which_only_variants_or_single_seeds_flew_hides_no_choice():
    sheet = ladder().bound("circle").give(LF, 0.2, task="circle", scatter=(0.0,))
    sheet.give(HYBRID._replace(variant="flights=8"), 0.9, task="circle")
    assert chosen(sheet) == LADDER


def test_a_diverged_run_lowers_the_score_and_a_failed_one_leaves_fewer_seeds():
    sheet = ladder().give(HOTSTART, 0.99, scatter=CLOSE[:2])
    sheet.give(HOTSTART, -50.0, scatter=(0.0,), first_seed=2, status="diverged")
    assert chosen(sheet) == LADDER
    sheet = ladder().give(HOTSTART, 0.99, scatter=CLOSE[:2])
    sheet.give(HOTSTART, -50.0, scatter=(0.0,), first_seed=2, status="failed")
    assert chosen(sheet) == [(0.0, "hf_hotstart")]


def test_a_choice_is_named_as_in_the_claims_or_by_its_label():
    assert name_of(HYBRID) == "Hybrid"
    assert name_of(Entry("mine", "mlp")) == "mine (mlp)"


def test_settings_are_told_by_the_seeds_that_the_default_has_too():
    sheet = Scores().bound("spread").give(LF, 0.5, scatter=(0.0, 0.001, -0.001, 0.3, 0.3))
    sheet.give(LF._replace(variant="limit=9"), 0.6)
    (found,) = better_settings(sheet.tables())
    assert (found.score, found.above_score) == pytest.approx((0.6, 0.5), abs=0.01)


def varied():
    """Hybrid with one flight in seeds 0 and 1, by default in three; hot start never varied."""
    sheet = Sheet().add("lf_baseline", rewards=(-9.0, -11.0, -70.0))
    sheet.add("hybrid", "mlp", rewards=(-4.0, -6.0, -70.0), fleet_minutes=40.0)
    sheet.add("hybrid", "mlp", variant="flights=1", rewards=(-7.0, -8.0), fleet_minutes=0.17)
    sheet.add("hybrid", "mlp", variant="patience=7", rewards=(-1.0, -1.0))
    return sheet.add("hf_hotstart", rewards=(-1.0, -1.0, -1.0), fleet_minutes=250.0)


def test_rewards_stand_by_flight_with_the_seeds_that_all_have():
    title, said, size, table = reward_by_flight(varied().tables())
    assert (title, size) == ("## Reward against flight", "### Reward against flight, N = 3")
    assert "only those seeds count that the others have" in said
    assert table.splitlines()[2:] == [
        "| LF baseline | default | 0 | -10.0 ± 1.4 |",
        "| Hybrid | `flights=1` | 0.17 | -7.50 ± 0.71 |",
        "| Hybrid | default | 40 | -5.00 ± 1.41 |",
    ]


def test_a_task_without_a_row_is_marked_and_each_team_size_has_its_table():
    sheet = varied().add("lf_baseline", task="circle", rewards=(-3.0, -5.0))
    sheet.add("hf_scratch", task="circle", variant="trainer.share=0.1", rewards=(-2.0, -2.0))
    sheet.add("hf_scratch", team_size=7, variant="trainer.share=0.1", rewards=(-8.0,))
    parts = reward_by_flight(sheet.tables())
    assert "| circle | spread |" in parts[3]
    assert "| HF scratch | `trainer.share=0.1` | 0 | -2.00 ± 0.00 | - |" in parts[3]
    assert parts[4:] == [
        "### Reward against flight, N = 7",
        "| method | setting | flight [fleet-minutes] | spread |\n| :--- | :--- | ---: | ---: |\n"
        "| HF scratch | `trainer.share=0.1` | 0 | -8.00 |",
    ]


def test_nothing_stands_where_no_flight_was_varied():
    assert reward_by_flight(Sheet().add("hybrid", "mlp").tables()) == []
