"""Faults of logs that are counted in random halves of flights."""

import sys

import pytest
from flights_for_tests import point_mass_set

from blind.power.halves import NOTHING, count, write
from blind.power.splits import parser_of, random_splits, read
from diagnosis.logs.flights import write_flights


def test_a_turned_path_is_counted_where_it_is_named_and_nothing_where_nothing_is_wrong():
    named = count(point_mass_set(n_flights=8, seconds=6.0), 2, (4, 4), seed=0)
    assert (named[NOTHING], named["path turned by 10 degrees"]) == (0, 2)
    assert "clock of inputs drifts by 1 %" in named
    table = write(named, 2)
    assert "| nothing | 0/2 (0 to 84 %) |" in table
    assert "| path turned by 10 degrees | 2/2 (16 to 100 %) |" in table


def test_a_split_has_so_many_of_each_and_none_twice():
    for before, after in random_splits(range(9), 5, (4, 3), seed=1, doing="splitting"):
        assert (len(before), len(after)) == (4, 3)
        assert len({*before, *after}) == 7


def test_a_set_with_too_few_flights_is_not_split(tmp_path, monkeypatch, capsys):
    flown = point_mass_set(n_flights=3, seconds=2.0)
    write_flights(tmp_path, flown.vehicle, flown.flights)
    for target, enough in ((1, True), (2, False)):
        given = [str(tmp_path), "--reference", "2", "--target", str(target)]
        monkeypatch.setattr(sys, "argv", ["power", *given])
        if enough:
            assert read(parser_of("power", None, 1, 1))[2] == (2, 1)
            continue
        with pytest.raises(SystemExit):
            read(parser_of("power", None, 1, 1))
    assert "--reference and --target need 4 flights" in capsys.readouterr().err
