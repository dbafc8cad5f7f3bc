"""Faults whose sizes the twin's power is studied by, and the table of how often they are found."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import flight_set, made_log
from test_twin import EVERY, LIBRARY, column, flight

from blind.power.twin import (
    CLEAN,
    STUDIED,
    Flown,
    measure,
    told,
    write_table,
    write_together,
)
from diagnosis.logs.flights import FlightLog
from diagnosis.logs.inputs import choose_inputs, thrust_of_pwm
from diagnosis.twin.flown import twin_replay
from diagnosis.twin.twin import make_twin
from simulators import registry


def flown(log):
    return flight_set([FlightLog("one", (log,))])


@pytest.mark.parametrize("name", sorted(STUDIED))
def test_what_is_studied_is_a_parameter_of_an_effect_of_the_library(name):
    studied = STUDIED[name]
    parameter = registry.load("effect", studied.effect).parameters[studied.parameter]
    assert parameter.unit == studied.unit


def test_what_the_inputs_do_not_show_is_not_studied():
    rows = len(made_log().t)
    pwm = flown(made_log(cmd=None, pwm=np.full((rows, 4), 0.8), battery=np.full(rows, 3.8)))
    for flights, names in ((pwm, ["thrust"]), (flown(made_log()), list(STUDIED))):
        assert told(flights, twin_replay(flights, choose_inputs(flights), "crazyflow")) == names
    thrust = STUDIED["thrust"].apply(pwm, 0.05).flights[0].drones[0].pwm
    assert thrust is not None
    believed = thrust_of_pwm(thrust, np.full(rows, 3.8)) * 1.05
    np.testing.assert_allclose(believed, thrust_of_pwm(np.full((rows, 4), 0.8), np.full(rows, 3.8)))


def test_the_drift_that_a_named_fault_makes_falls_as_without_the_fault():
    case = (("attitude gain", 0.06),)
    change = [(column("attitude_gain", "g"), 0.06)]
    flown = {
        CLEAN: Flown(tuple(flight(i) for i in range(12))),
        case: Flown(tuple(flight(i, change) for i in range(12))),
    }
    clean, found = measure(flown, lambda chosen: make_twin(chosen, LIBRARY, EVERY), 2, 2, (6, 6), 0)
    assert clean.falls == ((0.0, 0.0),) * 2
    assert found.named == 2
    for named, without in found.falls:
        assert without > 0.0
        assert named == pytest.approx(without, rel=0.2)
    assert write_table([clean, found]).splitlines()[-1].endswith(" % |")


def test_two_faults_at_once_count_where_both_are_named_and_where_something_else_is():
    case = (("attitude gain", 0.06), ("thrust", 0.05))
    change = [(column("attitude_gain", "g"), 0.06), (column("thrust_gain", "e"), 0.05)]
    flown = {
        CLEAN: Flown(tuple(flight(i) for i in range(12))),
        case: Flown(tuple(flight(i, change) for i in range(12))),
    }
    _, found = measure(flown, lambda chosen: make_twin(chosen, LIBRARY, EVERY), 1, 1, (6, 6), 0)
    assert (found.named, found.misled) == (1, 0)
    text = write_together([found]).splitlines()[-1]
    assert text.startswith("| attitude gain +0.06, thrust +0.05 | 1/1 (3 to 100 %) | 0/1 |")
    other = dataclasses.replace(found, case=(("attitude gain", 0.06), ("delay", 0.02)))
    assert (other.named, other.misled) == (0, 1)
    assert len(write_table([found]).splitlines()) == 2
