"""How long documents of many runs take, pooled statistics included."""

import numpy as np
import pytest
from tables_for_tests import Sheet

from bench.report.leaderboard import write_leaderboard
from bench.report.page import write_report
from bench.stats.pooled import pools


@pytest.fixture(scope="module")
def tables():
    """Of six entries, 24 cells and seven seeds: 1008 runs, with curves and flights.

    Beside them one run a cell of the method that a score of 1 means.
    """
    rng = np.random.default_rng(0)
    entries = [("lf_baseline", ""), ("hf_scratch", ""), ("hf_hotstart", "")]
    entries += [("hybrid", residual) for residual in ("affine", "sindy", "mlp")]
    sheet = Sheet()
    for task in ("spread", "circle", "figure8", "pitchandexpand"):
        for team_size in (3, 5, 7, 9, 12, 18):
            sheet.add_upper(task=task, team_size=team_size)
            for shift, entry in enumerate(entries):
                rewards = tuple(rng.normal(-80.0 + shift, 3.0, 7))
                sheet.add(*entry, task=task, team_size=team_size, rewards=rewards, drawn=True)
    return sheet.tables()


def test_leaderboard_of_a_thousand_runs(benchmark, tables, tmp_path):
    path = tmp_path / "leaderboard.md"
    benchmark.pedantic(lambda: write_leaderboard(tables, path), rounds=2)
    assert "## Pooled over 24 cells" in path.read_text(encoding="utf-8")
    assert len(pools(tables)[0].rows) == 6


def test_report_of_a_thousand_runs(benchmark, tables, tmp_path):
    path = tmp_path / "report.html"
    benchmark.pedantic(lambda: write_report(tables, path), rounds=1)
    assert path.stat().st_size < 40e6
