"""The whole diagnosis: `diagnosis.json` for flights of known truth."""

import json

import numpy as np
import pytest
from flights_for_tests import SIGMA, flight_set, fly, point_mass_set

from diagnosis import gap, shrinkage
from diagnosis.diagnose import diagnose, make_likelihood
from diagnosis.library import make_library
from diagnosis.replay import make_replay
from simulators import registry
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.gust import Gust
from simulators.effects.mass import Mass
from simulators.effects.wind import Wind
from simulators.point_mass import PointMass

KEYS = {
    *("schema", "simulator", "drone", "flights", "where", "verdict", "unexplained_share"),
    *("effects", "candidates", "shrink", "next_flight", "details"),
}


@pytest.fixture(scope="module")
def windy():
    stages = []
    flights = point_mass_set(Wind(x=0.5), n_flights=6)
    content = diagnose(
        flights, simulator="point_mass", progress=lambda s, x: stages.append((s, x))
    ).to_json()
    return content, stages


def test_the_content_is_schema_1_and_plain_json(windy):
    content, _ = windy
    assert set(content) == KEYS
    assert content["schema"] == 1
    assert json.loads(json.dumps(content, allow_nan=False)) == content


def test_the_effect_is_named_with_its_value(windy):
    (effect,) = windy[0]["effects"]
    assert effect["name"] == "wind"
    assert effect["parameters"]["x"]["value"] == pytest.approx(0.5, abs=0.02)
    assert effect["parameters"]["x"]["unit"] == "m/s^2"
    assert effect["probability"] > 0.9


def test_the_gap_lies_where_the_force_acts(windy):
    where = {line["channel"]: line for line in windy[0]["where"]}
    assert where["specific force x"]["gap_rms"] == pytest.approx(0.5, rel=0.15)
    for other in ("specific force y", "attitude roll", "attitude yaw"):
        assert where[other]["gap_rms"] < 2.5 * where[other]["noise_floor"]
    assert sum(line["share"] for line in where.values()) == pytest.approx(1.0)
    x = where["specific force x"]
    assert x["low"] <= x["gap_rms"] <= x["high"]


def test_the_gap_shrinks_to_the_noise(windy):
    shrink = windy[0]["shrink"]
    assert shrink["before"] == pytest.approx(0.5 * 0.5 * 0.5**2, rel=0.2)
    assert shrink["percent"] > 80
    assert shrink["low"] < shrink["percent"] < shrink["high"]


def test_progress_moves_forward_to_the_end(windy):
    shares = [share for _, share in windy[1]]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_two_flights_are_diagnosed_but_their_shrinkage_is_not_stated():
    content = diagnose(point_mass_set(Wind(x=0.5), n_flights=2), simulator="point_mass").to_json()
    assert content["verdict"] == "effect"
    assert content["shrink"]["percent"] is None
    assert "at least 3" in content["shrink"]["reason"]


def test_with_many_flights_a_third_is_never_fitted():
    flights = point_mass_set(Wind(x=0.5), n_flights=12, seconds=3.0)
    content = diagnose(flights, simulator="point_mass").to_json()
    fit, held = (set(content["flights"][k]) for k in ("fit", "held_out"))
    assert not fit & held
    assert len(fit | held) == 12
    assert content["shrink"]["percent"] > 60


def test_a_gust_has_an_onset_in_its_channel():
    replay = make_replay(make_library(PointMass(dt=0.005)), 0.005)
    flights = point_mass_set(Gust(y=1.0, onset=3.1), n_flights=4).flights
    likelihood = make_likelihood(replay, flights, SIGMA)
    where = gap.where(likelihood.tracks(replay.library.neutral), SIGMA)
    found = {line["channel"]: line["onset_s"] for line in where}
    assert found["specific force y"] == pytest.approx(3.1, abs=0.5)
    assert found["specific force x"] is None


def test_a_gap_that_grows_with_thrust_shows_in_that_regime():
    replay = make_replay(make_library(PointMass(dt=0.005)), 0.005)
    flights = point_mass_set(Mass(e=0.2), n_flights=4).flights
    tracks = make_likelihood(replay, flights, SIGMA).tracks(replay.library.neutral)
    (line,) = [x for x in gap.where(tracks, SIGMA) if x["channel"] == "specific force z"]
    (thrust,) = [r for r in line["regimes"] if r["variable"] == "thrust"]
    assert thrust["gap"][-1] > 1.05 * thrust["gap"][0]
    assert np.all(np.diff(thrust["edges"]) > 0)


@pytest.mark.parametrize(("n", "held"), [(2, 2), (9, 9), (10, 3), (30, 10)])
def test_flights_are_held_out_once_there_are_ten(n, held):
    fit, out = shrinkage.split(n)
    assert len(out) == held
    assert (fit == out) == (n < 10)


def test_a_withheld_mass_is_named_through_crazyflow():
    reality = with_effects(Crazyflow(), [Mass(e=0.15)])
    content = diagnose(flight_set(fly(reality, n_flights=4, seconds=4.0))).to_json()
    assert content["verdict"] == "effect"
    (effect,) = content["effects"]
    assert "mass" in [effect["name"], *effect["aliases"]]
    registered = set(registry.names("effect"))
    assert {line["effect"] for line in content["details"]["not_observable"]} <= registered
