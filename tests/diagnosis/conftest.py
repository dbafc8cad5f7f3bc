"""What several files of tests fit to."""

import pytest
from flights_for_tests import point_mass_replay, point_mass_set


@pytest.fixture(scope="session")
def replay():
    """The replay of a point mass with every effect."""
    return point_mass_replay()


@pytest.fixture(scope="session")
def clean():
    """Flights in which nothing is wrong."""
    return point_mass_set(n_flights=6, seconds=6.0)
