"""A single flight before, or a single flight after: it is cut into parts."""

import numpy as np
import pytest
from test_twin import EVERY, LIBRARY, column, flight, long_flight, plain_twin

from diagnosis.logs.flights import LogError
from diagnosis.twin.diagnose_change import answer_change
from diagnosis.twin.twin import make_twin


def test_the_parts_of_a_flight_count_each_of_its_samples_once():
    whole = long_flight(1)
    parts = whole.parts(40)
    counted = [part.measured[part.valid] for part in parts]
    assert len(parts) == whole.valid.sum() // 125
    assert min(map(len, counted)) >= 125
    np.testing.assert_array_equal(np.concatenate(counted), whole.measured[whole.valid])
    # What precedes a part is there for the memory, and does not count.
    np.testing.assert_array_equal(
        parts[1].measured[:40], whole.measured[parts[0].valid.size - 40 :][:40]
    )
    assert not parts[1].valid[:40].any()


def test_a_single_reference_flight_makes_a_twin_that_names_nothing():
    """It says what looks likeliest: how flights differ without a change, nobody knows."""
    twin = make_twin([long_flight(1)], LIBRARY, EVERY)
    assert [score.name for score in twin.scores] == ["long flight 1"]
    np.testing.assert_allclose(twin.memory.weights[0][:3], [0.3, 0.15, 0.05], atol=0.05)
    changed = long_flight(2, [(column("attitude_gain", "g"), 0.06)])
    for flights in (
        [changed],
        [flight(i, [(column("attitude_gain", "g"), 0.06)]) for i in range(8)],
    ):
        found, _ = answer_change(twin, flights)
        assert (found.change, found.effects) == ("too_few", ())
        assert found.candidates[0].effect == "attitude_gain"


def test_a_single_changed_flight_is_scored_part_by_part():
    changed = long_flight(2, [(column("attitude_gain", "g"), 0.06)])
    found, (scored,) = answer_change(plain_twin(), [changed])
    assert found.effects == ("attitude_gain",)
    assert scored.after.shape == scored.before.shape
    assert found.misfit[1] < 0.5 * found.misfit[0]
    assert np.nanmean(scored.drift(scored.after)) < np.nanmean(scored.drift(scored.before))


def test_one_short_reference_flight_is_refused():
    with pytest.raises(
        LogError, match=r"with 5.8 s that count; 2 flights are expected, or one of 7"
    ):
        make_twin([flight(0)], LIBRARY, EVERY)
