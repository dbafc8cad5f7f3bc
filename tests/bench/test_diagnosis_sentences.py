"""What a diagnosis says in sentences, and the numbers in them."""

import math

import diagnoses_for_tests
import pytest
from diagnoses_for_tests import HOSTILE

from bench.diagnosis_report.numbers import clean, estimate, number, probability, quantity
from bench.diagnosis_report.sentences import (
    Request,
    effect_phrase,
    remarks,
    shrink_sentence,
    verdict,
    where_sentence,
)
from simulators import registry
from simulators.effects.card import load_card, load_cards

REQUEST = Request(HOSTILE)
AGAINST = Request("changed", reference="plain")


def sentence(kind, request=REQUEST):
    return verdict(diagnoses_for_tests.ALL[kind](), request)


def test_verdict_names_size_interval_probability_and_drift():
    assert sentence("effect") == (
        "These flights are explained by 12.0 % more mass than believed (95 %: 11.2 to 12.7 %), "
        "probability 0.98; the drift over 0.5 s on held-out flights falls from 34 mm to 6.1 mm."
    )


def test_verdict_of_a_pair_names_both_with_the_probability_of_the_set():
    said = sentence("pair")
    assert "x = -0.771 m/s² (95 %: -0.802 to -0.741 m/s²)" in said
    assert "together with commands that take effect 48.1 ms later" in said
    assert "probability 0.91" in said
    aside = f"Left out, half a second each, for standing out alone: {HOSTILE} at 4.5 s."
    assert aside in remarks(diagnoses_for_tests.pair(), REQUEST)
    soon = "Left out, half a second each, for standing out soon after a gap in the log"
    assert any(line.startswith(soon) for line in remarks(diagnoses_for_tests.pair(), REQUEST))
    left = "12 % of the gap stays unexplained, mostly in velocity drift z (70 %)."
    assert left in remarks(diagnoses_for_tests.pair(), REQUEST)


def test_the_verdict_is_no_surer_than_its_effects():
    """A posterior is only among the candidates; what is left may say that all are wrong."""
    found = diagnoses_for_tests.effect()
    found["effects"][0]["probability"] = 0.6
    found["candidates"][0]["probability"] = 1.0
    assert "probability 0.60;" in verdict(found, REQUEST)
    found["effects"][0]["probability"] = 0.995
    found["candidates"][0]["probability"] = 0.7
    assert "probability 0.70;" in verdict(found, REQUEST)


def test_a_doubted_effect_comes_with_the_reason():
    found = diagnoses_for_tests.effect()
    found["details"]["structure"] = {"before": 5000.0, "after": 8.9}
    assert not any("More than noise" in line for line in remarks(found, REQUEST))
    found["effects"][0]["probability"] = 0.6 * found["candidates"][0]["probability"]
    assert remarks(found, REQUEST)[0] == (
        "More than noise is left (8.9 times it); where that was so, 60 % of the effects named in "
        "cases with known answers were true."
    )
    found["details"].pop("structure")
    assert not any("More than noise" in line for line in remarks(found, REQUEST))


def test_a_gap_that_is_mostly_explained_is_said_to_be():
    found = diagnoses_for_tests.confirmed() | {"unexplained_share": 0.002}
    assert verdict(found, REQUEST) == (
        "Most of what separates these flights from the simulator is explained with mass, which "
        "flights that were left out confirm; < 1 % of the gap, far above noise, mostly in velocity "
        "drift z (70 %), fits no known effect."
    )
    assert remarks(found, REQUEST)[0] == (
        "What is left may shift every size, so that none is stated; with the likeliest set the "
        "drift over 0.5 s on held-out flights falls from 34 mm to 6.1 mm."
    )
    found["details"]["support"][0]["clear"] = False
    assert "no known effect explains how" in verdict(found, REQUEST)


def test_names_that_are_no_text_can_be_printed():
    assert clean("\udcfcbung").encode() == "\ufffdbung".encode()


def test_verdict_against_reference_flights_says_what_changed():
    said = sentence("reference", AGAINST)
    assert said.startswith("What changed since the reference flights: 8.1 % less thrust")
    assert "(95 %: 7.2 to 9.0 %), probability > 0.99." in said
    reasons = [
        line for line in remarks(diagnoses_for_tests.reference(), AGAINST) if "2 flights" in line
    ]
    assert len(reasons) == 1


def test_verdict_names_what_the_data_cannot_tell_apart():
    said = sentence("alias")
    assert "cannot tell mass from thrust gain or linear drag + battery" in said


def test_verdict_without_an_effect_blames_none():
    assert where_sentence(diagnoses_for_tests.none()) == "No channel stands out of its noise."
    assert sentence("none").startswith("Nothing separates these flights from the simulator")
    said = sentence("unexplained")
    assert "no known effect explains how; 83 % of the gap stays" in said
    assert "what is left lies mostly in velocity drift z (70 %)" in said
    for name in ("none", "unexplained", "empty"):
        assert "explained by" not in sentence(name)
        assert "mass" not in sentence(name)


def test_drift_that_grows_is_not_said_to_fall():
    found = diagnoses_for_tests.effect()
    found["shrink"] |= {"after": 0.05, "percent": -46.0, "low": -60.0, "high": -30.0}
    said = verdict(found, REQUEST)
    assert "falls" not in said
    assert "34 mm to 50 mm" in said
    assert "grows" in shrink_sentence(found)
    assert "46 % more (95 %: 30 to 60 %)" in shrink_sentence(found)


PLAIN = {
    ("attitude_loop", "damping"),
    ("downwash", "strength"),
    ("floor", "height"),
    ("gust", "onset"),
}
"""Parameters whose names are words."""


def test_half_seconds_that_count_nowhere_are_counted_beside_the_shrink():
    found = diagnoses_for_tests.effect()
    assert "neither" not in shrink_sentence(found)
    found["details"]["windows"] = {"n": 236, "aside": 3}
    assert shrink_sentence(found).endswith(
        "soon after a gap in the log, or alone, are in neither: 3 of 236."
    )


def test_every_registered_effect_and_parameter_has_words():
    for name, kind in registry.load_all("effect").items():
        assert kind.card is not None
        assert kind.card.shown.keys() <= kind.parameters.keys()
        for parameter in kind.parameters:
            assert (parameter in kind.card.shown) != ((name, parameter) in PLAIN)


@pytest.mark.parametrize("name", [*load_cards(), "third_party"])
@pytest.mark.parametrize("value", [-0.2, 0.0, 0.3, None])
def test_every_effect_can_be_told_in_a_sentence(name, value):
    names = [*load_card(name).shown] or ["p"]
    ends = (None, None) if value is None else (value - 0.01, value + 0.01)
    parameters = {p: diagnoses_for_tests.parameter(value, *ends, "-") for p in names}
    said = effect_phrase({"name": name, "parameters": parameters}, "believed")
    assert "{" not in said
    assert "--" not in said
    assert ("95 %" in said) == (value is not None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (number(0.00999, 2), "0.010"),
        (number(1234.5), "1234"),
        (number(math.nan), "-"),
        (quantity(0.0341, "m", 2), "34 mm"),
        (quantity(1.26, "m", 2), "1.3 m"),
        (quantity(0.1, "rad"), "5.73°"),
        (estimate(12.03, 11.21, 12.74), ("12.0", "11.2 to 12.7")),
        (estimate(0.5, None, None), ("0.500", "")),
        (estimate(-0.0001, -0.5, 0.5), ("0.0", "-0.5 to 0.5")),
        (probability(0.9999), "> 0.99"),
        (probability(None), "-"),
        (clean("a\x1b[31m\nb\u202e"), "a [31m b"),
    ],
)
def test_numbers_read_well(text, expected):
    assert text == expected
