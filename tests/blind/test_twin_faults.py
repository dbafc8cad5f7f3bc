"""Faults whose sizes the twin's power is studied by, and the table of how often they are found."""

import numpy as np
import pytest
from flights_for_tests import flight_set, made_log

from blind.draw.faults import FAULTS
from blind.twin.power import STUDIED, interval
from diagnosis.logs.flights import FlightLog
from simulators import registry


def commands(flights):
    cmd = flights.flights[0].drones[0].cmd
    assert cmd is not None
    return cmd


@pytest.mark.parametrize("name", sorted(STUDIED))
def test_what_is_studied_is_a_parameter_of_an_effect_of_the_library(name):
    studied = STUDIED[name]
    parameter = registry.load("effect", studied.effect).parameters[studied.parameter]
    assert parameter.unit == studied.unit


@pytest.mark.parametrize(
    ("name", "column"),
    [("thrust", 3), ("roll offset", 0), ("pitch offset", 1), ("attitude gain", 0), ("frame", 1)],
)
def test_a_studied_size_is_the_size_of_the_fault(name, column):
    """Twice the size changes the column twice as much, to first order, and size 0 nothing."""
    flights = flight_set([FlightLog("one", (made_log(),))])
    was, studied = commands(flights), STUDIED[name]
    np.testing.assert_array_equal(commands(studied.apply(flights, 0.0)), was)
    one, two = (commands(studied.apply(flights, s * studied.aim)) - was for s in (0.01, 0.02))
    assert np.abs(one[:, column]).max() > 0.0
    np.testing.assert_allclose(two[:, column], 2 * one[:, column], rtol=0.01, atol=1e-6)


def test_flights_without_commands_are_studied_for_thrust_alone():
    pwm = made_log(cmd=None, pwm=np.full((len(made_log().t), 4), 0.8))
    flights = flight_set([FlightLog("one", (pwm,))])
    assert [n for n, s in STUDIED.items() if FAULTS[s.fault].fits(flights)] == ["thrust", "delay"]


def test_intervals_of_shares_are_those_of_clopper_and_pearson():
    assert interval(0, 200) == pytest.approx((0.0, 0.01828), abs=1e-4)
    assert interval(19, 20) == pytest.approx((0.7513, 0.9987), abs=1e-4)
