"""What a case allows, measured with its label, on a short case in crazyflow."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from blind.draw.cases import OWN, make_case, write_case
from blind.draw.catalogue import Withheld
from blind.draw.folders import Folders
from blind.score import measures
from blind.score.measures import Workbench, measure


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folders = Folders(tmp_path_factory.mktemp("out"))
    drawn = make_case("single", (), np.random.default_rng(0), n_flights=3, seconds=4.0)
    lost = Withheld("thrust_gain", {"e": -0.1})
    case = dataclasses.replace(drawn, drones=1, effects=(lost,), size="large")
    write_case(folders.cases, folders.labels.parent, case)
    return measure(Workbench(folders, OWN), case)


def test_a_tenth_less_thrust_is_decidable_and_bounded(measured):
    assert measured["decidable"]
    assert measured["fitted"]["thrust_gain"]["e"] == pytest.approx(-0.1, abs=0.002)
    assert 0.0 < measured["bound"]["thrust_gain"]["e"] < 0.01


def test_the_true_set_shrinks_the_drift_more_than_the_best_wrong_one(measured):
    assert measured["oracle"]["thrust_gain"]["e"] == pytest.approx(-0.1, abs=0.01)
    assert measured["shrink_oracle"] > 30.0
    assert measured["wrong"] == "mass"  # hardly another, in flights of 4 s
    assert measured["shrink_wrong"] < measured["shrink_oracle"]


def test_an_undisturbed_case_is_decidable_by_definition(tmp_path):
    clean = make_case("clean", (), np.random.default_rng(0))
    found = measure(Workbench(Folders(tmp_path), OWN), clean)
    assert set(found) == {"decidable", "seconds"}
    assert found["decidable"] is True


def test_a_case_is_measured_beside_the_reference_that_its_diagnosis_had(monkeypatch, tmp_path):
    opened = []

    def load(path):
        opened.append(path)
        return SimpleNamespace(flights=())

    monkeypatch.setattr(measures, "load_flights", load)
    monkeypatch.setattr(Workbench, "replay", lambda desk, flights: None)
    monkeypatch.setattr(measures, "estimate_noise", lambda flights: 1.0)
    monkeypatch.setattr(measures, "reference_of", lambda *_: SimpleNamespace(enlarged=1.0))
    monkeypatch.setattr(measures, "make_likelihood", lambda *_: None)
    monkeypatch.setattr(measures, "beside", lambda *_: object.__new__(measures.Evidence))
    folders, clean = Folders(tmp_path), make_case("clean", (), np.random.default_rng(0))
    for reality, reference in (("rotorpy", 5), (OWN, None)):
        case = dataclasses.replace(clean, reality=reality, reference=reference)
        Workbench(folders, reality).logged(case)
    flown = folders.cases / clean.id
    assert opened == [flown, folders.references / "5", flown]
