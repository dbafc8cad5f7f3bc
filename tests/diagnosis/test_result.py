"""The typed answer: its published schema, its rules, and files of schema 1."""

import dataclasses
import json
from pathlib import Path

import jsonschema
import pytest
from diagnoses_for_tests import ALL, load

from blind.score.answers import scored_form
from diagnosis import statements
from diagnosis.decision import Decision
from diagnosis.result import Diagnosis, json_schema

PUBLISHED = Path(__file__).parents[2] / "docs" / "diagnosis.schema.json"


def schema_1(verdict, support=()):
    """A file of schema 1, as the program wrote it."""
    size = {"value": 0.1, "low": 0.08, "high": 0.12, "unit": "-"}
    mass = {"name": "mass", "probability": 0.9, "aliases": [], "parameters": {"e": size}}
    gap = {"channel": "specific force z", "unit": "m/s^2", "gap_rms": 1.2, "noise_floor": 0.1}
    gap |= {"share": 1.0, "low": 1.1, "high": 1.3, "regimes": [], "onset_s": None}
    fit = ["one", "two"]
    return {
        "schema": 1,
        "simulator": "crazyflow",
        "drone": "cf21B_500",
        "flights": {
            "n": 2,
            "seconds": 20.0,
            "input": "commands",
            "fit": fit,
            "held_out": fit,
            "left_out": [],
        },
        "where": [gap],
        "verdict": verdict,
        "unexplained_share": 0.3,
        "effects": [mass] if verdict == "effect" else [],
        "candidates": [
            {"effects": ["mass"], "probability": 0.8, "evidence": 9.0, "shrink_percent": 70.0}
        ],
        "shrink": {
            "horizon_s": 0.5,
            "unit": "m",
            "n": 2,
            **dict.fromkeys(("before", "after", "percent", "low", "high")),
            "by_channel": {},
            "reason": "2 flights",
        },
        "next_flight": "Nothing.",
        "details": {
            "flights_seconds": {"one": 10.0, "two": 10.0},
            "structure": {"before": 90.0, "after": 3.0},
            "best_set": ["mass"],
            "support": list(support),
            "reference": None,
            "excluded": ["wind"],
            "noise": {"position x": 0.0002},
        },
    }


CONFIRMS = {"effect": "mass", "percent": 60.0, "low": 50.0, "high": 70.0, "n": 4, "clear": True}


def test_the_published_schema_is_the_one_of_the_types():
    assert PUBLISHED.read_text(encoding="utf-8") == json_schema()
    jsonschema.Draft202012Validator.check_schema(json.loads(json_schema()))


@pytest.mark.parametrize("kind", ALL)
def test_every_kind_of_answer_is_of_the_schema_and_reads_back(kind, tmp_path):
    found = load(ALL[kind]())
    content = found.to_json()
    jsonschema.validate(content, json.loads(PUBLISHED.read_text(encoding="utf-8")))
    assert Diagnosis.of_json(content) == found


def test_a_field_that_is_missing_or_unknown_is_an_error(tmp_path):
    content = ALL["effect"]()
    for wrong in (
        {key: x for key, x in content.items() if key != "shrink"},
        content | {"colour": "red"},
        content | {"verdict": "maybe"},
        content | {"schema": 3},
    ):
        path = tmp_path / "diagnosis.json"
        path.write_text(json.dumps(wrong), encoding="utf-8")
        with pytest.raises(ValueError, match=r"diagnosis\.json is no diagnosis"):
            Diagnosis.load(path)
    nested = ALL["effect"]()
    nested["effects"][0]["parameters"][0]["colour"] = "red"
    with pytest.raises(ValueError, match="colour"):
        load(nested)


def test_schema_1_is_upgraded_and_says_what_it_did_not_know(tmp_path):
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(schema_1("effect")), encoding="utf-8")
    found = Diagnosis.load(path)
    (mass,) = found.blamed
    assert found.verdict == "effect"
    assert found.probability == 0.8  # no more than the posterior of the set
    assert (mass.parameter("e").value, mass.parameter("e").use) == (0.1, "unknown")
    assert mass.parameter("e").at_bound == "unknown"
    assert (found.program.digest, found.settings.decision) == (None, None)
    assert found.settings.exclude == ("wind",)
    assert [f.use for f in found.flights.used] == ["fit, and held out in turn"] * 2
    assert found.where[0].beyond_noise
    assert found.where[0].main
    assert found.remainder.noteworthy
    assert not found.remainder.mostly_explained


def test_unexplained_of_schema_1_is_partly_where_left_out_flights_confirmed_an_effect():
    found = Diagnosis.of_json(schema_1("unexplained", [CONFIRMS]))
    assert found.verdict == "partly"
    assert [effect.name for effect in found.blamed] == ["mass"]
    assert found.probability is None
    alone = Diagnosis.of_json(schema_1("unexplained"))
    assert (alone.verdict, alone.blamed) == ("unexplained", ())
    assert [effect.name for effect in alone.effects] == ["mass"]


@pytest.mark.parametrize(
    ("judged", "confirmed", "verdict"),
    [
        ("effect", True, "effect"),
        ("effect", False, "effect"),
        ("none", False, "none"),
        ("unexplained", True, "partly"),
        ("unexplained", False, "unexplained"),
    ],
)
def test_the_verdict_is_partly_only_where_something_left_is_beside_a_confirmed_effect(
    judged, confirmed, verdict
):
    assert statements.verdict_of(judged, confirmed) == verdict
    assert statements.judged_of(verdict) == judged


def test_a_size_is_measured_only_inside_its_range_and_beside_nothing_unexplained():
    assert statements.use_of("effect", "no", bounded=True) == "measured"
    for verdict, end, bounded in (
        ("partly", "no", True),
        ("unexplained", "no", True),
        ("effect", "high", True),
        ("effect", "no", False),
    ):
        assert statements.use_of(verdict, end, bounded) == "descriptive"


def test_a_set_is_no_surer_than_its_posterior_and_its_effects():
    assert statements.answer_probability(1.0, [0.6, 0.9]) == 0.6
    assert statements.answer_probability(0.7, [0.995]) == 0.7
    assert statements.answer_probability(0.7, []) == 0.7
    assert statements.answer_probability(None, []) is None


def test_main_channels_hold_more_than_half_between_them_or_are_three():
    assert statements.main_channels([0.1, 0.6, 0.3]) == [False, True, False]
    assert statements.main_channels([0.3, 0.4, 0.3]) == [True, True, False]
    assert statements.main_channels([0.15, 0.16, 0.16, 0.14, 0.39]) == [
        False,
        True,
        False,
        False,
        True,
    ]
    assert statements.main_channels([0.0, 0.0]) == [False, False]


def test_partly_counts_as_unexplained_in_the_scores():
    scored = scored_form(ALL["partly"]())
    assert (scored["verdict"], scored["effects"]) == ("unexplained", [])
    scored = scored_form(ALL["effect"]())
    (mass,) = scored["effects"]
    assert mass["parameters"]["e"]["value"] == 0.1203
    assert scored["candidates"][0]["probability"] == 0.983
    assert scored_form(schema_1("effect")) == schema_1("effect")
    with pytest.raises(ValueError, match="schema"):
        scored_form({"schema": 7})


def test_every_threshold_has_a_unit_and_says_where_it_comes_from():
    for field in dataclasses.fields(Decision):
        assert field.metadata["unit"]
        assert field.metadata["source"] in {"guess", "statistics", "cases", "convention"}
        assert field.metadata["evidence"]
    with pytest.raises(dataclasses.FrozenInstanceError):
        Decision().effect_cost = 0.0


def test_another_decision_says_something_else():
    strict = dataclasses.replace(Decision(), noteworthy_share=0.001, mostly_share=0.002)
    assert not statements.noteworthy(0.01)
    assert statements.noteworthy(0.01, strict)
    assert statements.mostly_explained(0.01)
    assert not statements.mostly_explained(0.01, strict)


def test_records_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        load(ALL["effect"]()).verdict = "none"
