"""A sweep of all 24 cells and its pages, made once."""

import paper_tables
import pytest

from bench.paper.page import write_claims


@pytest.fixture(scope="session")
def full_tables():
    """All 24 cells; every claim is supported."""
    return paper_tables.as_claimed().tables()


@pytest.fixture(scope="session")
def full(tmp_path_factory, full_tables):
    """The folder in which the page of all 24 cells was written, notes included."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "notes.md").write_text("## Lags\n\nBecause of *lag*.\n", encoding="utf-8")
    write_claims(full_tables, folder / "out" / "paper.md", folder / "notes.md")
    return folder / "out"


@pytest.fixture(scope="session")
def text(full):
    return (full / "paper.md").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def html(full):
    return (full / "paper.html").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def cells(full):
    return (full / "paper_cells.md").read_text(encoding="utf-8")
