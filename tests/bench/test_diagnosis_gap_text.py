"""Where a gap lies and how far it shrinks, in words."""

import diagnoses_for_tests
import pytest
from diagnoses_for_tests import load

from bench.diagnosis_report.gap_text import expected, shrink_sentence, where_sentence
from bench.diagnosis_report.remedy import remedy
from bench.diagnosis_report.sentences import remarks, verdict
from bench.diagnosis_report.tables import facts


def sentence(kind):
    return verdict(load(diagnoses_for_tests.ALL[kind]()))


def remarks_on(kind):
    return remarks(load(diagnoses_for_tests.ALL[kind]()))


@pytest.mark.parametrize("kind", ["effect", "partly"])
def test_a_drift_beside_a_twin_is_not_promised_of_the_simulator_that_is_handed_over(kind):
    """Only the change is handed over: the corrected simulator keeps its own error."""
    plain = load(diagnoses_for_tests.ALL[kind]())
    assert "in the simulator, its drift" in " ".join([verdict(plain), *remarks(plain)])
    found = load(diagnoses_for_tests.beside_twin(diagnoses_for_tests.ALL[kind]()))
    said = " ".join([verdict(found), *remarks(found)])
    assert "in a model learned from the reference flights (the twin), its drift from held" in said
    for text in (said, shrink_sentence(found), expected(found)):
        assert "he corrected simulator has the change alone and keeps what it missed before" in text
        assert "in the simulator, its" not in text
        assert "the simulator's drift" not in text
    assert "is that simulator. It has the change alone." in " ".join(remedy(found))
    aliased = diagnoses_for_tests.alias()
    assert "either makes up for the gap" in " ".join(remedy(load(aliased)))
    assert "either makes up for the change" in " ".join(
        remedy(load(diagnoses_for_tests.beside_twin(aliased)))
    )


def test_a_gap_is_told_in_channels_that_stand_out_of_noise():
    found = diagnoses_for_tests.effect()
    for line in found["where"]:
        line["beyond_noise"] = line["channel"] == "position drift z"
    said = where_sentence(load(found))
    assert said == "The gap stands out of noise in position drift z (17 %)."
    for line in found["where"]:
        line["beyond_noise"] = False
    assert where_sentence(load(found)) == "No single channel stands out of its noise."


@pytest.mark.parametrize(
    ("kind", "why"), [("none", "no known effect shows in it."), ("too_few", "that may be chance.")]
)
def test_a_channel_beyond_noise_is_named_where_nothing_is_found(kind, why):
    found = diagnoses_for_tests.none() | {"verdict": kind}
    found["where"][3]["beyond_noise"] = True
    said = where_sentence(load(found))
    assert said.startswith("In attitude roll the gap exceeds its noise floor, but ")
    assert said.endswith(why)


def test_what_is_only_likeliest_is_not_called_found():
    said = {
        kind: dict(facts(load(diagnoses_for_tests.ALL[kind]())))
        for kind in ("effect", "unexplained")
    }
    key = "misfit (1 is noise alone)"
    assert said["effect"][key].endswith("with what was found")
    assert said["unexplained"][key].endswith("with the likeliest set of effects")
    whole = diagnoses_for_tests.unexplained()
    whole["remainder"]["share"] = 1.0  # nothing was put into the model
    assert "likeliest set" not in verdict(load(whole))


def test_drift_that_grows_is_not_said_to_fall():
    found = diagnoses_for_tests.effect()
    found["shrink"] |= {"after": 0.05, "percent": -46.0, "low": -60.0, "high": -30.0}
    said = verdict(load(found))
    assert "falls" not in said
    assert "34 mm to 50 mm" in said
    assert "grows" in shrink_sentence(load(found))
    assert "46 % more (95 %: 30 to 60 %)" in shrink_sentence(load(found))


def test_half_seconds_that_count_nowhere_are_counted_beside_the_shrink():
    found = diagnoses_for_tests.effect()
    assert "neither" not in shrink_sentence(load(found))
    found["details"]["windows"] = {"n": 236, "aside": 3}
    assert shrink_sentence(load(found)).endswith(
        "soon after a gap in the log, or alone, are in neither: 3 of 236."
    )
