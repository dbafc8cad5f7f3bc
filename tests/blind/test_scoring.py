"""Scores of answers whose worth is known."""

import dataclasses
import math

import numpy as np
import pytest

from blind.draw import cases
from blind.draw.catalogue import Withheld
from blind.score.identifiable import compare
from blind.score.scoring import proportion, score


def case(kind, *effects, size="medium"):
    made = tuple(Withheld(name, parameters) for name, parameters in effects)
    name = f"{kind}-{'-'.join(e.name for e in made)}-{size}"
    return cases.Case(id=name, kind=kind, effects=made, size=size, seed=0)


def effect(name, probability=0.9, aliases=(), spread=0.1, **values):
    parameters = {
        key: {"value": v, "low": v - spread, "high": v + spread, "unit": "-"}
        for key, v in values.items()
    }
    return {
        "name": name,
        "probability": probability,
        "aliases": list(aliases),
        "parameters": parameters,
    }


def answer(*effects, verdict=None, unexplained=0.0, **rest):
    verdict = verdict or ("effect" if effects else "none")
    return {"verdict": verdict, "effects": effects, "unexplained_share": unexplained, **rest}


MASS = case("single", ("mass", {"e": 0.25}))
WIND = case("single", ("wind", {"x": 0.3, "y": 0.4, "z": 0.0}))
PAIR = case("pair", ("drag", {"c": 0.4}), ("delay", {"seconds": 0.02}))
CLEAN = case("clean", size="")
UNKNOWN = case("unknown", ("tether", {"k": 0.5}))
EXCLUDED = case("excluded", ("drag", {"c": 0.4}))
RIGHT = {
    MASS.id: answer(effect("mass", e=0.25)),
    WIND.id: answer(effect("wind", x=0.3, y=0.4, z=0.0)),
    PAIR.id: answer(effect("delay", seconds=0.02), effect("drag", c=0.4)),
    CLEAN.id: answer(),
    UNKNOWN.id: answer(verdict="unexplained"),
    EXCLUDED.id: answer(verdict="unexplained"),
}
ALL = {c.id: c for c in (MASS, WIND, PAIR, CLEAN, UNKNOWN, EXCLUDED)}


def value(scores, name, subset="decidable"):
    table = scores.proportions.set_index(["score", "cases"])["value"]
    return table[name, subset]


def test_right_answers_score_one_everywhere():
    scores = score(ALL, RIGHT)
    table = scores.proportions
    assert (table.loc[table["n"] > 0, "value"] == 1.0).all()
    assert scores.summary["median_parameter_error"] == pytest.approx(0.0, abs=1e-12)
    assert scores.cases.loc[scores.cases["kind"] == "single", "answer"].tolist() == ["mass", "wind"]


def test_missing_answers_score_zero():
    """A diagnosis that crashed is neither right nor an abstention."""
    table = score(ALL, {}).proportions
    table = table[~table["score"].isin(["decidable cases", "truth inside 95 % intervals"])]
    assert (table.loc[table["n"] > 0, "value"] == 0.0).all()


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    [(0, 75, 0.0, 0.0480), (75, 75, 0.9520, 1.0), (5, 10, 0.1871, 0.8129)],
)
def test_the_interval_of_a_proportion_is_as_published(hits, n, low, high):
    share = proportion(hits, n)
    np.testing.assert_allclose((share.low, share.high), (low, high), atol=5e-4)


def test_no_case_has_no_interval():
    none = proportion(0, 0)
    assert all(math.isnan(value) for value in (none.value, none.low, none.high))


def test_the_most_probable_effect_is_the_first_answer():
    given = answer(effect("drag", 0.3, c=0.1), effect("mass", 0.8, e=0.25))
    scores = score({MASS.id: MASS}, {MASS.id: given})
    assert value(scores, "top-1 of singles") == 1.0
    assert value(scores, "exact set of singles") == 0.0


def test_half_a_pair_is_not_the_pair():
    scores = score({PAIR.id: PAIR}, {PAIR.id: answer(effect("drag", c=0.4))})
    assert value(scores, "exact set of pairs") == 0.0
    assert value(scores, "top-1 of pairs") == 1.0


@pytest.mark.parametrize(
    ("given", "right"),
    [
        (answer(), True),
        (answer(effect("thrust_gain", aliases=("mass",), e=-0.2)), True),
        (answer(effect("drag", aliases=("quadratic_drag",), c=0.1)), False),
        (answer(verdict="unexplained"), False),
    ],
)
def test_an_undecidable_case_forgives_none_and_the_alias_class(given, right):
    scores = score({MASS.id: MASS}, {MASS.id: given}, {MASS.id: {"decidable": False}})
    assert value(scores, "top-1 of singles", "undecidable") == float(right)
    strict = score({MASS.id: MASS}, {MASS.id: given}, {MASS.id: {"decidable": True}})
    assert value(strict, "top-1 of singles") == 0.0


def test_an_alias_class_is_counted_beside_the_name():
    given = answer(effect("thrust_gain", aliases=("mass",), e=-0.2))
    scores = score({MASS.id: MASS}, {MASS.id: given})
    assert value(scores, "top-1 of singles, alias class") == 1.0


def test_blaming_another_effect_is_no_abstention_unless_more_is_flagged():
    blamed = {UNKNOWN.id: answer(effect("wind", x=0.1))}
    flagged = {UNKNOWN.id: answer(effect("wind", x=0.1), unexplained=0.4)}
    assert value(score({UNKNOWN.id: UNKNOWN}, blamed), "abstention, unknown effect") == 0.0
    scores = score({UNKNOWN.id: UNKNOWN}, flagged)
    assert value(scores, "abstention, unknown effect") == 1.0
    assert value(scores, "nothing blamed at all, both") == 0.0


def test_a_verdict_other_than_none_is_a_false_alarm():
    for given in (answer(effect("wind", x=0.1)), answer(verdict="unexplained")):
        scores = score({CLEAN.id: CLEAN}, {CLEAN.id: given})
        assert value(scores, "nothing found in clean flights") == 0.0


def test_mass_and_thrust_gain_compare_by_thrust_over_mass():
    truth = Withheld("mass", {"e": 0.25})
    (same,) = compare(truth, "thrust_gain", {"e": -0.2})
    assert same.error == pytest.approx(0.0, abs=1e-12)
    (half,) = compare(truth, "thrust_gain", {"e": -0.1})
    assert half.error == pytest.approx(0.5)


def test_components_of_a_vector_are_compared_together():
    truth = Withheld("gust", {"x": 0.3, "y": 0.4, "z": 0.0, "onset": 4.0})
    found = {c.quantity: c for c in compare(truth, "gust", {"x": 0.3, "y": 0.5, "onset": 4.2})}
    assert found["gust x y z"].error == pytest.approx(0.2)
    assert found["gust onset"].error == pytest.approx(0.2)
    assert not found["gust onset"].relative


def test_a_scale_is_compared_from_one():
    (found,) = compare(Withheld("motor_lag", {"scale": 1.5}), "motor_lag", {"scale": 1.6})
    assert found.error == pytest.approx(0.2)


def test_a_partly_right_answer_abstains_and_what_it_blames_counts():
    """Nothing of the library acts as it says: what it blames beside is wrong."""
    given = RIGHT | {EXCLUDED.id: answer(effect("wind", 0.6, x=0.1), verdict="partly")}
    scores = score(ALL, given)
    assert value(scores, "abstention, excluded effect") == 1.0
    assert value(scores, "nothing blamed at all, both") == 0.5
    row = scores.cases.set_index("case").loc[EXCLUDED.id]
    assert (row["verdict"], row["answer"]) == ("partly", "wind")
    low = scores.reliability.set_index("from").loc[0.6]
    assert (low["n"], low["value"]) == (1, 0.0)


def test_coverage_counts_every_interval_of_a_right_answer():
    given = answer(effect("wind", x=0.3, y=0.9, z=0.0))
    row = score({WIND.id: WIND}, {WIND.id: given}).proportions.set_index("score")
    row = row.loc["truth inside 95 % intervals"]
    assert (row["hits"], row["n"]) == (2, 3)


def test_reliability_compares_stated_with_true():
    answers = {
        MASS.id: answer(effect("mass", 0.9, e=0.25)),
        WIND.id: answer(effect("trim", 0.85, roll=0.1)),
        EXCLUDED.id: answer(effect("quadratic_drag", 0.3, k=0.2)),
    }
    scores = score({c.id: c for c in (MASS, WIND, EXCLUDED)}, answers)
    table = scores.reliability.set_index("from")
    assert table.loc[0.8, ["stated", "n", "value"]].tolist() == [0.875, 2, 0.5]
    assert table.loc[0.2, ["stated", "n", "value"]].tolist() == [0.3, 1, 0.0]
    assert scores.summary["brier"] == pytest.approx((0.1**2 + 0.85**2 + 0.3**2) / 3)


def test_probabilities_that_differ_by_rounding_share_a_bin():
    answers = {
        MASS.id: answer(effect("mass", 0.6, e=0.25)),
        WIND.id: answer(effect("trim", 0.6 * (1.0 - 1e-8), roll=0.1)),
    }
    table = score({c.id: c for c in (MASS, WIND)}, answers).reliability
    assert table[["from", "n"]].to_numpy().tolist() == [[0.6, 2]]


def test_shrink_stands_beside_the_oracles_and_the_best_wrong_ones():
    listed = [{"effects": ["mass"], "shrink_percent": 80.0}]
    given = {MASS.id: answer(effect("mass", e=0.25), candidates=listed, shrink={"percent": 78.0})}
    measured = {MASS.id: {"shrink_oracle": 80.0, "shrink_wrong": 30.0}}
    summary = score({MASS.id: MASS}, given, measured=measured).summary
    assert summary["median_shrink_over_oracle"] == pytest.approx(78 / 80)
    assert summary["median_shrink_of_best_wrong"] == 30.0
    # What the answer itself says of the true set is in no comparison.
    assert score({MASS.id: MASS}, given).summary["median_shrink_over_oracle"] is None


def test_half_widths_are_relative_to_the_effect():
    given = answer(effect("wind", x=0.3, y=0.4, z=0.0), effect("gust", x=1.0))
    (row,) = score({WIND.id: WIND}, {WIND.id: given}).parameters.to_dict("records")
    assert row["half_width"] == pytest.approx(0.1 * 3**0.5 / 0.5)


def test_an_offset_is_compared_over_the_inertia_and_its_interval_in_metres():
    """0.76 to 0.78 of the metres is no error beside a reference, but an interval must hold them."""
    offset = dataclasses.replace(
        case("single", ("center_of_mass", {"x": 0.005, "y": 0.0})), reality="rotorpy"
    )
    given = answer(effect("center_of_mass", spread=0.0005, x=0.0037, y=0.0))
    (row,) = score({offset.id: offset}, {offset.id: given}).parameters.to_dict("records")
    assert row["error"] < 0.06
    assert (row["inside"], row["intervals"]) == (1, 2)


def test_an_answer_without_a_case_is_named():
    with pytest.raises(ValueError, match="`answers` names a case that has no label: stray"):
        score({MASS.id: MASS}, {"stray": answer()})
