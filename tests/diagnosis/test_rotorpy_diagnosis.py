"""Flights of RotorPy, diagnosed beside RotorPy instead of crazyflow."""

import pytest
from flights_for_tests import few_or_all
from rotorpy.vehicles.crazyfliebrushless_params import quad_params

import diagnosis
from blind.draw.cases import Case, fly_case, write_flights
from blind.draw.catalogue import Withheld
from blind.fly.realities import DT, MASS
from diagnosis.replay.believed import believed_simulator, replayable_class


@few_or_all("mass", "delay", "attitude_lag", "motor_lag")
def test_more_mass_is_found_and_no_lag_beside_it(tmp_path, exclude):
    """The attitude loop of these flights acts every 2 ms, as a Crazyflie's does.

    Replayed in steps of 5 ms, in which it acts once, they had an attitude lag of 2 ms besides.
    """
    heavier = Withheld("mass", {"e": 0.05})
    made = Case(
        "heavy", "single", (heavier,), "small", 5, reality="rotorpy", n_flights=4, seconds=8.0
    )
    write_flights(tmp_path / "heavy", [flight.logged for flight in fly_case(made)])
    found = diagnosis.diagnose(tmp_path / "heavy", simulator="rotorpy", exclude=exclude)
    assert (found.settings.simulator, found.verdict) == ("rotorpy", "effect")
    (named,) = found.blamed
    assert named.name == "mass"
    (size,) = named.parameters
    true = 1.05 * quad_params["mass"] / MASS - 1.0  # RotorPy's drone is 0.6 g heavier by itself
    assert size.low < true < size.high
    assert size.value == pytest.approx(true, abs=0.003)


def test_the_attitude_loop_acts_as_often_in_a_replay_as_on_the_drone():
    assert replayable_class("rotorpy").replay_dt == DT
    assert believed_simulator("rotorpy", "cf21B_500", MASS).freq == round(1.0 / DT)
