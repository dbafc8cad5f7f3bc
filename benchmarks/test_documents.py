"""How long documents of many runs take, pooled statistics included."""

import numpy as np
from tables_for_tests import Sheet

from bench.report.leaderboard import write_leaderboard
from bench.stats.pooled import pools


def paper_sheet():
    """Six entries, 24 cells, seven seeds: 1008 runs."""
    rng = np.random.default_rng(0)
    entries = [("lf_baseline", ""), ("hf_scratch", ""), ("hf_hotstart", "")]
    entries += [("hybrid", residual) for residual in ("affine", "sindy", "mlp")]
    sheet = Sheet()
    for task in ("spread", "circle", "figure8", "pitchandexpand"):
        for team_size in (3, 5, 7, 9, 12, 18):
            for shift, entry in enumerate(entries):
                rewards = rng.normal(-80.0 + shift, 3.0, 7)
                sheet.add(*entry, task=task, team_size=team_size, rewards=tuple(rewards))
    return sheet


def test_leaderboard_of_a_thousand_runs(benchmark, tmp_path):
    tables = paper_sheet().tables()
    path = tmp_path / "leaderboard.md"
    benchmark.pedantic(lambda: write_leaderboard(tables, path), rounds=2)
    assert "## Pooled over 24 cells" in path.read_text(encoding="utf-8")
    assert len(pools(tables)[0].rows) == 6
