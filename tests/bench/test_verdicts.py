"""Verdicts from paired differences, against hand-made samples and another program's numbers."""

import math

import numpy as np
import pytest
from scipy import stats

from bench.stats.statistics import Estimate, difference, estimate
from bench.stats.verdicts import Verdict, above, below, by_cell, every, holm, over_cells

SUPPORTED, REFUTED = Verdict.SUPPORTED, Verdict.REFUTED
UNDECIDED, UNTESTED = Verdict.UNDECIDED, Verdict.UNTESTED


def seeds(*values, first=0):
    return dict(enumerate(values, first))


def verdict_of(found):
    return above(found, found.p)


def test_holm_multiplies_the_smallest_by_the_most_and_never_turns_the_order():
    assert holm([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0])


def test_holm_treats_equal_p_values_alike_and_leaves_what_it_is_given():
    given = [0.01, 0.5, 0.01]
    assert holm(given) == pytest.approx([0.03, 0.5, 0.03])
    assert given == [0.01, 0.5, 0.01]
    assert holm([0.04]) == [0.04]
    assert holm([]) == []


def test_holm_falsely_decides_in_no_more_than_5_percent_of_families():
    """Eight cells without any difference; uncorrected, a third of the families has a verdict."""
    rng = np.random.default_rng(8)
    families = stats.ttest_1samp(rng.normal(size=(5, 2000, 8)), 0.0).pvalue
    corrected = np.asarray([holm(family) for family in families.tolist()])
    assert (families.min(axis=1) < 0.05).mean() > 0.3
    assert (corrected.min(axis=1) < 0.05).mean() == pytest.approx(0.05, abs=0.012)


def test_what_has_no_p_value_counts_for_nothing_in_the_correction():
    corrected = holm([0.03, math.nan, 0.02])
    assert math.isnan(corrected[1])
    assert [corrected[0], corrected[2]] == pytest.approx([0.04, 0.04])


@pytest.mark.parametrize(("n", "shift"), [(2, 1.0), (3, 0.0), (5, -2.0), (12, 0.3)])
def test_a_paired_test_is_students_for_any_number_of_common_seeds(n, shift):
    """One side lost its first seed, the other has two more."""
    rng = np.random.default_rng(n)
    a, b = rng.normal(shift, 1.0, n + 2), rng.normal(0.0, 2.0, n + 1)
    expected = stats.ttest_rel(a[1 : n + 1], b[1:])
    found = difference(seeds(*a[1:], first=1), seeds(*b))
    assert found.p == pytest.approx(expected.pvalue, rel=1e-9)
    assert (found.low, found.high) == pytest.approx(tuple(expected.confidence_interval(0.95)))
    assert (found.mean, found.n) == (pytest.approx(np.mean(a[1 : n + 1] - b[1:])), n)


def test_a_verdict_is_given_exactly_where_the_interval_excludes_0():
    rng = np.random.default_rng(7)
    decided = []
    for _ in range(200):
        found = difference(seeds(*rng.normal(0.7, 1.0, 5)), seeds(*rng.normal(0.0, 1.0, 5)))
        expected = {found.low > 0.0: SUPPORTED, found.high < 0.0: REFUTED}.get(True, UNDECIDED)
        assert verdict_of(found) is expected
        decided.append(expected is not UNDECIDED)
    assert 20 < sum(decided) < 180


def test_samples_of_other_seeds_are_tested_by_welch():
    a, b = [-50.0, -52.0, -51.0], [-60.0, -56.0, -59.0, -70.0]
    test = difference(seeds(*a), seeds(*b, first=10))
    expected = stats.ttest_ind(a, b, equal_var=False)
    assert test.p == pytest.approx(float(expected.pvalue))
    assert (test.low, test.high) == pytest.approx(tuple(expected.confidence_interval(0.95)))
    assert test.n == 3


def test_one_cell_is_tested_alike_alone_and_among_cells():
    a, b = seeds(-50.0, -52.0, -51.0), seeds(-55.0, -56.0, -59.0)
    alone, among = difference(a, b), over_cells([(a, b)])
    assert among.n == alone.n
    for name in ("mean", "low", "high", "freedom", "p"):
        assert getattr(among, name) == pytest.approx(getattr(alone, name))


def test_cells_weigh_alike_however_many_seeds_they_have():
    few = (seeds(1.0, 3.0), seeds(0.0, 0.0))
    many = (seeds(10.0, 12.0, 14.0, 8.0), seeds(0.0, 0.0, 0.0, 0.0))
    test = over_cells([few, apart(many)])
    # Means 2 and 11; variances of the means 1 and 5 / 3, with one and three degrees of freedom.
    error, freedom = math.sqrt(8.0 / 3.0) / 2.0, (8.0 / 3.0) ** 2 / (1.0 + (5.0 / 3.0) ** 2 / 3.0)
    half = float(stats.t.ppf(0.975, freedom)) * error
    assert (test.mean, test.n) == (6.5, 6)
    assert over_cells([few, many]).mean == 6.5
    assert (test.low, test.high) == pytest.approx((6.5 - half, 6.5 + half))
    assert test.p == pytest.approx(2.0 * float(stats.t.sf(6.5 / error, freedom)))


def apart(pair, first=100):
    """The same samples with seeds that no other cell has."""
    return tuple({seed + first: x for seed, x in sample.items()} for sample in pair)


def direct(differences):
    """Mean, interval and p-value of cells without common seeds, as Satterthwaite has it."""
    n = np.asarray([len(d) for d in differences])
    v = np.asarray([np.var(d, ddof=1) for d in differences]) / n
    mean, error = np.mean([np.mean(d) for d in differences]), np.sqrt(v.sum()) / len(n)
    student = stats.t(v.sum() ** 2 / np.sum(v**2 / (n - 1)), mean, error)
    return mean, *student.interval(0.95), 2.0 * min(student.cdf(0.0), student.sf(0.0))


@pytest.mark.parametrize("lost", [0, 1])
def test_many_cells_are_tested_with_satterthwaites_degrees_of_freedom(lost):
    """Of the seeds that both have, whatever the order in which they stand."""
    rng = np.random.default_rng(9)
    drawn = [rng.normal(0.5, scale, n) for n, scale in ((5, 0.1), (3, 2.0), (4, 1.0))]
    pairs = []
    for i, d in enumerate(drawn):
        b = rng.normal(size=len(d))
        a = seeds(*(b + d)) if not lost else seeds(*(b + d)[1:], first=1)
        pairs.append(apart((dict(sorted(a.items(), reverse=True)), seeds(*b)), 100 * i))
    found = over_cells(pairs)
    expected = direct([d[lost:] for d in drawn])
    assert (found.mean, found.low, found.high, found.p) == pytest.approx(expected)
    assert found.n == 12 - 3 * lost


@pytest.mark.parametrize("shared", [0.0, 0.6, 0.95])
@pytest.mark.parametrize("sizes", [(5, 5, 5, 5), (5, 5, 3, 3)], ids=str)
def test_intervals_over_cells_cover_what_they_promise(sizes, shared):
    """Four cells, one of which varies ten times as much as another.

    A seed may be good or bad in all of them: taken as independent, the cells would have intervals
    that hold the truth in 80 % of cases with `shared` at 0.95.
    """
    rng = np.random.default_rng(10)
    scales, shifts = np.asarray([0.2, 0.5, 1.0, 2.0]), np.asarray([1.0, -1.0, 0.5, -0.5])
    still, trials, covered = seeds(*np.zeros(5)), 1000, 0
    for drawn in rng.normal(size=(trials, 5, 5)):
        own = math.sqrt(shared) * drawn[4] + math.sqrt(1.0 - shared) * drawn[:4]
        values = shifts[:, None] + scales[:, None] * own
        found = over_cells((seeds(*x[:n]), still) for x, n in zip(values, sizes, strict=True))
        covered += found.low <= 0.0 <= found.high
        assert (verdict_of(found) is UNDECIDED) == (found.low <= 0.0 <= found.high)
    assert covered / trials == pytest.approx(0.95, abs=0.02)


def test_cells_with_the_same_seeds_are_tested_by_the_means_of_seeds():
    """One-sample t-test of scipy; a second cell that says the same again adds nothing."""
    a, b = np.random.default_rng(4).normal(1.0, 1.0, size=(2, 5))
    zero = seeds(*np.zeros(5))
    test = over_cells([(seeds(*a), zero), (seeds(*b), zero)])
    expected = stats.ttest_1samp((a + b) / 2.0, 0.0)
    assert (test.p, test.freedom, test.n) == pytest.approx((float(expected.pvalue), 4.0, 5))
    assert (test.low, test.high) == pytest.approx(tuple(expected.confidence_interval(0.95)))
    alone, twice = over_cells([(seeds(*a), zero)]), over_cells([(seeds(*a), zero)] * 2)
    assert (twice.low, twice.high) == pytest.approx((alone.low, alone.high))


def test_samples_without_common_seeds_are_unpaired_among_cells_too():
    a, b = seeds(-50.0, -52.0, -51.0), seeds(-60.0, -56.0, -59.0, -70.0, first=10)
    alone, among = difference(a, b), over_cells([(a, b)])
    for name in ("mean", "low", "high", "freedom", "p"):
        assert getattr(among, name) == pytest.approx(getattr(alone, name))
    two = over_cells([(a, b), (seeds(1.0, 2.0, 1.5), seeds(0.0, 0.1, 0.0))])
    assert two.mean == pytest.approx(0.5 * (alone.mean + 1.5 - 0.1 / 3.0))


def test_cells_with_a_single_seed_are_left_out_of_many():
    whole = (seeds(1.0, 3.0, 2.0), seeds(0.0, 0.0, 0.5))
    single, half = (seeds(9.0), seeds(0.0)), (seeds(9.0, 8.0), seeds(0.0, first=5))
    assert over_cells([whole, single, half]) == over_cells([whole])
    assert verdict_of(over_cells([single, half])) is UNTESTED
    assert over_cells([single, half]).n == 0


@pytest.mark.parametrize(
    ("apart", "verdict"),
    [(1.0, SUPPORTED), (-1.0, REFUTED), (0.0, UNDECIDED)],
)
def test_differences_without_scatter_decide_unless_they_are_zero(apart, verdict):
    pair = (seeds(apart, apart), seeds(0.0, 0.0))
    assert verdict_of(difference(*pair)) is verdict
    assert verdict_of(over_cells([pair])) is verdict


def test_constant_differences_of_opposite_cells_are_a_tie():
    pair = (seeds(2.0, 3.0), seeds(1.0, 2.0))
    assert over_cells([pair, pair]) == Estimate(1.0, math.nan, 2, 1.0, 1.0)
    assert over_cells([pair, pair[::-1]]) == Estimate(0.0, math.nan, 2, 0.0, 0.0)


def test_a_tie_is_undecided_and_not_won():
    tie = over_cells([(seeds(1.0, -1.0, 0.1), seeds(0.0, 0.0, 0.0))])
    assert tie.mean > 0.0
    assert verdict_of(tie) is UNDECIDED
    found = estimate((0.9, 1.0, 1.1))
    for p, verdict in ((0.051, UNDECIDED), (0.049, SUPPORTED), (math.nan, UNTESTED)):
        assert above(found, p) is verdict
    assert above(estimate((-0.9, -1.0, -1.1)), 0.049) is REFUTED


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        ([SUPPORTED, SUPPORTED], SUPPORTED),
        ([SUPPORTED, UNTESTED], UNDECIDED),
        ([SUPPORTED, UNDECIDED], UNDECIDED),
        ([UNDECIDED, UNTESTED], UNDECIDED),
        ([SUPPORTED, SUPPORTED, REFUTED], REFUTED),
        ([UNDECIDED, REFUTED, UNTESTED], REFUTED),
        ([UNTESTED, UNTESTED], UNTESTED),
        ([], UNTESTED),
    ],
)
def test_every_cell_must_support_and_one_refutes(found, verdict):
    assert every(found) is every(reversed(found)) is verdict


def test_the_correction_changes_a_verdict_and_not_its_direction():
    tests = [estimate(sign * x for x in (0.75, 1.0, 1.25)) for sign in (1.0, -1.0)]
    assert [one.p for one in tests] == pytest.approx([0.02, 0.02], abs=0.001)
    assert by_cell(tests) == [SUPPORTED, REFUTED]
    assert by_cell([*tests, tests[0]]) == [UNDECIDED] * 3


def test_a_single_seed_has_no_verdict():
    assert verdict_of(estimate([3.0])) is UNTESTED
    assert verdict_of(difference(seeds(1.0), seeds(0.0))) is UNTESTED


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.0, 1.0, SUPPORTED),
        (0.5, 1.1, UNDECIDED),
        (1.0, 1.1, UNDECIDED),
        (1.01, 1.1, REFUTED),
        (math.nan, 1.1, UNTESTED),
    ],
)
def test_a_bound_is_judged_by_the_whole_interval(low, high, verdict):
    assert below(1.0, low, high) is verdict
