"""Thresholds derived again from tables whose numbers are known."""

import json

import pandas as pd
import pytest

from bench.stats.statistics import records
from blind.score.thresholds import derived
from diagnosis.decision import Decision


def test_each_threshold_is_what_the_tables_say_of_it():
    columns = ["kind", "truth", "exact", "quiet", "structure", "unexplained_share", "probabilities"]
    cases = pd.DataFrame(
        [
            ("clean", "none", False, True, 1.04, 0.0, {}),
            ("single", "wind", True, False, 1.3, 0.001, {"wind": 0.6}),
            ("single", "drag", False, False, 1.25, 0.02, {"mass": 0.6}),
            ("pair", "drag + wind", True, False, 1.0, 0.003, {"drag": 1.0, "wind": 0.9}),
            ("unknown", "tether", False, False, 90.0, 0.8, {}),
        ],
        columns=columns,
    )
    cases["probabilities"] = cases["probabilities"].map(json.dumps)
    parameters = pd.DataFrame({"intervals": [3, 1], "inside": [2, 1]})
    found = {name: (value, n) for name, _, value, n in derived(records(cases), records(parameters))}
    assert found["structure"] == (1.3, 3)
    assert found["slight_structure"] == (1.04, 1)
    assert found["unexplained_share"] == (0.001, 1)
    assert found["much_share"] == (0.003, 2)
    assert found["true_share"] == (1.0, 2)
    assert found["doubted_share"] == (0.5, 2)
    # Three of four within: 1.15 of the standard deviations that are 1.96 x 1.2 wide.
    expected = Decision().interval_widening * 1.96 / 1.1503
    assert found["interval_widening"] == (pytest.approx(expected, rel=1e-3), 4)


def test_no_factor_makes_intervals_wide_enough_that_never_hold_the_truth():
    parameters = pd.DataFrame({"intervals": [3], "inside": [0]})
    assert derived([], records(parameters))[-1][2] == float("inf")


def test_what_no_case_says_is_not_a_number():
    columns = ["kind", "truth", "exact", "quiet", "structure", "unexplained_share", "probabilities"]
    cases = pd.DataFrame([("clean", "none", False, True, 1.0, 0.0, "{}")], columns=columns)
    parameters = pd.DataFrame({"intervals": [0], "inside": [0]})
    found = {name: (value, n) for name, _, value, n in derived(records(cases), records(parameters))}
    for name in ("unexplained_share", "true_share", "doubted_share", "interval_widening"):
        value, n = found[name]
        assert value != value
        assert n == 0
