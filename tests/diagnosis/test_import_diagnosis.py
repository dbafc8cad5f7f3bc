"""Flights that took the way through a log are diagnosed like the flights themselves."""

import functools

import numpy as np
import pytest
from flights_for_tests import COMMON, SIGMA, all_but, edited, few_or_all, point_mass_set
from import_logs_for_tests import FLOWN, FORMATS, write_log

from diagnosis.engine import diagnose
from diagnosis.importing.convert import import_logs
from diagnosis.logs.flights import load_flights
from diagnosis.logs.noise import estimate_noise
from diagnosis.logs.segments import cut
from simulators.effects.mass import Mass
from simulators.vehicle import GRAVITY, VEHICLES

WEIGHT = 0.0434 * GRAVITY
ALIKE = {"ros1", "ros2", "usd version 1"}
"""Formats that share most of their reader with another one; diagnosed exhaustively."""
EVERY = {"pos": 1, "quat": 1, "cmd": 1}
SLOW = {"pos": 5, "quat": 1, "cmd": 1}
"""Position at 10 Hz, attitude and commands at 50 Hz."""


@pytest.fixture(scope="module")
def heavy():
    """Three flights with 10 % more mass than believed."""
    return point_mass_set(Mass(e=0.1), n_flights=3, seconds=5.0)


def through(kind, flights, folder, rates=EVERY):
    """The flights, written to files of a format and imported."""
    logs, most = [], VEHICLES["cf21B_500"].thrust_max
    for flight in flights.flights:
        (folder / flight.name).mkdir()
        made = write_log(kind, folder / flight.name, flight.drones[0], WEIGHT, most, rates)
        logs.append(made.rename(folder / f"log_{flight.name}{made.suffix}"))
    full = {"ros1": 2.0 * WEIGHT, "ros2": 2.0 * WEIGHT, "mcap": 2.0 * WEIGHT, "cflib": most}
    import_logs(logs, folder / "out", FLOWN, full_thrust=full.get(kind))
    return load_flights(folder / "out")


@pytest.fixture(scope="module")
def slow(heavy, tmp_path_factory):
    """The same flights, out of logs with slow positions."""
    return through("ulog", heavy, tmp_path_factory.mktemp("slow"), SLOW)


@pytest.fixture(scope="module")
def direct(heavy):
    """The diagnosis of the flights themselves, by what is excluded."""
    return functools.cache(lambda *out: diagnose(heavy, simulator="point_mass", exclude=out))


def compare(direct, read):
    """Both blame the same mass."""
    assert direct.verdict == read.verdict == "effect"
    assert [e.name for e in direct.blamed] == [e.name for e in read.blamed] == ["mass"]
    for name in ("value", "low", "high"):
        was, now = (getattr(d.blamed[0].parameter("e"), name) for d in (direct, read))
        assert now == pytest.approx(was, abs=2e-4)
    assert read.probability == pytest.approx(direct.probability, abs=0.01)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[pytest.mark.exhaustive] if kind in ALIKE else [])
        for kind in FORMATS
    ],
)
def test_the_diagnosis_is_the_same(heavy, direct, tmp_path, kind):
    few = all_but(*COMMON)
    read = through(kind, heavy, tmp_path)
    compare(direct(*few), diagnose(read, simulator="point_mass", exclude=few))


@pytest.mark.exhaustive
def test_the_diagnosis_is_the_same_with_all_candidates(heavy, direct, tmp_path):
    compare(direct(), diagnose(through("ulog", heavy, tmp_path), simulator="point_mass"))


@few_or_all()
def test_slow_positions_are_diagnosed_with_a_wider_interval(slow, exclude):
    read = diagnose(slow, simulator="point_mass", exclude=exclude)
    assert "mass" in [effect.name for effect in read.blamed]
    e = next(effect for effect in read.blamed if effect.name == "mass").parameter("e")
    assert e.low < 0.1 < e.high
    assert 0.001 < e.high - e.low < 0.05


def test_rows_between_positions_are_compared_with_nothing(heavy, slow):
    (every,), (some,) = cut(heavy.flights, 0.02), cut(slow.flights, 0.02)
    assert some.valid.sum() == pytest.approx(every.valid.sum() / 5, rel=0.05)


def test_noise_is_not_smoothed_away_by_interpolation(slow):
    """Rows between positions lie on a smooth curve; taken as measured they would show no noise."""
    got = estimate_noise(slow.flights)
    assert (got[:6] > 0.9 * SIGMA[:6]).all()
    np.testing.assert_allclose(got[6:], SIGMA[6:], rtol=0.2)
    blind = edited(slow, lambda log: {"interpolated": None})
    assert (estimate_noise(blind.flights)[:6] < 0.3 * SIGMA[:6]).all()
