"""Faults in logs, and the table of how often they are found."""

import numpy as np
import pytest

from blind.twin.faults import FAULTS, applies, disturbed
from blind.twin.power import interval
from diagnosis.logs.flights import DroneLog, FlightLog


def log(**columns):
    t = np.arange(0.0, 2.0, 0.01)
    cmd = np.stack([0.1 * np.sin(3 * t), 0.05 * np.cos(2 * t), 0 * t, 0.3 + 0.01 * t], axis=1)
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    given = {"cmd": cmd} | columns
    drone = DroneLog(t=t, pos=np.zeros((len(t), 3)), vel=np.zeros((len(t), 3)), quat=quat, **given)
    return FlightLog("one", (drone,))


def commands(flight):
    cmd = flight.drones[0].cmd
    assert cmd is not None
    return cmd


@pytest.mark.parametrize("name", sorted(FAULTS))
def test_a_fault_of_opposite_size_takes_the_first_one_back(name):
    """Linear ones to first order; a delay but for its ends."""
    size = FAULTS[name].aim * 0.1
    back = disturbed(disturbed(log(), name, size), name, -size)
    was = commands(log())
    np.testing.assert_allclose(commands(back)[5:-5], was[5:-5], rtol=2e-4, atol=1e-5)


def test_each_fault_changes_what_it_says():
    cmd, t = commands(log()), log().drones[0].t
    changed = {n: commands(disturbed(log(), n, f.aim)) for n, f in FAULTS.items()}
    np.testing.assert_allclose(changed["thrust"][:, 3] * 1.05, cmd[:, 3])
    np.testing.assert_allclose(
        changed["delay"][:-5, 0], 0.1 * np.sin(3 * (t[:-5] + 0.02)), atol=1e-4
    )
    np.testing.assert_allclose(changed["pitch offset"][:, 1], cmd[:, 1] - np.deg2rad(1.5))
    np.testing.assert_allclose(changed["attitude gain"][:, :2] * 1.1, cmd[:, :2])
    tilt = np.hypot(cmd[:, 0], cmd[:, 1])
    np.testing.assert_allclose(np.hypot(*changed["frame"][:, :2].T), tilt)


def test_pwm_flights_take_thrust_faults_only():
    pwm = log(cmd=None, pwm=np.full((200, 4), 0.8), battery=np.full(200, 3.8))
    assert [name for name in FAULTS if applies(name, pwm)] == ["thrust"]
    changed = disturbed(pwm, "thrust", 0.05).drones[0].pwm
    assert changed is not None
    assert changed[0, 0] == pytest.approx(0.8 / 1.05)


def test_intervals_of_shares_are_those_of_clopper_and_pearson():
    assert interval(0, 200) == pytest.approx((0.0, 0.01828), abs=1e-4)
    assert interval(19, 20) == pytest.approx((0.7513, 0.9987), abs=1e-4)
