"""Flights that end upside down: what is left of them, and that it is said."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import flight_set, made_log
from scipy.spatial.transform import Rotation

from diagnosis.logs.flights import FlightLog, LogError
from diagnosis.logs.inputs import choose_inputs
from diagnosis.logs.upsets import BEFORE, LASTS, before_upset


def rolled(begin=4.0, end=6.0, told=False):
    """A log whose drone is upside down from `begin` to `end` [s], perhaps as it was `told`."""
    log = made_log(6.0)
    over = (log.t >= begin - 1e-9) & (log.t < end - 1e-9)
    quat = np.where(over[:, None], Rotation.from_euler("x", 3.0).as_quat(), log.quat)
    cmd = log.cmd.copy()
    if told:
        cmd[over, 0] = 3.0
    return dataclasses.replace(log, quat=quat, cmd=cmd)


def flight(*drones):
    return FlightLog("crash", drones)


def test_a_flight_ends_before_its_upset_and_the_reason_has_both_times():
    kept, why = before_upset(flight(rolled()))
    assert kept.drones[0].t[-1] == pytest.approx(4.0 - BEFORE - 0.01)
    assert len(kept.drones[0].cmd) == len(kept.drones[0].t)
    assert "flights/crash: all from 3.0 s on, because the drone turned over 4.0 s after" in why


@pytest.mark.parametrize(
    "log",
    [
        made_log(6.0),
        rolled(told=True),
        rolled(begin=4.0, end=4.0 + LASTS - 0.02),
        dataclasses.replace(rolled(), cmd=None),
    ],
    ids=["upright", "a flip that was commanded", "a glitch", "no command"],
)
def test_other_flights_stay_as_they_are(log):
    whole = flight(log)
    assert before_upset(whole) == (whole, "")


def test_what_lasts_longer_than_a_glitch_is_an_upset():
    assert before_upset(flight(rolled(begin=4.0, end=4.0 + LASTS + 0.02)))[1]


def test_all_drones_end_where_the_first_of_them_is_lost():
    kept, _ = before_upset(flight(made_log(6.0), rolled()))
    assert [drone.t[-1] < 3.0 for drone in kept.drones] == [True, True]


def test_of_an_early_upset_nothing_is_left():
    kept, why = before_upset(flight(rolled(begin=1.5)))
    assert kept is None
    assert why == "flights/crash: the drone turned over 1.5 s after its start without a command to"


def test_of_an_upset_after_hardly_more_than_that_nothing_is_left_either():
    """A second less a row would hold no drone at all."""
    assert before_upset(flight(rolled(begin=2.0)))[0] is None


def test_a_drone_whose_log_begins_after_the_end_is_left_out():
    late = made_log(6.0)
    late = dataclasses.replace(late, t=late.t + 3.5)
    kept, _ = before_upset(flight(rolled(), late))
    assert len(kept.drones) == 1


def test_inputs_keep_the_part_before_and_say_what_is_gone():
    inputs = choose_inputs(flight_set([flight(rolled()), FlightLog("whole", (made_log(6.0),))]))
    assert [f.name for f in inputs.flights] == ["crash", "whole"]
    assert inputs.flights[0].seconds < 3.0
    assert [one.name for one in inputs.left_out] == ["crash"]


def test_a_set_of_upsets_alone_is_refused_with_the_reason():
    with pytest.raises(LogError, match="no flight is usable:\nflights/crash: the drone turned"):
        choose_inputs(flight_set([flight(rolled(begin=1.0))]))
