"""Ranks: intervals in the order of the means, ties by letters, and no rank for scatter."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bench.stats.pooled import _above
from bench.stats.ranking import intervals, letters, ranks, tie_groups
from bench.stats.statistics import Cell, Entry, difference, estimate

A, B, C, D = (Entry(name) for name in "abcd")


def by_seed(*values):
    return dict(enumerate(values))


def shown(samples):
    return {entry.method: (rank.text, rank.ties) for entry, rank in ranks(samples).items()}


def test_what_is_not_separated_from_the_best_may_be_first():
    samples = {
        D: by_seed(-40.0, -41.5, -42.1),
        B: by_seed(-10.5, -10.9, -12.6),  # differences 0.5, -0.1, 0.6: the interval contains 0
        A: by_seed(-10.0, -11.0, -12.0),
        C: by_seed(-20.0, -21.2, -22.1),
    }
    assert shown(samples) == {
        "a": ("1 to 2", "a"),
        "b": ("1 to 2", "a"),
        "c": ("3", "b"),
        "d": ("4", "c"),
    }


def test_scatter_earns_no_rank_and_is_said():
    """Its seeds separate it from nobody; its mean is the worst by far, and so is its rank."""
    samples = {
        A: by_seed(-1.0, -1.1, -1.2),
        B: by_seed(-2.0, -2.1, -2.2),
        C: by_seed(-5.0, -9.0, -400.0),
    }
    found = ranks(samples)
    assert shown(samples) == {"a": ("1", "a"), "b": ("2 to 3", "b"), "c": ("2 to 3", "a,b")}
    assert [found[entry].place for entry in (A, B, C)] == [1, 2, 3]
    behind = found[C].behind
    assert (behind.mean, behind.low, behind.high) == pytest.approx(
        (estimate([4.0, 7.9, 398.8]).mean, *(getattr(behind, x) for x in ("low", "high")))
    )
    assert behind == difference(samples[A], samples[C])
    assert behind.low < 0.0 < 600.0 < behind.high
    assert found[A].behind is None


def test_a_better_mean_of_other_seeds_is_no_worse_a_rank():
    """B has the lower mean, because it lacks the seeds that are easy."""
    samples = {A: by_seed(-10.0, -10.1, -1.0, -1.0, -1.0), B: by_seed(-9.0, -9.11)}
    assert difference(samples[B], samples[A]).low > 0.0
    assert shown(samples) == {"a": ("1 to 2", "a"), "b": ("1 to 2", "a")}


def test_equal_values_are_a_tie():
    """Their difference is 0 without any scatter, which excludes no 0."""
    samples = {A: by_seed(-1.0, -2.0), B: by_seed(-1.0, -2.0)}
    assert shown(samples) == {"a": ("1 to 2", "a"), "b": ("1 to 2", "a")}


def test_one_seed_takes_no_rank_and_gives_none_away():
    samples = {A: by_seed(-1.0), B: by_seed(-10.0, -11.0), C: by_seed(-20.0, -21.5)}
    assert shown(samples) == {"b": ("1", "a"), "c": ("2", "b")}


def matrices(n):
    upper = hnp.arrays(bool, (n, n)).map(lambda above: np.triu(above, k=1))
    return upper


@given(st.integers(1, 8).flatmap(matrices))
def test_ranks_follow_the_means_and_hold_the_place(above):
    found = intervals(above)
    for place, (first, last) in enumerate(found, 1):
        assert first <= place <= last
    assert found == sorted(found)
    assert [last for _, last in found] == sorted(last for _, last in found)


@given(st.integers(2, 8).flatmap(matrices))
def test_letters_are_shared_by_exactly_those_that_are_not_separated(above):
    found = [set(own.split(",")) for own in letters(above)]
    for i, j in itertools.combinations(range(len(above)), 2):
        assert bool(found[i] & found[j]) == (not above[i, j])


def test_tie_groups_of_samples_that_are_all_alike_or_all_apart():
    assert tie_groups(np.zeros((3, 3), bool)) == [(0, 1, 2)]
    assert tie_groups(np.triu(np.ones((3, 3), bool), k=1)) == [(0,), (1,), (2,)]
    assert letters(np.zeros((0, 0), bool)) == intervals(np.zeros((0, 0), bool)) == []


def test_tie_groups_are_all_largest_ones_and_many_ties_take_no_time():
    n = 30
    assert tie_groups(np.zeros((n, n), bool)) == [tuple(range(n))]
    above = np.triu(np.random.default_rng(0).random((7, 7)) < 0.4, k=1)
    apart = above | above.T
    subsets = [s for k in range(1, 8) for s in itertools.combinations(range(7), k)]
    tied = [set(s) for s in subsets if not apart[np.ix_(s, s)].any()]
    largest = [tuple(sorted(s)) for s in tied if not any(s < other for other in tied)]
    assert tie_groups(above) == sorted(largest)


def simulated(rng, shifts, n_seeds, n_cells):
    """Scores by cell, entry and seed: cells differ in mean and spread, as in the suites."""
    mean, spread = np.linspace(0.5, 0.9, n_cells), np.linspace(0.08, 0.02, n_cells)
    return {
        Cell(f"task{c}", 3): {
            Entry(f"m{i}"): by_seed(*rng.normal(mean[c] + shift, spread[c], n_seeds))
            for i, shift in enumerate(shifts)
        }
        for c in range(n_cells)
    }


def in_order(scores):
    """Entries by their mean score, best first."""
    entries = {entry for own in scores.values() for entry in own}
    mean = {
        e: np.mean([estimate(own[e].values()).mean for own in scores.values()]) for e in entries
    }
    return sorted(entries, key=lambda entry: -mean[entry])


def test_a_pool_seldom_separates_what_is_equal():
    rng = np.random.default_rng(3)
    trials, wrong = 300, 0
    for _ in range(trials):
        scores = simulated(rng, (0.0,) * 4, n_seeds=3, n_cells=8)
        wrong += _above(in_order(scores), scores).any()
    assert wrong / trials <= 0.088  # 0.05, and three standard errors of 300 trials


def test_rank_intervals_of_a_pool_hold_the_true_ranks():
    rng = np.random.default_rng(4)
    truth = {"m0": (1, 1), "m1": (2, 3), "m2": (2, 3), "m3": (4, 4)}
    trials, held, decided = 200, 0, 0
    for _ in range(trials):
        scores = simulated(rng, (0.06, 0.03, 0.03, 0.0), n_seeds=5, n_cells=24)
        entries = in_order(scores)
        found = intervals(_above(entries, scores))
        own = dict(zip((e.method for e in entries), found, strict=True))
        held += all(own[m][0] <= low and high <= own[m][1] for m, (low, high) in truth.items())
        decided += own["m0"] == (1, 1)
    assert held / trials >= 0.92
    assert decided / trials >= 0.5  # not by saying nothing
