"""The typed answer: its published schema and its rules."""

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


def test_the_published_schema_is_the_one_of_the_types():
    assert PUBLISHED.read_text(encoding="utf-8") == json_schema(), (
        "the types have changed: python -m diagnosis.result > docs/diagnosis.schema.json"
    )
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


def test_partly_blames_in_the_scores_what_it_blames():
    partly = ALL["partly"]()
    scored = scored_form(partly)
    blamed = [effect["name"] for effect in partly["effects"] if effect["blamed"]]
    assert (scored["verdict"], [e["name"] for e in scored["effects"]]) == ("partly", blamed)
    scored = scored_form(ALL["effect"]())
    (mass,) = scored["effects"]
    assert mass["parameters"]["e"]["value"] == 0.1203
    assert scored["candidates"][0]["probability"] == 0.983
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
