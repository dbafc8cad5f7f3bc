"""Intervals and ties, with the seed as the unit of replication."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bench.plan.realities import parse_reality, written
from bench.stats.statistics import (
    Cell,
    Entry,
    cells_meant,
    difference,
    estimate,
    seed_values,
)
from bench.store.tables import table
from bench.text.errors import UsageError
from simulators.effects import chain

A, B, C, D = (Entry(name) for name in "abcd")


def by_seed(*values):
    return dict(enumerate(values))


def result_row(**changes):
    row = {
        "run": "r0",
        "method": "a",
        "residual": "",
        "variant": "",
        "task": "spread",
        "team_size": 3,
        "seed": 0,
        "simulator": "crazyflow",
        "trained_effects": "",
        "deployed_effects": "",
        "calibration_flights": 0,
        "metric": "reward",
        "value": -1.0,
        "unit": "1",
        "status": "ok",
    }
    return row | changes


@pytest.mark.parametrize("n", [2, 3, 5])
def test_interval_of_a_mean_equals_scipys(n):
    values = np.random.default_rng(n).normal(-50.0, 4.0, n)
    test = stats.ttest_1samp(values, 0.0)
    found = estimate(values)
    assert (found.low, found.high) == pytest.approx(tuple(test.confidence_interval(0.95)))
    assert found.freedom == test.df == n - 1
    assert (found.mean, found.std) == pytest.approx((values.mean(), values.std(ddof=1)))


def test_difference_pairs_by_seed_and_not_by_position():
    found = difference({0: 1.0, 1: 2.0, 2: 3.0}, {2: 2.0, 0: 0.0, 1: 1.0})
    assert (found.low, found.high) == (1.0, 1.0)


def test_a_seed_that_one_side_lost_is_left_out_of_both():
    """Seed 0 begins far from the goal: the side that lost it must not look better for that."""
    hard, all_three = {1: -50.2, 2: -52.2}, {0: -62.4, 1: -52.7, 2: -54.1}
    found = difference(hard, all_three)
    assert found.mean == pytest.approx(2.2)
    assert found.n == 2
    assert difference(all_three, hard).mean == pytest.approx(-2.2)


def test_difference_over_other_seeds_is_welchs():
    rng = np.random.default_rng(1)
    a, b = rng.normal(0.0, 1.0, 5), rng.normal(1.0, 4.0, 3)
    test = stats.ttest_ind(a, b, equal_var=False)
    found = difference(by_seed(*a), dict(enumerate(b, 4)))  # one seed in common
    assert (found.low, found.high) == pytest.approx(tuple(test.confidence_interval(0.95)))
    assert found.freedom == pytest.approx(test.df)


def test_one_seed_in_common_with_the_only_one_of_a_side_is_that_seeds_difference():
    found = difference({2: 5.0}, {0: 1.0, 2: 2.0})
    assert (found.mean, found.n) == (3.0, 1)


def test_welch_without_any_spread_is_a_point():
    found = difference(by_seed(1.0, 1.0), {5: 3.0, 6: 3.0, 7: 3.0})
    assert (found.low, found.high, found.excludes_zero) == (-2.0, -2.0, True)


def test_one_seed_has_a_mean_and_no_interval():
    found = estimate([2.0])
    assert (found.mean, found.n, found.has_interval) == (2.0, 1, False)
    assert math.isnan(found.std)
    assert not difference(by_seed(1.0), by_seed(9.0)).excludes_zero


def test_no_value_is_not_a_number():
    assert math.isnan(estimate([]).mean)
    assert estimate([]).n == 0


def test_a_diverged_run_counts_with_the_policy_it_left_and_a_failed_one_does_not():
    statuses = ("ok", "budget", "failed", "diverged")
    rows = [
        result_row(run=f"r{i}", seed=i, status=status, value=-float(i))
        for i, status in enumerate(statuses)
    ]
    found = seed_values(table("results", rows), "reward")
    assert found == {Cell("spread", 3): {A: {0: 0.0, 1: -1.0, 3: -3.0}}}


def test_values_that_are_not_finite_are_left_out():
    rows = [result_row(value=math.nan), result_row(run="r1", seed=1, value=-math.inf)]
    assert seed_values(table("results", rows), "reward") == {}


def test_worlds_are_cells_of_their_own():
    rows = [result_row(), result_row(deployed_effects="wind(1.5)", value=-2.0)]
    found = seed_values(table("results", rows), "reward")
    assert list(found) == [Cell("spread", 3), Cell("spread", 3, "crazyflow", "wind(1.5)")]


def test_a_run_that_never_flew_was_meant_for_the_world_of_its_variant():
    plain, windy = Cell("spread", 3), Cell("spread", 3, "crazyflow", "Wind(x=1.5, y=0, z=0)")
    world = "crazyflow+Wind(x=1.5, y=0, z=0)"
    for variant, known, meant in (
        (f"deployed_in={world}, tracked=true", {plain, windy}, windy),
        (f"reality={world}, trainer.lr=0.01", set(), windy),
        ("reality=rotorpy", {plain}, Cell("spread", 3, "rotorpy")),
        ("trainer.lr=0.01", {plain, windy}, plain),
        ("", {windy}, windy),
        ("", set(), plain),
        ("", {plain, Cell("spread", 3, "rotorpy")}, plain),
    ):
        assert cells_meant("spread", 3, variant, known) == {meant}
    reality = parse_reality("crazyflow+mass(e=0.2)+drag(c=2)")
    variant = f"reality={written(reality)}, trainer.lr=0.01"
    (found,) = cells_meant("spread", 3, variant, ())
    assert found.deployed_effects == chain.canonical(reality.effects)


def test_two_runs_for_one_seed_are_an_error():
    rows = pd.DataFrame([result_row(), result_row(run="r1")])
    with pytest.raises(UsageError, match="'r0' and 'r1' both report a on spread, N = 3, seed 0"):
        seed_values(rows, "reward")
