"""What a diagnosis says in sentences, and the numbers in them."""

import diagnoses_for_tests
import pytest
from diagnoses_for_tests import HOSTILE, load

from bench.diagnosis_report.gap_text import where_sentence
from bench.diagnosis_report.remedy import remedy
from bench.diagnosis_report.sentences import (
    effect_phrase,
    kind_label,
    next_flight,
    remarks,
    verdict,
)
from bench.diagnosis_report.tables import candidates_table, effect_heading, parameters_table
from bench.text.words import clean
from diagnosis.result import Effect, Parameter
from simulators import registry
from simulators.effects.card import load_card, load_cards


def sentence(kind):
    return verdict(load(diagnoses_for_tests.ALL[kind]()))


def remarks_on(kind):
    return remarks(load(diagnoses_for_tests.ALL[kind]()))


def test_verdict_names_size_interval_probability_and_drift():
    assert sentence("effect") == (
        "These flights are explained by 12.0 % more mass than believed (95 %: 11.2 to 12.7 %), "
        "probability 0.98. With it in the simulator, its drift from held-out flights over 0.5 s "
        "falls from 34 mm to 6.1 mm."
    )


def test_verdict_of_a_pair_names_both_with_the_probability_of_the_set():
    said = sentence("pair")
    assert "x = -0.771 m/s² (95 %: -0.802 to -0.741 m/s²)" in said
    assert "together with commands that take effect 48.1 ms later" in said
    assert "probability 0.91" in said
    aside = f"Left out, half a second each, for standing out alone: {HOSTILE} at 4.5 s."
    assert aside in remarks_on("pair")
    soon = "Left out, half a second each, for standing out soon after a gap in the log"
    assert any(line.startswith(soon) for line in remarks_on("pair"))
    left = "12 % of the gap stays unexplained, most of it in velocity drift z."
    assert left in remarks_on("pair")


def test_the_verdict_states_its_own_probability():
    found = diagnoses_for_tests.effect() | {"probability": 0.6}
    assert "probability 0.60." in verdict(load(found))


def test_a_doubted_effect_comes_with_the_reason():
    found = diagnoses_for_tests.effect()
    assert not any("More than noise" in line for line in remarks(load(found)))
    found["doubt"] = {"structure": 8.9, "true_share": 0.6}
    assert remarks(load(found))[0] == (
        "More than noise is left (8.9 times it); where that was so, 60 % of the effects named in "
        "cases with known answers were true."
    )


def test_a_gap_that_is_partly_explained_is_said_to_be():
    found = diagnoses_for_tests.partly()
    assert verdict(load(found)) == (
        "Part of what separates these flights from the simulator is explained by 12.0 % more mass "
        "than believed (95 %: 11.2 to 12.7 %), which flights left out of the fit confirm. 83 % of "
        "the gap, mostly in velocity drift z (70 %), fits no known effect."
    )
    found["remainder"] |= {"share": 0.002, "mostly_explained": True}
    said = verdict(load(found))
    assert said.startswith("Most of what separates these flights from the simulator is explained")
    assert ". < 1 % of the gap, mostly in velocity drift z" in said


def test_an_effect_that_explains_a_part_comes_with_what_looks_like_it():
    found = diagnoses_for_tests.partly()
    found["effects"][0]["aliases"] = ["thrust_gain"]
    alike = "In these flights, thrust gain would look nearly the same as mass. 83 %"
    assert alike in verdict(load(found))
    assert kind_label(load(found)) == "Partly explained"


def test_silence_of_too_few_flights_is_no_all_clear():
    found = diagnoses_for_tests.none() | {"verdict": "too_few"}
    assert verdict(load(found)).startswith("Too few flights to tell whether anything changed: ")


def test_too_few_flights_say_what_a_change_would_look_like():
    found = diagnoses_for_tests.reference() | {"verdict": "too_few"}
    found["effects"][0]["blamed"] = False
    said = verdict(load(found))
    assert "beside" in said
    assert "If something did, it looks most like" in said
    assert said.endswith("but two flights of an unchanged vehicle may differ as much.")


def test_a_twin_of_the_reference_is_said_to_stand_between():
    found = diagnoses_for_tests.reference()
    found["details"]["followed"] = [
        {"channel": "roll", "unit": "rad", "simulator": 0.0333, "twin": 0.0078},
        {"channel": "acceleration up", "unit": "m/s^2", "simulator": 0.56, "twin": 0.09},
    ]
    (said,) = [line for line in remarks(load(found)) if "twin" in line]
    assert said.endswith("it is off by 0.090 m/s² in acceleration up, the simulator by 0.56 m/s².")


def test_a_probability_of_effects_that_look_alike_is_given_to_all_of_them():
    """Beside a twin 0.99 is of the class, of which the table gives 0.86 to one effect."""
    found = diagnoses_for_tests.beside_twin(diagnoses_for_tests.alias())
    (effect,) = found["effects"]
    found["probability"] = effect["probability"] = 0.99
    diagnosis = load(found)
    together = "mass or thrust gain or battery, probability 0.99 together"
    assert f"; {together}." in verdict(diagnosis)
    assert effect_heading(diagnosis, diagnosis.effects[0]) == together
    assert "an effect and what looks like it" in " ".join(candidates_table(diagnosis).notes)
    effect["aliases"] = []
    assert "together" not in verdict(load(found))
    alone = load(diagnoses_for_tests.alias())
    assert effect_heading(alone, alone.effects[0]) == "mass, probability 0.52"
    assert "is the sum over all sets that hold it." in " ".join(candidates_table(alone).notes)


@pytest.mark.parametrize(
    ("aliases", "shared"),
    [
        (["thrust_gain"], True),
        (["thrust_gain", "battery"], True),
        (["battery"], False),
        ([], False),
    ],
)
def test_what_aliases_have_in_common_is_said_where_one_of_them_has_it(aliases, shared):
    """Thrust over mass does not say how a battery fades."""
    found = diagnoses_for_tests.alias()
    found["effects"][0]["aliases"] = aliases
    assert ("thrust over mass" in verdict(load(found))) == shared


def test_an_interval_that_no_mass_could_have_is_not_turned_into_one_of_thrust_over_mass():
    found = diagnoses_for_tests.effect()
    (blamed,) = found["effects"]
    blamed |= {"name": "mass", "aliases": ["thrust_gain"]}
    blamed["parameters"] = [diagnoses_for_tests.parameter("e", 0.25, -5.05, 5.23, "-")]
    assert "by 20.0 % less thrust over mass than believed, as 25 % more" in verdict(load(found))


def test_beside_a_twin_flights_are_compared_by_how_they_differ_among_themselves():
    found = diagnoses_for_tests.none()
    assert "beyond noise:" in verdict(load(found))
    line = {"channel": "roll", "unit": "rad", "simulator": 0.03, "twin": 0.01}
    found["details"]["followed"] = [line]
    assert "beyond what they differ by among themselves:" in verdict(load(found))


def test_too_few_flights_are_no_reason_to_change_nothing():
    found = diagnoses_for_tests.none() | {"verdict": "too_few"}
    (said,) = remedy(load(found))
    assert said == "Nothing yet: there are too few flights to tell whether anything changed."


def remaining(*channels):
    """A gap that is partly explained, with what is left: channel, share, main, beyond noise."""
    found = diagnoses_for_tests.partly()
    found["remainder"]["where"] = [
        diagnoses_for_tests.channel(name, "rad", 0.1, 0.01, share, main) | {"beyond_noise": beyond}
        for name, share, main, beyond in channels
    ]
    return found


YAW = ("yaw", 0.62, True, False)
"""The largest remainder, within its noise."""


@pytest.mark.parametrize(
    ("where", "partly", "unexplained"),
    [
        (
            [YAW, ("pitch", 0.15, False, True)],
            "83 % of the gap fits no known effect; of this remainder, what is beyond noise lies in "
            "pitch (15 %).",
            "; the remainder stands out of noise in pitch (15 %).",
        ),
        (
            [YAW],
            "83 % of the gap fits no known effect, and no single channel stands out of noise.",
            "; no single channel of the remainder stands out of noise.",
        ),
    ],
)
def test_a_remainder_is_told_in_channels_that_stand_out_of_noise(where, partly, unexplained):
    found = remaining(*where)
    assert verdict(load(found)).endswith(partly)
    found |= {"verdict": "unexplained", "effects": diagnoses_for_tests.unexplained()["effects"]}
    said = verdict(load(found))
    assert said.endswith(unexplained)
    assert "yaw" not in said


def test_a_fault_of_the_logs_comes_before_any_physics():
    found = diagnoses_for_tests.partly()
    found["verdict"], found["probability"] = "unexplained", None
    found["effects"] = [effect | {"blamed": False} for effect in found["effects"]]
    flip = {"part": "frame of the path", "readings": ["y flipped"], "advice": "Check y."}
    found["interface"] = [flip | {"evidence": []}]
    assert verdict(load(found)) == (
        "These flights differ from the simulator, but their logs do not say what the format asks "
        "for (frame of the path); mend that first: until then no cause in the vehicle can be named."
    )
    assert remarks(load(found))[0] == "Check y."
    assert not any("do not confirm" in line for line in remarks(load(found)))
    assert kind_label(load(found)) == "Mend the logs first"
    assert next_flight(load(found)) == ""
    assert remedy(load(found))[0] == "Check y."
    found["interface"] = []
    assert next_flight(load(found)) == found["next_flight"]


def test_a_fault_of_the_logs_stands_in_the_headline_where_nothing_else_is_wrong():
    turn = {"part": "heading", "readings": ["turned"], "advice": "Check.", "evidence": []}
    found = diagnoses_for_tests.none() | {"interface": [turn]}
    assert verdict(load(found)).endswith("s in all), but check the logs: heading.")
    assert kind_label(load(found)) == "Check the logs"
    assert remedy(load(found)) == [
        "Check.",
        "In the vehicle nothing: these flights show no change that stands out of noise.",
    ]


@pytest.mark.parametrize(
    ("name", "alias", "said"),
    [
        (
            "mass",
            "thrust_gain",
            "16.7 % less thrust over mass than believed (95 %: 13.0 to 20.0 %), as 20 % more mass "
            "than believed would give",
        ),
        (
            "thrust_gain",
            "mass",
            "20 % more thrust over mass than believed (95 %: 15 to 25 %), as 20 % more thrust at "
            "the same command than believed would give",
        ),
    ],
)
def test_of_effects_that_look_alike_what_they_share_is_told(name, alias, said):
    found = diagnoses_for_tests.effect()
    (blamed,) = found["effects"]
    blamed |= {"name": name, "aliases": [alias]}
    blamed["parameters"] = [diagnoses_for_tests.parameter("e", 0.2, 0.15, 0.25, "-")]
    assert f"are explained by {said}, probability" in verdict(load(found))


def test_the_badge_of_a_gap_that_a_set_makes_up_for_is_not_unexplained():
    found = diagnoses_for_tests.unexplained()
    assert kind_label(load(found)) == "Unexplained"
    found["remainder"] |= {"share": 0.05, "mostly_explained": True}
    assert kind_label(load(found)) == "No cause confirmed"


def test_names_that_are_no_text_can_be_printed():
    assert clean("\udcfcbung").encode() == "\ufffdbung".encode()


def test_verdict_against_reference_flights_says_what_changed():
    said = sentence("reference")
    assert said.startswith("What changed since the reference flights: 8.1 % less thrust")
    assert "(95 %: 7.2 to 9.0 %), probability > 0.99." in said
    reasons = [line for line in remarks_on("reference") if "2 flights" in line]
    assert len(reasons) == 1


def test_verdict_names_what_the_data_cannot_tell_apart():
    said = sentence("alias")
    assert "thrust gain or battery would look nearly the same as mass." in said
    assert kind_label(load(diagnoses_for_tests.alias())) == "Explained, with an alternative"


def test_directions_are_words_and_not_signs():
    """Nobody remembers which side is down at a roll of -1 degree."""
    sizes = [("roll", -0.0186), ("pitch", 0.0489)]
    trim = Effect(
        name="trim",
        blamed=True,
        probability=0.9,
        aliases=(),
        parameters=tuple(
            Parameter(
                name=name, value=x, low=None, high=None, unit="rad", at_bound="no", use="measured"
            )
            for name, x in sizes
        ),
    )
    said = effect_phrase(trim, "before")
    assert said.endswith("leans by 1.07° left side down and 2.80° nose down")


def test_silence_says_that_a_small_change_could_hide():
    found = diagnoses_for_tests.none()
    assert any("could still hide" in line for line in remarks(load(found)))
    found["details"]["limits"] = []
    assert not any("could still hide" in line for line in remarks(load(found)))


def test_verdict_without_an_effect_blames_none():
    assert where_sentence(load(diagnoses_for_tests.none())) == "No channel stands out of its noise."
    assert sentence("none").startswith("Nothing separates these flights from the simulator")
    said = sentence("unexplained")
    assert "no known effect explains how; the likeliest set leaves 83 % of the gap;" in said
    assert "the remainder lies mostly in velocity drift z (70 %)" in said
    for name in ("none", "unexplained", "empty"):
        assert "explained by" not in sentence(name)
        assert "mass" not in sentence(name)


def test_a_set_that_makes_up_for_most_of_a_gap_is_told_though_none_of_it_is_blamed():
    """What a set follows is no "nobody knows how", and no cause either."""
    found = diagnoses_for_tests.unexplained()
    found["remainder"] |= {"share": 0.05, "mostly_explained": True}
    said = verdict(load(found))
    assert "gust would make up for all but 5 % of the gap, but no effect among them passes" in said
    assert "no known effect explains how" not in said


def test_an_interval_wider_than_the_range_is_no_number():
    """Of effects that only act together, none has a size by itself: -505 to 523 % says nothing."""
    found = diagnoses_for_tests.effect()
    (size,) = found["effects"][0]["parameters"]
    size |= {"low": -5.05, "high": 5.23}
    said = verdict(load(found))
    assert "(95 %: wider than its range)" in said
    assert "523" not in said
    (row,) = parameters_table(load(found).effects[0]).rows
    assert row[2] == "wider than its range"
    size |= {"low": 0.1, "high": 0.3}
    assert "wider" not in verdict(load(found))


@pytest.mark.parametrize(("end", "said"), [("high", "at least 12.0 %"), ("low", "at most 12.0 %")])
@pytest.mark.parametrize("kind", ["effect", "partly"])
def test_a_size_at_the_end_of_its_range_says_to_which_side_it_points(kind, end, said):
    found = diagnoses_for_tests.ALL[kind]()
    blamed = next(effect for effect in found["effects"] if effect["blamed"])
    blamed["name"] = "mass"
    blamed["parameters"] = [
        diagnoses_for_tests.parameter("e", 0.12, None, None, "-", "descriptive")
    ]
    blamed["parameters"][0]["at_bound"] = end
    ends = [line for line in remarks(load(found)) if line.startswith("At the end of its")]
    assert len(ends) == 1
    assert f"relative change of mass ({said}" in ends[0]


PLAIN = {
    ("attitude_loop", "damping"),
    ("collision", "stiffness"),
    ("collision", "friction"),
    ("downwash", "strength"),
    ("floor", "height"),
    ("gust", "onset"),
}
"""Parameters whose names are words."""


def test_every_registered_effect_and_parameter_has_words():
    for name, kind in registry.load_all("effect").items():
        assert kind.card is not None
        assert kind.card.shown.keys() <= kind.parameters.keys()
        for parameter in kind.parameters:
            assert (parameter in kind.card.shown) != ((name, parameter) in PLAIN)


@pytest.mark.parametrize("name", [*load_cards(), "third_party"])
@pytest.mark.parametrize("value", [-0.2, 0.0, 0.3])
@pytest.mark.parametrize("bounded", [True, False])
def test_every_effect_can_be_told_in_a_sentence(name, value, bounded):
    names = [*load_card(name).shown] or ["p"]
    ends = (value - 0.01, value + 0.01) if bounded else (None, None)
    sizes = tuple(
        Parameter(
            name=p, value=value, low=ends[0], high=ends[1], unit="-", at_bound="no", use="measured"
        )
        for p in names
    )
    effect = Effect(name=name, blamed=True, probability=0.9, aliases=(), parameters=sizes)
    said = effect_phrase(effect, "believed")
    assert "{" not in said
    assert "--" not in said
    assert ("95 %" in said) == bounded
