"""Baselines find what their dictionary holds, and stay below their threshold in clean flights."""

import functools
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from blind.draw import cases
from blind.score import baselines
from blind.score.dictionary import SIGNATURES, regression
from diagnosis.logs.flights import DroneLog, FlightLog, FlightSet, VehicleFile, load_flights


@functools.cache
def flights(folder, seed, *plan):
    """A single-drone case as the diagnosis would read it."""
    rng = np.random.default_rng(seed)
    case = cases.Case(
        id=f"{seed}",
        kind="single",
        effects=cases.make_case("single", plan, rng).effects,
        size="",
        seed=seed,
    )
    path = folder / f"{seed}-{'-'.join(name for name, _ in plan)}"
    cases.write_flights(path, [one.logged for one in cases.fly_case(case)])
    return load_flights(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("baselines")


@pytest.fixture(scope="module")
def limits(folder):
    """Thresholds from clean flights, doubled."""
    reference = flights(folder, 1)
    return {
        name: 2
        * baselines.threshold([find(flights(folder, s), reference).strength for s in (2, 3)])
        for name, find in baselines.BASELINES.items()
    }


@pytest.mark.parametrize("name", baselines.BASELINES)
@pytest.mark.parametrize(
    ("effect", "parameter", "value"),
    [("drag", "c", 1.0), ("thrust_gain", "e", -0.2), ("attitude_gain", "g", -0.2)],
)
def test_a_large_effect_is_named_with_its_size(folder, limits, name, effect, parameter, value):
    finding = baselines.BASELINES[name](flights(folder, 7, (effect, 2)), flights(folder, 1))
    given = baselines.answer(finding, limits[name], 10.0)
    assert given["effects"][0]["name"] == effect
    found = given["effects"][0]["parameters"][parameter]["value"]
    assert found == pytest.approx(value, rel=0.2)


@pytest.mark.parametrize("name", baselines.BASELINES)
def test_clean_flights_are_answered_with_none(folder, limits, name):
    finding = baselines.BASELINES[name](flights(folder, 4), flights(folder, 1))
    assert baselines.answer(finding, limits[name], 10.0)["verdict"] == "none"


@pytest.mark.parametrize("name", baselines.BASELINES)
def test_a_gust_is_dated(folder, limits, name):
    plan = (("gust", 2),)
    onset = cases.make_case("single", plan, np.random.default_rng(5)).effects[0].parameters["onset"]
    finding = baselines.BASELINES[name](flights(folder, 5, *plan), flights(folder, 1))
    (found, *_) = baselines.answer(finding, limits[name], 10.0)["effects"]
    assert found["name"] == "gust"
    assert found["parameters"]["onset"]["value"] == pytest.approx(onset, abs=0.5)


def test_every_signature_is_there_but_the_neighbours(folder):
    problem = regression(flights(folder, 1))
    silent = np.linalg.norm(problem.columns, axis=0) == 0.0
    assert [s.effect for s, quiet in zip(SIGNATURES, silent, strict=True) if quiet] == ["downwash"]


def test_rotors_drag_and_lift():
    rng = np.random.default_rng(0)
    vel, quats = rng.normal(size=(20, 3)), Rotation.from_euler("xyz", rng.normal(size=(20, 3)) / 3)
    log = DroneLog(
        t=0.02 * np.arange(20),
        pos=np.ones((20, 3)),
        vel=vel,
        quat=quats.as_quat(),
        cmd=np.tile([0.0, 0.0, 0.0, 0.4], (20, 1)),
    )
    vehicle = VehicleFile("test", "cf21B_500", 0.0434)
    found = regression(FlightSet(Path("flown"), vehicle, (FlightLog("one", (log,)),), ()))
    columns = {
        s.parameter: found.columns[: 3 * 18, i]
        for i, s in enumerate(SIGNATURES)
        if s.effect in ("rotor_drag", "translational_lift")
    }
    up = quats.apply([0.0, 0.0, 1.0])
    climb = np.sum(vel * up, axis=1, keepdims=True)
    across = np.sum((vel - climb * up) ** 2, axis=1, keepdims=True)
    for name, expected in {"axial": -climb * up, "k": across * up}.items():
        np.testing.assert_allclose(columns[name], expected[1:-1].ravel(), atol=1e-9)


def test_the_threshold_is_a_quantile_that_is_reached():
    assert baselines.threshold([0.1, 0.3, 0.2], alarms=0.02) == 0.3
    with pytest.raises(ValueError, match="`strengths` must hold at least one"):
        baselines.threshold([])
