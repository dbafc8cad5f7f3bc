"""Decidability on a linear toy whose chi-squares are known, and the bound against closed forms."""

import dataclasses
import types

import numpy as np
import pytest
from toy_library import NAMES, toy_library

from blind.draw.catalogue import Withheld
from blind.score.identifiable import compare, over_bound
from diagnosis.decide.decidable import (
    contains,
    cramer_rao,
    decidability,
    rivals,
    unexplained,
    with_truth,
)
from diagnosis.decision import Decision
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.search import Fits
from diagnosis.fit.windows import Normal
from diagnosis.replay.library import Slot

BEGUN = types.SimpleNamespace(start=np.zeros(1))


class Linear(Likelihood):
    """Measurements y = J theta, noise one: chi-square of theta is |y - J theta|^2."""

    def __init__(self, columns, truth):
        J = np.asarray(columns, float).T
        replay, groups = types.SimpleNamespace(library=toy_library("p", "-", 100.0)), [BEGUN]
        vars(self).update(J=J, y=J @ truth, replay=replay, groups=groups)  # frozen, as its base

    def normal(self, vector, along=None, others=False):
        J, r = self.J, self.y - self.J @ vector
        one = np.zeros(1)
        return Normal(
            H=(J.T @ J)[None],
            g=(J.T @ r)[None],
            c=np.asarray([r @ r]),
            dof=np.asarray([float(len(r))]),
            flight=one.astype(int),
            t=one,
            kind=np.zeros((1, 9)),
            doubtful=one.astype(bool),
        )


def nominal(angle, size=100.0, hidden=0.0):
    """Drag is true; mass has a signature at `angle` to drag's, the others are orthogonal."""
    columns = [
        [1.0, 0.0, 0.0, 0.0, 0.0],
        [np.cos(angle), np.sin(angle), 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0, 0.0],
    ]
    linear = Linear(columns, np.asarray([size, 0.0, 0.0, 0.0]))
    vars(linear)["y"] = linear.y + np.asarray([0.0, 0.0, 0.0, 0.0, hidden])
    return Fits.of(Evidence.of(linear))


@pytest.mark.parametrize("angle", [0.03, 0.06, 0.3])
def test_the_margin_is_the_squared_distance_to_the_nearest_rival(angle):
    found = decidability(nominal(angle, 99.0), {"drag": {"p": 99.0}})
    expected = (99.0 * np.sin(angle)) ** 2
    assert found.rival == ("mass",)
    assert found.margin == pytest.approx(expected, rel=1e-3)
    assert found.decidable == (expected >= Decision().decidable_chi2)
    assert found.gap == pytest.approx(99.0**2)
    assert found.left == pytest.approx(0.0, abs=1e-9)


def test_a_small_effect_is_undecidable_from_nominal():
    found = decidability(nominal(1.2, size=3.0), {"drag": {"p": 3.0}})
    assert not found.decidable
    assert found.margin <= 9.0


def test_pairs_compete_with_their_parts_and_with_other_pairs():
    toy = nominal(0.5).evidence.likelihood
    vars(toy)["y"] = toy.J @ np.asarray([50.0, 0.0, 4.0, 0.0])
    found = decidability(Fits.of(Evidence.of(toy)), {"drag": {"p": 50.0}, "trim": {"p": 4.0}})
    assert not found.decidable
    assert found.margin == pytest.approx(16.0, rel=1e-3)
    assert "trim" not in found.rival


def test_supersets_and_special_cases_are_no_rivals():
    names = ("drag", "gust", "wind")
    assert list(rivals(frozenset({"wind"}), names)) == [frozenset({"drag"})]
    assert frozenset({"wind"}) in list(rivals(frozenset({"gust"}), names))
    assert not any(contains(r, frozenset({"drag"})) for r in rivals(frozenset({"drag"}), names))
    pairs = list(rivals(frozenset({"drag", "wind"}), names))
    assert frozenset({"drag", "gust"}) not in pairs
    assert frozenset({"drag"}) in pairs


def test_what_no_allowed_effect_explains_is_decidable():
    found = unexplained(nominal(0.5, hidden=30.0), NAMES, left=0.0)
    assert found.decidable
    assert found.margin == pytest.approx(900.0, rel=1e-3)
    assert not unexplained(nominal(0.5, hidden=4.0), NAMES, left=0.0).decidable
    # Without the true effect, and with the one at an angle to it.
    found = unexplained(nominal(0.5, 99.0), ("mass", "trim"), left=0.0)
    assert found.margin == pytest.approx((99.0 * np.sin(0.5)) ** 2, rel=1e-3)


def test_the_bound_of_two_correlated_parameters_is_the_inverse_of_their_normal_equations():
    fits = nominal(0.4)
    fit = with_truth(fits, {"drag": {"p": 100.0}, "mass": {"p": 0.0}})[frozenset({"drag", "mass"})]
    # Unit signatures at an angle: variance 1 / sin^2.
    assert cramer_rao(fits.evidence, fit)["drag"]["p"] == pytest.approx(1.0 / np.sin(0.4))
    alone = with_truth(fits, {"drag": {"p": 100.0}})[frozenset({"drag"})]
    assert cramer_rao(fits.evidence, alone)["drag"]["p"] == pytest.approx(1.0)


def factors():
    """The library with a drag that multiplies."""
    library = toy_library("p", "-", 100.0)
    multiplying = Slot("drag", "p", "-", 1.0, 0.1, 10.0, factor=True)
    return dataclasses.replace(library, slots=(multiplying, *library.slots[1:]))


@pytest.mark.parametrize("precision", [4.0, 1e9])
def test_the_bound_of_a_factor_is_that_of_a_ratio(precision):
    """Flights tell what there is to a variance of one, the reference tells what there was."""
    was, twice = np.asarray([1.5, 0.0, 0.0, 0.0]), 2.0
    likelihood = Linear(np.eye(4), was * twice)
    vars(likelihood)["replay"] = types.SimpleNamespace(library=factors())
    referenced = Evidence.of(likelihood, was, precision * np.eye(4))
    fit = with_truth(Fits.of(referenced), {"drag": {"p": twice}})[frozenset({"drag"})]
    expected = np.hypot(1.0, twice / np.sqrt(precision)) / 1.5
    assert cramer_rao(referenced, fit)["drag"]["p"] == pytest.approx(expected)


def test_a_true_effect_outside_the_library_is_an_error():
    with pytest.raises(ValueError, match=r"`truth` must name effects of the library.*'gale'"):
        with_truth(nominal(0.5), {"gale": {"p": 1.0}})


@pytest.mark.parametrize(
    ("truth", "name", "values", "bounds", "expected"),
    [
        (Withheld("drag", {"c": 0.4}), "drag", {"c": 0.43}, {"drag": {"c": 0.01}}, 3.0),
        (Withheld("gust", {"onset": 3.0}), "gust", {"onset": 3.2}, {"gust": {"onset": 0.1}}, 2.0),
        (
            Withheld("wind", {"x": 0.3, "y": 0.4}),
            "wind",
            {"x": 0.33, "y": 0.44},
            {"wind": {"x": 0.03, "y": 0.04}},
            1.0,
        ),
        (Withheld("motor_lag", {"scale": 1.5}), "motor_lag", {"scale": 1.6}, {}, None),
        # A small e: thrust over mass is off by as much as e.
        (Withheld("mass", {"e": 1e-4}), "mass", {"e": 3e-4}, {"mass": {"e": 1e-4}}, 2.0),
    ],
)
def test_errors_are_counted_in_bounds(truth, name, values, bounds, expected):
    (found,) = compare(truth, name, values)
    assert over_bound(truth, found, bounds) == (expected and pytest.approx(expected, rel=1e-3))
