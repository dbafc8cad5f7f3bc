"""The committed evidence: keys that are today's, documents that regenerate byte for byte."""

import json
from pathlib import Path

import pytest

from bench.paper.tuning import write_tuning
from bench.plan.expansion import PROTOCOL, expand
from bench.plan.suite import load_suite
from bench.report.leaderboard import write_leaderboard
from bench.store.tables import Tables

HOUSE = Path(__file__).parents[2]
CURRENT = (
    *("paper", "paper_rotorpy", "tuning", "off_spec", "budget", "ablations"),
    *("floor", "worlds", "scale", "contact", "transfer", "field", "field_parts"),
)
"""Suites whose committed rows are of this protocol."""
UNCLEAN = {"transfer": 520, "field_parts": 200, "budget": 36}
"""Rows of a checkout with changes that were not committed, which docs/limits.md tells."""


@pytest.fixture(scope="module", params=CURRENT)
def suite(request):
    return request.param


def test_every_committed_row_has_the_key_that_its_run_has_today(suite):
    """A key that moves in silence makes committed evidence worthless: raise PROTOCOL instead.

    A field that came later and changes nothing at its default says so (metadata `neutral`).
    """
    tables = Tables.load(HOUSE / "results" / suite)
    keys = {run.name: run.key for run in expand(load_suite(suite)).runs}
    committed = tables.column("key")
    assert committed, "there is nothing to pin"
    moved = {run for run, key in committed.items() if keys.get(run) != key}
    assert not moved, f"{len(moved)} keys moved, e.g. {sorted(moved)[0]}; PROTOCOL is {PROTOCOL}"


def test_every_committed_row_says_where_it_comes_from(suite):
    runs = Tables.load(HOUSE / "results" / suite).runs
    for column in ("key", "commit", "program", "machine", "device", "committed"):
        assert runs[column].ne("").all(), column
    assert runs["dirty"].sum() == UNCLEAN.get(suite, 0)
    assert all(json.loads(text)["jax"] for text in runs["versions"])


@pytest.mark.parametrize(
    "path", sorted((HOUSE / "reports").glob("*/leaderboard.md")), ids=lambda path: path.parent.name
)
def test_a_committed_leaderboard_regenerates_byte_for_byte(path, tmp_path):
    tables = Tables.load(HOUSE / "results" / path.parent.name)
    write_leaderboard(tables, tmp_path / "leaderboard.md")
    assert (tmp_path / "leaderboard.md").read_bytes() == path.read_bytes()
    for method in tables.runs["method"].unique():
        assert method in path.read_text(encoding="utf-8").replace("\\", "")


def test_the_page_of_the_tuning_regenerates_byte_for_byte(tmp_path):
    write_tuning(Tables.load(HOUSE / "results" / "tuning"), tmp_path / "tuning.md")
    assert (tmp_path / "tuning.md").read_bytes() == (HOUSE / "reports" / "tuning.md").read_bytes()
