"""Pooled numbers: frozen values of rliable, all resamples counted out, and simulated coverage."""

import itertools

import numpy as np
import pytest
from scipy import stats

from bench.stats.bootstrap import (
    Interval,
    iqm,
    iqm_interval,
    probability_of_improvement,
    profile,
)

# Rows are seeds, columns are cells. The expected values below are those of rliable 1.2.0
# (`metrics`, `library`). Its intervals draw seeds for each cell by itself; ours draw whole rows.
A = np.array(
    [
        [0.90, 0.81, 0.69, 0.32],
        [0.89, 0.77, 0.70, 0.77],
        [0.89, 0.78, 0.72, 0.57],
        [0.90, 0.77, 0.70, 0.64],
        [0.87, 0.79, 0.60, 0.24],
    ]
)
B = np.array(
    [
        [0.84, 0.79, 0.66, 0.45],
        [0.88, 0.79, 0.59, 0.29],
        [0.88, 0.80, 0.64, 0.30],
        [0.86, 0.78, 0.77, 0.24],
        [0.88, 0.83, 0.69, 0.38],
    ]
)
C = np.array([[0.85, 0.61, 0.32], [0.85, 0.74, 0.27], [0.87, 0.61, 0.40]])
D = np.array([[0.9, 0.7, 0.2], [0.9, 0.7, 0.4], [0.9, 0.6, 0.5], [0.9, 0.6, 0.4]])
THRESHOLDS = (0.0, 0.5, 0.72, 0.8, 0.9)


def sample(matrix, name=""):
    return {
        f"{name}{cell}": dict(enumerate(map(float, column))) for cell, column in enumerate(matrix.T)
    }


@pytest.mark.parametrize(
    ("matrix", "expected"), [(A, 0.75), (B, 0.734), (C, 0.642), (D, 0.66666666666667)]
)
def test_iqm_equals_rliables(matrix, expected):
    assert iqm_interval(sample(matrix)).value == pytest.approx(expected, abs=1e-12)


def every_resample(matrix):
    """All that n rows drawn from n with replacement can be."""
    n = len(matrix)
    return matrix[np.array([*itertools.product(range(n), repeat=n)])]


def ends(drawn):
    """Ends of the percentile interval."""
    return tuple(np.quantile(drawn, (0.025, 0.975), axis=0))


@pytest.mark.parametrize("matrix", [A, B], ids="AB")
def test_interval_is_that_of_all_resamples_of_whole_rows(matrix):
    found = iqm_interval(sample(matrix), reps=20_000)
    every = every_resample(matrix)
    expected = ends(stats.trim_mean(every.reshape(len(every), -1), 0.25, axis=1))
    assert (found.low, found.high) == pytest.approx(expected, abs=0.0021)


def test_profile_is_that_of_all_resamples_of_whole_rows():
    found = profile(sample(A), THRESHOLDS, reps=20_000)
    assert [f.value for f in found] == pytest.approx([1.0, 0.9, 0.55, 0.3, 0.0])
    low, high = ends([[np.mean(m > t) for t in THRESHOLDS] for m in every_resample(A)])
    assert [f.low for f in found] == pytest.approx(low, abs=1e-9)
    assert [f.high for f in found] == pytest.approx(high, abs=1e-9)


def test_probability_of_improvement_equals_rliables():
    forth = probability_of_improvement(sample(A), sample(B), reps=20_000)
    assert forth.value == pytest.approx(0.635)
    rng = np.random.default_rng(8)
    drawn = []
    for a, b in rng.integers(5, size=(20_000, 2, 5)):
        wins = np.sign(A[a][:, None] - B[b][None]) / 2.0 + 0.5
        drawn.append(wins.mean())
    assert (forth.low, forth.high) == pytest.approx(ends(drawn), abs=0.0101)
    assert probability_of_improvement(sample(B), sample(A)).value == pytest.approx(0.365)
    with_ties = probability_of_improvement(sample(C.round(1)), sample(D))
    assert with_ties.value == pytest.approx(0.3055555555555556)
    assert probability_of_improvement(sample(A), sample(A)).value == 0.5


def test_weighted_iqm_is_that_of_repeated_values():
    rng = np.random.default_rng(0)
    values, counts = rng.normal(size=(3, 8)), np.array([1, 2, 3, 1, 4, 2, 1, 2])  # 16 in all
    repeated = np.repeat(values, counts, axis=-1)
    expected = stats.trim_mean(repeated, 0.25, axis=-1)
    np.testing.assert_allclose(iqm(values, counts.astype(float)), expected)


def test_cells_weigh_alike_however_many_seeds_are_left():
    full = {"easy": {0: 0.9, 1: 0.9}, "hard": {0: 0.1, 1: 0.1}}
    lost = {"easy": {0: 0.9, 1: 0.9}, "hard": {0: 0.1}}
    assert iqm_interval(full).value == pytest.approx(0.5)
    assert iqm_interval(lost).value == pytest.approx(0.5)
    assert profile(lost, [0.5])[0].value == pytest.approx(0.5)


def test_one_seed_in_a_cell_means_no_interval():
    lonely = {"x": {0: 1.0, 1: 2.0}, "y": {0: 1.0}}
    full = {"x": {0: -9.0, 1: -8.0}, "y": {0: -9.0, 1: -9.5}}
    assert np.isnan(iqm_interval(lonely).low)
    assert not iqm_interval(lonely).excludes(99.0)
    assert np.isnan(probability_of_improvement(full, lonely).low)


def test_intervals_are_the_same_in_every_process():
    """Of numbers that anyone can type in again; what is drawn depends on no process."""
    found = iqm_interval({"x": {s: s**1.7 for s in range(7)}, "y": {s: -1.3 * s for s in range(5)}})
    assert (found.low, found.high) == pytest.approx((-1.0400000000000005, 3.7387148565045685))


def test_no_common_cell_is_an_error():
    with pytest.raises(ValueError, match="must have a stratum in common"):
        probability_of_improvement(sample(A, "x"), sample(B, "y"))


def simulated(rng, shift=0.0, n_seeds=5, n_cells=24):
    """Seeds x cells: cells differ in mean and spread, as in the suites."""
    mean = np.linspace(0.5, 0.9, n_cells)
    return rng.normal(mean + shift, np.linspace(0.08, 0.02, n_cells), (n_seeds, n_cells))


@pytest.mark.parametrize("common", [0.0, 0.03])
def test_interval_of_the_pooled_iqm_covers_about_what_five_seeds_allow(common):
    """Also where a seed is good or bad in all cells alike, as trainings with one key may be."""
    rng = np.random.default_rng(2)
    values = simulated(rng, n_seeds=20_000)
    values += common * rng.normal(size=(len(values), 1))
    truth = iqm(values.ravel(), np.ones(values.size))
    trials, hits = 400, 0
    for _ in range(trials):
        own = simulated(rng) + common * rng.normal(size=(5, 1))
        found = iqm_interval(sample(own), reps=400)
        hits += found.low <= truth <= found.high
    assert 0.78 <= hits / trials <= 0.93  # percentile bootstrap of five clusters


def test_interval_of_the_probability_of_improvement_covers():
    rng = np.random.default_rng(5)
    trials, hits = 300, 0
    truth = stats.norm.cdf(1.0 / np.sqrt(2.0))  # a is one standard deviation above b
    for _ in range(trials):
        a, b = rng.normal(1.0, size=(5, 8)), rng.normal(0.0, size=(5, 8))
        found = probability_of_improvement(sample(a), sample(b), reps=300)
        hits += found.low <= truth <= found.high
    assert 0.86 <= hits / trials <= 0.98


@pytest.mark.parametrize(
    ("value", "excluded"), [(0.49, True), (0.5, False), (0.7, False), (0.9, False), (0.91, True)]
)
def test_an_interval_excludes_what_lies_beyond_its_ends(value, excluded):
    assert Interval(0.7, 0.5, 0.9).excludes(value) == excluded
    assert not Interval(0.7, float("nan"), float("nan")).excludes(value)
