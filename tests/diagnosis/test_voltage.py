"""Thrust that falls with the battery's voltage, where flights log one."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import flight_set, fly

from diagnosis.engine import diagnose
from simulators.point_mass import PointMass

K = 0.3
"""Share of the thrust that is lost per volt below 4.2 V."""


def weakened(flight, full, weak):
    """The flight as of a battery at `full` [V] that sags in load, told to compensate for it.

    A point mass makes of a command over its gain what the nominal one makes of the command.
    """
    (drone,) = flight.drones
    t = drone.t - drone.t[0]
    voltage = full - 0.007 * t - 0.15 * (np.sin(2.0 * t) > 0.3)
    cmd = drone.cmd.copy()
    cmd[:, 3] /= (1.0 - K * (4.2 - voltage)) if weak else 1.0
    return dataclasses.replace(
        flight, drones=(dataclasses.replace(drone, cmd=cmd, battery=voltage),)
    )


@pytest.fixture(scope="module")
def flown():
    return fly(PointMass(dt=0.005))


def diagnosed(flights):
    return diagnose(flight_set(flights), simulator="point_mass")


def test_thrust_that_follows_the_voltage_is_named_and_measured(flown):
    found = diagnosed([weakened(f, 4.15 - 0.05 * i, True) for i, f in enumerate(flown)])
    assert [effect.name for effect in found.effects] == ["voltage_sag"]
    k = found.effects[0].parameter("k")
    assert k.low < K < k.high
    assert k.value == pytest.approx(K, rel=0.05)
    assert found.verdict == "effect"


def test_a_voltage_that_is_compensated_for_is_not_blamed(flown):
    found = diagnosed([weakened(f, 4.15 - 0.05 * i, False) for i, f in enumerate(flown)])
    assert found.verdict == "none"


def test_a_voltage_that_was_not_logged_everywhere_is_no_candidate(flown):
    found = diagnosed([weakened(flown[0], 4.1, True), *flown[1:]])
    (why,) = [x.why for x in found.details.not_observable if x.effect == "voltage_sag"]
    assert "voltage" in why
