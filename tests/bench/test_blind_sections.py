"""Proportions of the blind report."""

import pandas as pd

from blind.report import sections
from blind.score.scoring import proportion


def test_coverage_is_resampled_by_case():
    """Four intervals of one fit that miss together are not four misses of 40."""
    rows = [{"case": str(i), "inside": 4.0 * (i > 0), "intervals": 4.0} for i in range(10)]
    plain = proportion(36, 40)
    found = sections._by_case(pd.DataFrame(rows), {"low": plain.low, "high": plain.high})
    assert found["low"] < plain.low
    assert found["high"] >= plain.high
