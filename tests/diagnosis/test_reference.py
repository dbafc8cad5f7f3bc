"""The fit of reference flights ends early where no step that is left can make it follow them."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import SIGMA, edited, point_mass_set

from diagnosis.decide import prepared
from diagnosis.decide.prepared import make_likelihood
from diagnosis.decide.reference import Reference, fit_reference
from diagnosis.fit import descent
from diagnosis.replay.library import make_library
from diagnosis.replay.replay import make_replay
from simulators.effects.delay import Delay
from simulators.effects.drag import Drag
from simulators.effects.mass import Mass
from simulators.point_mass import PointMass


@pytest.fixture(scope="module")
def replay():
    return make_replay(make_library(PointMass(dt=0.005), referenced=True), 0.005)


@pytest.fixture
def steps(monkeypatch):
    """One entry for each step that a fit asks whether it ends."""
    made, ends = [], descent._ends
    monkeypatch.setattr(descent, "_ends", lambda *args: made.append(1) or ends(*args))
    return made


def backwards(flight):
    """A flight whose commands were logged in the wrong order: no effect describes it."""
    return edited(flight, lambda log: {"cmd": log.cmd[::-1]})


def test_flights_that_no_effect_describes_are_unfollowed_after_fewer_steps(replay, steps):
    flights = [backwards(flight) for flight in point_mass_set(n_flights=3).flights]
    whole = fit_reference(make_likelihood(replay, flights, SIGMA))
    n_whole = len(steps)
    early = fit_reference(make_likelihood(replay, flights, SIGMA), or_twin=True)
    assert whole.unfollowed()
    assert early.unfollowed()
    assert len(steps) - n_whole < 0.6 * n_whole


def test_flights_that_effects_describe_are_fitted_to_the_end(replay):
    effects = Mass(e=0.3), Delay(seconds=0.06), Drag(c=1.0)
    flights = point_mass_set(*effects, n_flights=3).flights
    whole = fit_reference(make_likelihood(replay, flights, SIGMA))
    early = fit_reference(make_likelihood(replay, flights, SIGMA), or_twin=True)
    assert not whole.unfollowed()
    for name, kept in whole.to_arrays().items():
        np.testing.assert_array_equal(early.to_arrays()[name], kept, err_msg=name)


@pytest.mark.parametrize(("or_twin", "fitted"), [(True, [3]), (False, [5])])
def test_all_reference_flights_are_fitted_unless_a_twin_takes_over(monkeypatch, or_twin, fitted):
    """A team has no twin: a reference that is not followed stays, and is fitted whole."""
    asked = []

    def lost(replay, logs, *_, **__):
        asked.append(len(logs))
        n = len(replay.library.neutral)
        enlarged, none = np.full(9, 100.0), np.zeros(n)
        return Reference(replay.library.neutral, np.eye(n), enlarged, 1.0, 0.0, 0.0, none, none)

    monkeypatch.setattr(prepared, "reference_of", lost)
    question = prepared.Question(
        point_mass_set(n_flights=1), "point_mass", point_mass_set(n_flights=5)
    )
    prepared.prepare(question, or_twin=or_twin)
    assert asked == fitted


def test_without_a_narrow_program_every_replay_has_all_slopes(replay):
    logs = point_mass_set(n_flights=1, seconds=2.0).flights
    few = make_likelihood(replay, logs, SIGMA)
    every = dataclasses.replace(few, narrow=False)
    told = []
    for likelihood in (few, every):
        likelihood.normal(replay.library.neutral)  # what errors of starts take is known after it
        curvature = likelihood.normal(0.01 + replay.library.neutral, [0]).H.sum(axis=0)
        told.append(np.count_nonzero(np.diag(curvature)))
    assert told[0] <= 1 < told[1]
