"""Faults of logs that are counted in random halves of flights."""

from flights_for_tests import point_mass_set

from blind.power.halves import NOTHING, count, write


def test_a_turned_path_is_counted_where_it_is_named_and_nothing_where_nothing_is_wrong():
    named = count(point_mass_set(n_flights=8, seconds=6.0), 2, (4, 4), seed=0)
    assert (named[NOTHING], named["path turned by 10 degrees"]) == (0, 2)
    assert "clock of inputs drifts by 1 %" in named
    table = write(named, 2)
    assert "| nothing | 0/2 (0 to 84 %) |" in table
    assert "| path turned by 10 degrees | 2/2 (16 to 100 %) |" in table
