"""A sweep of all 24 cells, made once."""

import paper_tables
import pytest


@pytest.fixture(scope="session")
def full_tables():
    """All 24 cells; every claim is supported."""
    return paper_tables.as_claimed().tables()
