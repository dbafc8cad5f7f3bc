"""Rules on returns against tables whose answers are known by hand."""

import pytest
from tables_for_tests import SPAWN_SETTLED, Sheet

from bench.paper.claims import PAPER_LOSSES
from bench.paper.return_rules import Above, EnoughFlights, GapAtMost, GapNarrows, Shortfall
from bench.paper.values import HOTSTART, HYBRID, LF
from bench.stats.scores import UPPER
from bench.stats.statistics import Entry
from bench.stats.verdicts import Verdict

SUPPORTED, REFUTED = Verdict.SUPPORTED, Verdict.REFUTED
UNDECIDED, UNTESTED = Verdict.UNDECIDED, Verdict.UNTESTED
APART = {
    SUPPORTED: (10.0, 11.0, 10.5),
    REFUTED: (-10.0, -11.0, -10.5),
    UNDECIDED: (-1.0, 0.0, 2.0),
    UNTESTED: (10.0,),
}
"""Differences of three seeds, or one, and what they say of "the first is above"."""


def judged(rule, sheet, metric="settled_reward"):
    return rule.judge(sheet.tables(), metric)


def pair(apart, sheet=None, task="spread", team_size=3, base=-60.0):
    """A cell in which Hybrid is so far above the LF baseline, seed by seed."""
    cell = {"task": task, "team_size": team_size}
    sheet = (sheet or Sheet()).add("hybrid", "mlp", rewards=[base + x for x in apart], **cell)
    return sheet.add("lf_baseline", rewards=[base] * len(apart), **cell)


def cells(*apart):
    """A cell of three drones for each list of differences."""
    sheet = Sheet()
    for i, differences in enumerate(apart):
        pair(differences, sheet, task=f"task{i}")
    return sheet


@pytest.mark.parametrize("verdict", Verdict)
def test_a_single_cell_says_what_its_differences_say(verdict):
    found = judged(Above(HYBRID, LF), cells(APART[verdict]))
    assert found.verdict is verdict
    assert found.ours == f"{verdict.value} in 1 of 1"


def test_a_line_shows_both_means_with_their_seeds_and_the_paired_difference():
    line = judged(Above(HYBRID, LF), cells((10.0, 11.0, 12.0))).lines[0]
    shown = ("task0, N = 3", "-49.0 ± 1.0 (n = 3)", "-60.0 ± 0.0 (n = 3)")
    # 11 +- t(0.975, 2) / sqrt(3) = 11 +- 2.48; p = 1 - t / sqrt(t^2 + 2) for t = 11 sqrt(3)
    assert line == (*shown, "11.0", "8.5 to 13.5", "0.003", "supported")


def test_equal_returns_are_no_win():
    assert judged(Above(HYBRID, LF), cells((0.0, 0.0, 0.0))).verdict is UNDECIDED


def test_cells_are_counted_by_verdict():
    found = judged(Above(HYBRID, LF), cells(*APART.values(), APART[SUPPORTED]))
    assert found.ours == "supported in 2, refuted in 1, undecided in 1, not tested in 1 of 5"


@pytest.mark.parametrize(
    ("task", "team_size", "verdict"),
    [
        ("circle", 3, SUPPORTED),
        ("figure8", 3, SUPPORTED),
        ("circle", 5, REFUTED),
        ("spread", 3, REFUTED),
    ],
)
def test_only_the_papers_own_losses_are_excluded(task, team_size, verdict):
    sheet = pair(APART[REFUTED], cells(APART[SUPPORTED]), task=task, team_size=team_size)
    rule = Above(HYBRID, LF, but=PAPER_LOSSES)
    found = judged(rule, sheet)
    assert found.verdict is verdict
    counted = "supported in 1, refuted in 1 of 2" if verdict is REFUTED else "supported in 1 of 1"
    assert found.ours == counted
    assert "in every cell but circle at N = 3 and figure8 at N = 3," in rule.text


def test_where_only_excluded_cells_were_run_nothing_is_tested():
    sheet = pair(APART[SUPPORTED], task="circle")
    assert judged(Above(HYBRID, LF, but=PAPER_LOSSES), sheet).verdict is UNTESTED


@pytest.mark.parametrize(
    ("verdicts", "verdict"),
    [
        ([SUPPORTED, SUPPORTED, REFUTED, REFUTED], SUPPORTED),
        ([SUPPORTED, UNDECIDED, REFUTED, REFUTED], UNDECIDED),
        ([SUPPORTED, REFUTED, REFUTED, REFUTED], REFUTED),
        ([SUPPORTED, REFUTED, UNTESTED], SUPPORTED),
        ([UNTESTED], UNTESTED),
    ],
)
def test_half_of_the_cells_may_be_enough(verdicts, verdict):
    sheet = cells(*(APART[v] for v in verdicts))
    assert judged(Above(HYBRID, LF, at_least=0.5), sheet).verdict is verdict


@pytest.mark.parametrize(("won", "verdict"), [(20, SUPPORTED), (19, REFUTED)])
def test_20_of_24_cells_are_20(won, verdict):
    ahead, behind = (10.0,) * 3, (-10.0,) * 3
    sheet = cells(*[ahead] * won, *[behind] * (24 - won))
    assert judged(Above(HYBRID, LF, at_least=20 / 24), sheet).verdict is verdict


@pytest.mark.parametrize(
    ("apart", "verdict"),
    [
        ((-5.0, -5.1, -4.9), SUPPORTED),
        ((-7.0, -7.1, -6.9), REFUTED),
        ((-5.0, -6.0, -7.0), UNDECIDED),
    ],
)
@pytest.mark.parametrize("base", [-60.0, 60.0])
def test_a_share_of_the_loss_is_allowed(apart, verdict, base):
    sheet = pair(apart, base=base)
    assert judged(Above(HYBRID, LF, share=0.1), sheet).verdict is verdict


def test_another_metric_than_the_return_may_be_meant():
    sheet = Sheet().add("hybrid", "mlp", rewards=(-1.0, -1.0), training_reward=-9.0)
    sheet.add("lf_baseline", rewards=(-2.0, -2.0), training_reward=-8.0)
    assert judged(Above(HYBRID, LF), sheet).verdict is SUPPORTED
    assert judged(Above(HYBRID, LF, metric="training_reward"), sheet).verdict is REFUTED


def test_a_claim_about_one_task_is_judged_on_that_task():
    sheet = pair(APART[REFUTED], cells(APART[SUPPORTED]), task="figure8")
    rule = Above(HYBRID, LF, task="task0")
    found = judged(rule, sheet)
    assert (found.verdict, len(found.lines)) == (SUPPORTED, 1)
    assert "in every cell of task0," in rule.text


def test_the_test_over_all_cells_is_in_scores():
    sheet = cells((10.0, 10.0, 10.0), (20.0, 20.0, 20.0))
    for task in ("task0", "task1"):
        sheet.add_upper(-20.0, task=task)
    gained = 15.0 / (-20.0 - SPAWN_SETTLED)
    text = judged(Above(HYBRID, LF), sheet).ours
    higher = f"Hybrid's score is {gained:.4f} (0.0170 to 0.0170) higher over 2 cells"
    assert text.endswith(f"; {higher}")
    assert "score" not in judged(Above(HYBRID, LF), sheet, "reward").ours


def test_a_mean_over_cells_that_most_contradict_names_the_cell_that_it_follows():
    sheet = cells((-1.0, -1.0, -1.0), (30.0, 30.0, 30.0), (-2.0, -2.0, -2.0))
    for task in ("task0", "task1", "task2"):
        sheet.add_upper(-20.0, task=task)
    text = judged(Above(HYBRID, LF), sheet).ours
    end = "LF baseline is better; the mean follows task1, N = 3, where the two differ most"
    assert text.endswith(f". In 2 of these {end}")


def test_other_worlds_are_no_evidence():
    sheet = cells((10.0, 10.0, 10.0)).add_upper(-20.0, task="task0")
    before = len(sheet.results)
    pair(APART[REFUTED], sheet, task="task1")
    sheet.add_upper(-20.0, task="task1")
    for row in sheet.results[before:]:
        row["deployed_effects"] = "wind(x=1.5)"
    found = judged(Above(HYBRID, LF), sheet)
    higher = "Hybrid's score is 0.0114 (0.0114 to 0.0114) higher over 1 cell"
    assert found.ours == f"supported in 1 of 1; {higher}"


def test_variants_are_no_evidence():
    sheet = cells(APART[SUPPORTED]).add("lf_baseline", task="circle", rewards=(-1.0,) * 3)
    sheet.add("hybrid", "mlp", variant="x=1", task="circle", rewards=(-9.0,) * 3)
    assert judged(Above(HYBRID, LF), sheet).verdict is SUPPORTED


def test_a_diverged_run_counts_with_the_policy_that_it_left():
    sheet = Sheet().add("lf_baseline", rewards=(-60.0, -61.0, -62.0))
    sheet.add("hybrid", "mlp", rewards=(-50.0, -51.0))
    sheet.add("hybrid", "mlp", rewards=(-9999.0,), status="diverged", first_seed=2)
    found = judged(Above(HYBRID, LF), sheet)
    assert found.verdict is UNDECIDED
    assert found.lines[0][1] == "-3366.7 ± 5743.8 (n = 3)"


def test_a_failed_run_leaves_fewer_seeds_and_they_are_shown():
    sheet = Sheet().add("lf_baseline", rewards=(-60.0, -61.2, -300.0))
    sheet.add("hybrid", "mlp", rewards=(-50.0, -51.0))
    sheet.add("hybrid", "mlp", rewards=(-9999.0,), status="failed", first_seed=2)
    found = judged(Above(HYBRID, LF), sheet)
    # The third seed of the baseline has no partner and leaves its mean, too.
    assert found.lines[0][1:3] == ("-50.5 ± 0.7 (n = 2)", "-60.6 ± 0.8 (n = 2)")
    assert found.verdict is SUPPORTED


def test_a_cell_that_one_of_both_lost_altogether_is_told():
    sheet = cells(APART[SUPPORTED]).add("lf_baseline", task="circle")
    sheet.add("hybrid", "mlp", task="circle", status="failed")
    sheet.add("hf_scratch", task="figure8")
    found = judged(Above(HYBRID, LF), sheet)
    assert found.ours == "supported in 1 of 1; 1 more where only one of the two was run"


def test_the_upper_reference_competes_with_nobody():
    sheet = cells(APART[SUPPORTED]).add_upper(-1.0, task="task0").add_upper(first_seed=1)
    assert judged(Above(Entry(UPPER), LF), sheet).verdict is UNTESTED


def gaps(first, last, sizes=(3, 12), sheet=None, task="spread"):
    """Hot start at -100 and Hybrid behind it by percents, seed by seed, at two team sizes."""
    sheet = sheet or Sheet()
    for n, percents in zip(sizes, (first, last), strict=True):
        cell = {"task": task, "team_size": n}
        sheet.add("hf_hotstart", rewards=[-100.0] * len(percents), **cell)
        sheet.add("hybrid", "mlp", rewards=[-100.0 - p for p in percents], **cell)
    return sheet


NARROWS = GapNarrows(HYBRID, HOTSTART)


@pytest.mark.parametrize(
    ("first", "last", "verdict"),
    [
        ((20.0, 21.0, 19.0), (0.5, 0.6, 0.4), SUPPORTED),
        ((0.5, 0.6, 0.4), (20.0, 21.0, 19.0), REFUTED),
        ((10.0, 20.0, 30.0), (9.0, 19.0, 31.0), UNDECIDED),
        ((20.0,), (0.5,), UNTESTED),
        ((20.0, 21.0, 19.0), (0.5,), UNTESTED),
    ],
)
def test_a_gap_narrows_if_it_is_smaller_for_the_largest_team(first, last, verdict):
    assert judged(NARROWS, gaps(first, last)).verdict is verdict


def test_gaps_are_in_percent_of_hot_start():
    found = judged(NARROWS, gaps((20.0, 21.0, 19.0), (0.5, 0.6, 0.4)))
    assert found.ours == "20.0 % at N = 3, 0.5 % at N = 12"
    assert found.lines[0] == ("N = 3", "20.0 (n = 3)", "17.5 to 22.5")


def test_a_gap_is_compared_seed_by_seed():
    # As two samples they overlap; seed by seed the gap is 5 points smaller.
    assert judged(NARROWS, gaps((10.0, 20.0, 30.0), (5.0, 15.1, 25.0))).verdict is SUPPORTED
    assert judged(NARROWS, gaps((10.0, 20.0, 30.0), (25.0, 15.0, 5.0))).verdict is UNDECIDED


def test_gaps_are_averaged_over_tasks_and_team_sizes_that_lack_one_are_left_out():
    sheet = gaps((10.0, 12.0), (4.0, 5.0))
    gaps((30.0, 32.0), (6.0, 7.0), sheet=sheet, task="circle")
    for n in (7, 18):  # of the middle and the largest team, one task was run
        sheet.add("hf_hotstart", task="circle", team_size=n, rewards=(-100.0, -100.0))
        sheet.add("hybrid", "mlp", task="circle", team_size=n, rewards=(-900.0, -900.0))
    assert judged(NARROWS, sheet).ours == "21.0 % at N = 3, 5.5 % at N = 12"


def test_a_single_team_size_has_no_trend():
    sheet = gaps((10.0, 12.0), (4.0, 5.0), sizes=(3, 3))
    sheet.results = [row for row in sheet.results if row["run"] < "run004"]
    assert judged(NARROWS, sheet).verdict is UNTESTED


def test_a_return_of_zero_has_no_relative_gap():
    sheet = Sheet()
    for n in (3, 12):
        sheet.add("hf_hotstart", team_size=n, rewards=(0.0, 0.0))
        sheet.add("hybrid", "mlp", team_size=n, rewards=(-1.0, -2.0))
    assert judged(NARROWS, sheet).verdict is UNTESTED
    assert judged(GapAtMost(HYBRID, HOTSTART, bound=0.1), sheet).verdict is UNTESTED
    assert judged(Shortfall(HYBRID, HOTSTART, low=0.1), sheet).ours == "by - %"


@pytest.mark.parametrize(
    ("percents", "verdict"),
    [
        ((0.5, 0.6, 0.4), SUPPORTED),
        ((-3.0, -4.0, -5.0), SUPPORTED),
        ((2.0, 2.1, 1.9), REFUTED),
        ((0.2, 0.5, 1.4), UNDECIDED),
        ((0.5,), UNTESTED),
    ],
)
def test_a_gap_is_at_most_so_large_by_its_interval(percents, verdict):
    rule = GapAtMost(HYBRID, HOTSTART, bound=0.01, from_size=12)
    # Three drones are below the size from which it is claimed.
    assert judged(rule, gaps((20.0, 21.0, 19.0), percents)).verdict is verdict


def test_a_gap_is_at_most_so_large_at_every_team_size():
    sheet = gaps((2.0, 2.1, 1.9), (0.5, 0.6, 0.4))
    found = judged(GapAtMost(HYBRID, HOTSTART, bound=0.01), sheet)
    assert found.verdict is REFUTED
    assert found.ours == "2.0 % (1.8 to 2.2) at N = 3, 0.5 % (0.3 to 0.7) at N = 12"


TRAILS = Shortfall(LF, HYBRID, low=0.18)


def trailing(*worse, sheet=None, task="spread"):
    """Hybrid at -100 and the LF baseline behind it by so much, seed by seed."""
    sheet = (sheet or Sheet()).add("hybrid", "mlp", task=task, rewards=[-100.0] * len(worse))
    return sheet.add("lf_baseline", task=task, rewards=[-100.0 - x for x in worse])


@pytest.mark.parametrize(
    ("worse", "verdict"),
    [
        ((50.0, 51.0, 49.0), SUPPORTED),
        ((10.0, 11.0, 9.0), REFUTED),
        ((10.0, 20.0, 30.0), UNDECIDED),
        ((50.0,), UNTESTED),
    ],
)
def test_one_trails_another_by_a_share_of_its_loss(worse, verdict):
    assert judged(TRAILS, trailing(*worse)).verdict is verdict


def test_one_trails_another_in_every_cell():
    sheet = trailing(150.0, 151.0, 149.0)
    trailing(10.0, 11.0, 9.0, sheet=sheet, task="circle")
    found = judged(TRAILS, sheet)
    assert (found.verdict, found.ours) == (REFUTED, "by 10 to 150 %")
    assert found.lines == (("circle, N = 3", "10.0 (n = 3)"), ("spread, N = 3", "150.0 (n = 3)"))


def flown(few, flights=32, more="", task="circle", sheet=None):
    """Hybrid of the whole pool at -100, and with few flights behind it, seed by seed."""
    sheet = (sheet or Sheet()).add("hybrid", "mlp", task=task, rewards=[-100.0] * len(few))
    variant, rewards = f"flights={flights}{more}", [-100.0 - x for x in few]
    return sheet.add("hybrid", "mlp", variant=variant, task=task, rewards=rewards, flights=flights)


@pytest.mark.parametrize(
    ("few", "verdict"),
    [
        ((4.0, 5.0, 6.0), SUPPORTED),
        ((20.0, 21.0, 22.0), REFUTED),
        ((5.0, 15.0, 26.0), UNDECIDED),
        ((4.0,), UNTESTED),
    ],
)
def test_few_flights_may_be_enough(few, verdict):
    found = judged(EnoughFlights(32, share=0.15), flown(few))
    assert found.verdict is verdict
    assert found.ours == f"{verdict.value} in 1 of 1"


def test_few_flights_must_be_enough_in_every_cell_that_is_meant():
    sheet = flown((20.0, 21.0, 22.0), task="spread", sheet=flown((4.0, 5.0, 6.0)))
    found = judged(EnoughFlights(32, share=0.15), sheet)
    assert found.verdict is REFUTED
    assert found.lines[0] == ("circle, N = 3", "5.0 (n = 3)", "supported")
    assert judged(EnoughFlights(32, share=0.15, task="circle"), sheet).verdict is SUPPORTED


@pytest.mark.parametrize(("flights", "more"), [(8, ""), (32, ", trainer.epochs=5")])
def test_other_settings_are_not_these_flights(flights, more):
    sheet = flown((4.0, 5.0, 6.0), flights=flights, more=more)
    assert judged(EnoughFlights(32, share=0.15), sheet).verdict is UNTESTED


def test_few_flights_are_compared_with_the_same_seeds_and_counted():
    sheet = Sheet().add("hybrid", "mlp", rewards=(-50.0, -100.0, -100.0))
    sheet.add("hybrid", "mlp", variant="flights=32", rewards=(-102.0, -104.0), first_seed=1)
    assert judged(EnoughFlights(32, share=0.15), sheet).lines[0][1] == "3.0 (n = 2)"
