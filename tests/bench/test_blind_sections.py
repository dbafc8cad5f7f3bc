"""Proportions of the blind report."""

import pandas as pd

from blind.report import sections
from blind.score.scoring import proportion

MISSED = [{"case": str(i), "inside": 4.0 * (i > 1), "intervals": 4.0} for i in range(20)]
"""Of 20 answers two miss with all of their four intervals."""


def resampled(rows):
    plain = proportion(72, 80)
    found = sections._resampled(pd.DataFrame(rows), {"low": plain.low, "high": plain.high})
    assert found["low"] < plain.low
    assert found["high"] >= plain.high
    return found["low"]


def test_intervals_of_one_answer_that_miss_together_count_as_one():
    resampled(MISSED)


def test_answers_beside_one_reference_that_miss_together_count_as_one():
    by_case = resampled([row | {"reference": None} for row in MISSED])
    by_reference = resampled([row | {"reference": int(row["case"]) // 5} for row in MISSED])
    assert by_reference < by_case
