"""Logs whose columns are not what they are taken for: said at once, and nothing is simulated."""

import dataclasses
import html
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from flights_for_tests import COMMON, all_but, edited
from scipy.spatial.transform import Rotation

import diagnosis
from bench.diagnosis_report.documents import diagnosis_text
from bench.diagnosis_report.page import diagnosis_page
from bench.diagnosis_report.sentences import kind_label, verdict
from blind.draw.faults import ALL
from diagnosis import engine
from diagnosis.interface.fault import ORDERED, PARTS, InterfaceFault, of_reference
from diagnosis.interface.faults import Checks
from diagnosis.interface.readings import Chosen
from diagnosis.misread import misleads

PUBLISHED = Path(__file__).parents[2] / "docs" / "diagnosis.schema.json"
RIGHT, FLIPPED = Chosen((), 0.9, 0.9), Chosen(("another",), 0.9, 0.1)


@pytest.fixture
def nothing_is_simulated(monkeypatch):
    """Whatever would simulate flights fails."""

    def fail(*_, **__):
        raise AssertionError("flights were simulated")

    monkeypatch.setattr(engine, "prepare", fail)
    monkeypatch.setattr(engine, "beside_twin", fail)


def fault_of(part):
    return InterfaceFault(part=part, readings=("other",), advice="Check it.", evidence=())


def made(attitude):
    return Checks(None, None, [], [], [], {"attitude": attitude}, None)


@pytest.mark.parametrize("part", [*PARTS, *map(of_reference, sorted(ORDERED))])
def test_only_columns_that_a_replay_reads_mislead(part):
    column = part.removesuffix(" of the reference")
    expected = column in ORDERED or part == "frame of the path"
    assert misleads((fault_of(part),), made(RIGHT)) == expected


@pytest.mark.parametrize("part", ["angular velocity", "accelerometer"])
@pytest.mark.parametrize("attitude", [None, FLIPPED])
def test_a_witness_misleads_where_the_path_does_not_confirm_the_attitude(part, attitude):
    assert misleads((fault_of(part),), made(attitude))
    assert not misleads((), made(attitude))


def test_flights_with_a_wrong_column_are_compared_with_nothing(clean, nothing_is_simulated):
    found = engine.diagnose(ALL["flipped_axis"].apply(clean, {}), simulator="point_mass")
    assert (found.verdict, found.effects, found.compared) == ("unexplained", (), False)
    assert [fault.part for fault in found.interface] == ["attitude"]
    assert {flight.use for flight in found.flights.used} == {"checked only"}
    jsonschema.validate(found.to_json(), json.loads(PUBLISHED.read_text(encoding="utf-8")))
    assert kind_label(found) == "Mend the logs first"
    assert verdict(found) == (
        "The logs do not say what the format asks for (attitude): mend that first. They were not "
        "compared with the simulator: wrong columns say nothing of the vehicle."
    )
    for document in (diagnosis_text(found), html.unescape(diagnosis_page(found))):
        assert found.interface[0].advice in document
        for heading in ("Where the gap lies", "What explains it", "What to fly next", "held out"):
            assert heading not in document
    with pytest.raises(ValueError, match="logs must be mended first"):
        diagnosis.corrected(found, likeliest=True)


def test_a_reference_with_a_wrong_column_is_no_reference(clean, nothing_is_simulated):
    flown, before = (
        dataclasses.replace(clean, flights=part) for part in (clean.flights[:3], clean.flights[3:])
    )
    lighter = dataclasses.replace(before.vehicle, mass=0.9 * before.vehicle.mass)
    flipped = ALL["flipped_pitch"].apply(dataclasses.replace(before, vehicle=lighter), {})
    found = engine.diagnose(flown, simulator="point_mass", reference=flipped)
    assert [fault.part for fault in found.interface] == ["attitude command of the reference"]
    assert not found.compared
    assert {flight.use for flight in found.reference.used} == {"checked only"}


def test_a_witness_that_is_wrong_leaves_the_answer_as_it_is(clean):
    """Nothing that is replayed comes from the angular velocity."""
    few = {"simulator": "point_mass", "exclude": all_but(*COMMON)}
    plain = engine.diagnose(clean, **few)
    flown = edited(clean, lambda log: {"ang_vel": -turned(log)})
    found = engine.diagnose(flown, **few)
    assert [fault.part for fault in found.interface] == ["angular velocity"]
    assert (found.verdict, found.effects) == (plain.verdict, plain.effects)
    assert kind_label(found) == "Check the logs"


def turned(drone):
    """Angular velocity of an attitude, body frame [rad/s]."""
    R = Rotation.from_quat(drone.quat)
    rate = (R[:-1].inv() * R[1:]).as_rotvec() / np.diff(drone.t)[:, None]
    return np.concatenate([rate, rate[-1:]])
