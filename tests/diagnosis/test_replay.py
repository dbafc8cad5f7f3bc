"""Batches of segments that are flown at once come back in their order."""

import numpy as np
import pytest
from flights_for_tests import SIGMA, fly

from diagnosis.decide.prepared import make_likelihood
from diagnosis.replay import replay
from diagnosis.replay.library import make_library
from simulators import registry
from simulators.contract import replayable_class


@pytest.mark.parametrize("cores", [2, 5])
def test_it_does_not_matter_how_many_cores_fly(monkeypatch, cores):
    simulator = registry.load("simulator", "point_mass")(
        dt=replayable_class("point_mass").replay_dt
    )
    flights = fly(simulator, n_flights=2 * replay.LANES + 1, seconds=3.0)
    flown = replay.make_replay(make_library(simulator), replayable_class("point_mass").replay_dt)
    at = flown.library.neutral

    def normal(count):
        monkeypatch.setattr(replay, "_cores", lambda: count)
        return make_likelihood(flown, flights, SIGMA).normal(at)

    alone, together = normal(1), normal(cores)
    assert sorted(set(alone.flight)) == list(range(len(flights)))
    np.testing.assert_array_equal(together.g, alone.g)
    np.testing.assert_array_equal(together.H, alone.H)
