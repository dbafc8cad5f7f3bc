"""Limits on a linear toy with closed forms, and how effects are sized."""

import types

import numpy as np
import pytest
from scipy import stats
from toy_library import toy_library

from blind.draw.catalogue import LIBRARY, Withheld
from blind.score.limit_checks import CHECKED, REPEATS, checks
from blind.score.limits import DRAWS, Linear, drawn, noise_scores, size_of, sized
from diagnosis.decision import Decision
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.search import Fits
from diagnosis.fit.windows import Normal

WINDOWS = 4000
"""So many that their structure hardly scatters."""


class Flat(Likelihood):
    """Windows that all say the same: drag and mass at an angle, the others orthogonal."""

    def __init__(self, angle, truth, sigma):
        columns = np.eye(4)
        columns[:2, 1] = np.cos(angle), np.sin(angle)
        J = columns / sigma / np.sqrt(WINDOWS)
        replay = types.SimpleNamespace(library=toy_library("x", "m", 1.0, local=("trim", "wind")))
        groups = [types.SimpleNamespace(start=np.zeros(1))]
        vars(self).update(J=J, truth=np.asarray(truth), replay=replay, groups=groups)  # frozen

    def normal(self, vector, along=None, others=False):
        r = self.J @ (self.truth - vector)
        per_window = lambda x: np.repeat(np.asarray(x)[None], WINDOWS, axis=0)  # noqa: E731
        return Normal(
            H=per_window(self.J.T @ self.J),
            g=per_window(self.J.T @ r),
            c=np.full(WINDOWS, r @ r),
            dof=np.full(WINDOWS, 9.0),
            flight=np.arange(WINDOWS) * 8 // WINDOWS,
            t=np.arange(WINDOWS) % 20 * 0.5,
            kind=np.zeros((WINDOWS, 9)),
            doubtful=np.zeros(WINDOWS, bool),
        )


def linear(angle=np.pi / 2, sigma=1e-3):
    effect = Withheld("drag", {"x": 0.02})
    return Linear(Fits.of(Evidence.of(Flat(angle, [0.02, 0.0, 0.0, 0.0], sigma))), effect)


def test_without_rivals_the_limit_is_that_of_a_noncentral_chi_square():
    found = linear().limit(8, 1.0)
    cost = np.log(2.0 / np.sqrt(2 * np.pi)) + 0.5 * np.log(1e6) + Decision().effect_cost
    # Named from a score beyond sqrt(2 cost) standard deviations on.
    expected = 1e-3 * (np.sqrt(2 * cost) + stats.norm.ppf(0.9))
    assert found.size == pytest.approx(expected, rel=0.05)
    assert found.rival == "none"
    assert found.bound == pytest.approx(1e-3 * (stats.norm.ppf(0.98) + stats.norm.ppf(0.9)))
    assert found.bound < found.size


def test_a_rival_with_a_similar_signature_raises_the_limit():
    angle = 0.1
    found = linear(angle).limit(8, 1.0)
    assert found.rival == "mass"
    # The better of two hypotheses that are d apart is taken for the other one in 10 % of cases.
    apart = 2.0 * np.sin(angle / 2.0) * found.size / 1e-3
    assert stats.norm.cdf(0.5 * apart) == pytest.approx(0.9, abs=0.02)


def test_limits_scale_with_noise_and_with_the_root_of_the_flights():
    one = linear()
    usual = one.limit(8, 1.0)
    assert one.limit(8, 3.0).bound == pytest.approx(3.0 * usual.bound)
    assert one.limit(8, 3.0).size == pytest.approx(3.0 * usual.size, rel=0.1)
    # The bound is that of all flights, those that are left out of the fit included.
    assert one.limit(96, 1.0).bound == pytest.approx(usual.bound / np.sqrt(12.0), rel=0.01)
    assert one.named(usual.size, 8, 1.0) == pytest.approx(0.9, abs=0.03)
    assert one.named(2.0 * usual.size, 8, 1.0) > 0.97


def test_noise_is_as_large_as_the_information_in_whatever_units():
    units = np.asarray([3e4, 0.0, 2.0, 1e-4])
    alike = np.eye(4)
    alike[0, 2] = alike[2, 0] = 0.8
    scores = noise_scores(alike * np.outer(units, units), np.random.default_rng(0))
    assert scores.shape == (DRAWS, 4)
    assert not scores[:, 1].any()
    told = np.asarray([0, 2, 3])
    found = np.cov((scores[:, told] / units[told]).T)
    np.testing.assert_allclose(found, alike[np.ix_(told, told)], atol=0.1)


def test_a_limit_beyond_the_bounds_is_none():
    assert np.isnan(linear(sigma=1.0).limit(1, 3.0).size)


@pytest.mark.parametrize("name", LIBRARY)
def test_effects_are_sized_without_changing_when_or_how_wide_they_are(name):
    effect = drawn(name)
    small = sized(effect, 0.1 * size_of(effect))
    assert size_of(small) == pytest.approx(0.1 * size_of(effect))
    for parameter in {"onset", "width"} & set(effect.parameters):
        assert small.parameters[parameter] == effect.parameters[parameter]


def test_motors_are_sized_from_their_neutral_value():
    assert sized(Withheld("motor_lag", {"scale": 1.7}), 0.35).parameters["scale"] == 1.35


def test_checks_cover_every_effect_before_they_repeat():
    assert {c[0] for c in checks()[: len(checks()) // REPEATS]} == set(CHECKED)
