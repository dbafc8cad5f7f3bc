"""What several files of tests fit to."""

import pytest
from flights_for_tests import point_mass_replay


@pytest.fixture(scope="session")
def replay():
    """The replay of a point mass with every effect."""
    return point_mass_replay()
