"""Batches of segments that are flown at once come back in their order."""

import numpy as np
from flights_for_tests import COMMON, SIGMA, all_but, fly

from diagnosis.decide.prepared import make_likelihood
from diagnosis.replay import replay
from diagnosis.replay.library import make_library
from simulators import registry
from simulators.contract import replayable_class


def test_it_does_not_matter_how_many_cores_fly(monkeypatch):
    simulator = registry.load("simulator", "point_mass")(
        dt=replayable_class("point_mass").replay_dt
    )
    flights = fly(simulator, n_flights=2 * replay.LANES + 1, seconds=3.0)
    library = make_library(simulator, all_but(*COMMON))
    flown = replay.make_replay(library, replayable_class("point_mass").replay_dt)
    at = flown.library.neutral

    def normal(count):
        monkeypatch.setattr(replay, "_cores", lambda: count)
        return make_likelihood(flown, flights, SIGMA).normal(at)

    alone = normal(1)
    assert sorted(set(alone.flight)) == list(range(len(flights)))
    for cores in (2, 5):
        together = normal(cores)
        np.testing.assert_array_equal(together.g, alone.g)
        np.testing.assert_array_equal(together.H, alone.H)
