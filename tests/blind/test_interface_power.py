"""How often faults of logs are named on flights that were drawn: what is put in, and the tables."""

import pytest
from flights_for_tests import flight_set, made_log

from blind.draw.faults import ALL
from blind.power.interface import PUT, Said, say, say_all, write_tables
from diagnosis.interface.fault import PARTS
from diagnosis.logs.flights import FlightLog


@pytest.fixture(scope="module")
def flights():
    return flight_set([FlightLog(f"flight{i}", (made_log(),)) for i in range(2)])


def test_every_fault_of_a_log_without_a_size_is_put_in_and_has_a_part_that_names_it():
    whole = {name for name, fault in ALL.items() if fault.sizes == ("whole",)}
    assert whole < {*PUT}
    for put in PUT.values():
        assert {*put.parts} <= {*PARTS}
        assert put.parts


def test_flights_are_checked_as_they_are_and_with_every_fault_that_they_can_have(flights):
    said = list(say_all("clean", flights))
    assert said[0].fault == ""
    assert not said[0].refused
    assert {one.fault for one in said[1:]} == {
        n for n, p in PUT.items() if ALL[p.fault].fits(flights)
    }


def test_files_that_cannot_be_read_are_refused_which_names_the_fault(flights):
    said = say("clean", "degrees", flights)
    assert said.refused
    assert said.named


def test_the_tables_count_false_alarms_and_what_is_said_instead():
    def one(fault, *parts, kind="clean"):
        return Said(kind, fault, frozenset(parts), False)

    table = write_tables(
        [
            one(""),
            one("", "thrust"),
            one("", kind="single"),
            one("grams", "thrust"),
            one("grams"),
            one("flipped_axis", "velocity"),
        ]
    )
    assert "| clean | 2 | 1/2 (1.3 to 98.7 %) | thrust (1) |" in table
    assert "| single | 1 | 0/1 (0.0 to 97.5 %) |  |" in table
    assert "| grams | 1/2 (1.3 to 98.7 %) | nothing (1) |" in table
    assert "| flipped_axis | 0/1 (0.0 to 97.5 %) | velocity (1) |" in table
    assert "body_velocity" not in table
