"""Claims made in passing against tables whose answers are known by hand."""

import pytest
from tables_for_tests import Sheet, empty

from bench.side_claims import side_claims

NAMES = ("longer", "stops_early", "degrades", "best_at_three")


def by_name(sheet):
    return dict(zip(NAMES, side_claims(sheet.tables()), strict=True))


def trained(scratch=1200.0, hot=200.0, task="spread", team_size=3, sheet=None, status="ok"):
    sheet = sheet or Sheet()
    cell = {"task": task, "team_size": team_size, "rewards": (-50.0, -51.0)}
    sheet.add("hf_scratch", epochs=scratch, **cell)
    return sheet.add("hf_hotstart", epochs=hot, status=status, **cell)


@pytest.mark.parametrize(("hot", "holds"), [(400.0, True), (401.0, False)])
def test_epochs_are_compared_in_every_cell(hot, holds):
    claim = by_name(trained(hot=hot, team_size=12, sheet=trained()))["longer"]
    assert claim.ours == "3.0 to 6.0 times in 2 cells"
    assert claim.holds is holds
    assert claim.lines[1] == ("spread, N = 12", "1200", f"{hot:.0f}", "3.0")


@pytest.mark.parametrize(("epochs", "holds"), [(335.0, True), (336.0, False)])
def test_hot_start_may_take_as_many_epochs_as_the_papers(epochs, holds):
    claim = by_name(trained(hot=epochs, task="circle", sheet=trained(hot=100.0)))["stops_early"]
    assert claim.holds is holds
    assert claim.ours.endswith("epochs, 0 of 4 runs at their limit")


def test_runs_at_their_limit_are_counted():
    claim = by_name(trained(hot=500.0, status="budget"))["stops_early"]
    assert claim.ours == "after 500 epochs, 2 of 2 runs at their limit"


@pytest.mark.parametrize(("hybrid", "holds"), [(-75.0, True), (-90.0, False)])
def test_what_is_lost_towards_18_drones_is_a_share_of_the_small_teams_return(hybrid, holds):
    sheet = Sheet()
    for n, returns in ((3, (-50.0, -50.0, -50.0)), (18, (-100.0, -80.0, hybrid))):
        for name, value in zip(("hf_scratch", "hf_hotstart", "hybrid"), returns, strict=True):
            residual = "mlp" if name == "hybrid" else ""
            sheet.add(name, residual, team_size=n, rewards=(value,))
    claim = by_name(sheet)["degrades"]
    assert claim.ours == (
        "mean return lower than at N = 3 by: scratch 100 %, hot start 60 %, "
        f"Hybrid {-2.0 * (hybrid + 50.0):.0f} %"
    )
    assert claim.holds is holds


@pytest.mark.parametrize(("sindy", "holds"), [(-48.0, True), (-52.0, False)])
def test_the_best_class_at_three_drones_is_that_of_the_mean_over_shared_tasks(sindy, holds):
    sheet = Sheet().add("hybrid", "mlp", task="circle", rewards=(-1.0,))
    for residual, value in (("affine", -55.0), ("sindy", sindy), ("mlp", -50.0)):
        sheet.add("hybrid", residual, rewards=(value,))
    claim = by_name(sheet)["best_at_three"]
    assert claim.ours == f"affine -55.0, sindy {sindy:.1f}, mlp -50.0"
    assert claim.holds is holds


def test_without_runs_nothing_is_tested():
    assert [claim.holds for claim in side_claims(empty())] == [None] * 4
