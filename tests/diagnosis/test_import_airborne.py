"""Take-off and landing in a log that is imported."""

import dataclasses

import numpy as np
import pytest
from import_logs_for_tests import circle, streams

from diagnosis.importing.airborne import airborne, with_hint
from diagnosis.importing.resample import make_rows
from diagnosis.logs.columns import LogError

FREQ = 100.0


def flight(*, ground_s=1.0, climb_s=1.0, top=1.0, lands=True):
    """Rows of a drone that stands, rises to `top`, circles there, and lands."""
    log = circle(seconds=8.0, freq=FREQ)
    end = log.t[-1] if lands else np.inf
    rise = np.clip((log.t - ground_s) / climb_s, 0.0, 1.0)
    share = np.minimum(rise, np.clip((end - ground_s - log.t) / climb_s, 0.0, 1.0))
    pos = log.pos * share[:, None]
    pos[:, 2] = -3.0 + top * share  # heights count from the lowest row
    return make_rows(streams(dataclasses.replace(log, pos=pos)), 0.0)


def test_what_lies_low_is_left_out_at_both_ends():
    rows = flight()
    kept = airborne(rows, 0.5)
    assert kept.columns["t"][[0, -1]] == pytest.approx([1.5, 6.5], abs=0.03)
    high = rows.columns["pos_z"] > -2.5
    for name, values in rows.columns.items():
        np.testing.assert_array_equal(kept.columns[name], values[high])
    assert "0.5 m above the lowest height, 3.0 of 8.0 s" in kept.notes[-1]


def test_a_landing_in_between_leaves_a_hole():
    rows = flight()
    twice = {n: np.concatenate([v, v]) for n, v in rows.columns.items()}
    twice["t"][len(rows.columns["t"]) :] += 8.0
    t = airborne(dataclasses.replace(rows, columns=twice), 0.5).columns["t"]
    assert np.diff(t).max() == pytest.approx(3.0, abs=0.1)


def test_a_log_without_height_keeps_nothing():
    with pytest.raises(LogError, match=r"the log's heights differ by 0\.2 m"):
        airborne(flight(top=0.2), 0.5)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "begins and ends at rest"),
        ({"lands": False}, "The log begins at rest"),
        ({"ground_s": 0.0}, None),  # in the air from the first second to the last
        ({"top": 0.2}, None),  # a drone that hovers low
    ],
)
def test_the_report_says_where_take_off_and_landing_seem_to_show(given, words):
    rows = flight(**given)
    said = with_hint(rows)
    assert said.columns is rows.columns
    if words is None:
        assert said.notes == rows.notes
    else:
        assert words in said.notes[-1]
        assert "--above 0.5" in said.notes[-1]
