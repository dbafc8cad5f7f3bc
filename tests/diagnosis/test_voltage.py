"""Thrust that falls with the battery's voltage, where flights log one."""

import numpy as np
import pytest
from flights_for_tests import edited, few_or_all, flight_set, fly

from diagnosis.decide.prepared import Question, prepare
from diagnosis.engine import diagnose
from simulators import registry
from simulators.point_mass import PointMass

K = 0.3
"""Share of the thrust that is lost per volt below 4.2 V."""


def weakened(flight, full, weak):
    """The flight as of a battery at `full` [V] that sags in load, told to compensate for it.

    A point mass makes of a command over its gain what the nominal one makes of the command.
    """

    def change(log):
        t = log.t - log.t[0]
        voltage = full - 0.007 * t - 0.15 * (np.sin(2.0 * t) > 0.3)
        cmd = log.cmd.copy()
        cmd[:, 3] /= (1.0 - K * (4.2 - voltage)) if weak else 1.0
        return {"cmd": cmd, "battery": voltage}

    return edited(flight, change)


@pytest.fixture(scope="module")
def flown():
    return fly(PointMass(dt=0.005), n_flights=4, seconds=9.0)


def diagnosed(flown, weak, exclude):
    """The diagnosis of flights with batteries that are less and less full."""
    flights = flight_set([weakened(f, 4.15 - 0.05 * i, weak) for i, f in enumerate(flown)])
    return diagnose(flights, simulator="point_mass", exclude=exclude)


@few_or_all()
def test_thrust_that_follows_the_voltage_is_named_and_measured(flown, exclude):
    found = diagnosed(flown, True, exclude)
    assert [effect.name for effect in found.effects] == ["voltage_sag"]
    k = found.effects[0].parameter("k")
    assert k.low < K < k.high
    assert k.value == pytest.approx(K, rel=0.05)
    assert found.verdict == "effect"


@few_or_all()
def test_a_voltage_that_is_compensated_for_is_not_blamed(flown, exclude):
    assert diagnosed(flown, False, exclude).verdict == "none"


def test_a_voltage_that_was_not_logged_everywhere_is_no_candidate(flown):
    flights = flight_set([weakened(flown[0], 4.1, True), *flown[1:]])
    library = prepare(Question(flights, "point_mass")).every.library
    assert "voltage_sag" not in library.candidates
    kind = registry.load("effect", "voltage_sag")
    assert "voltage" in library.why_out("voltage_sag", kind)
