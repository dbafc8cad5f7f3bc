"""What is flown is what the advice says, and it separates what it should."""

import numpy as np
import pytest

from blind.fly import paths
from blind.fly.realities import DT
from blind.score.manoeuvres import TRIALS, Range, directions
from diagnosis.decision import Decision
from diagnosis.remedies import flight_paths
from simulators import registry
from simulators.effects.card import load_cards, manoeuvre_path

T = np.arange(round(12.0 / DT)) * DT


def test_every_advice_is_flown_in_both_directions_and_for_as_long_as_bland_flights():
    advised = [{name, other} for name, c in load_cards().items() for other in c.separated_from]
    assert set(TRIALS) == {frozenset(pair) for pair in advised}
    assert {frozenset(d) for d in directions()} == set(TRIALS)
    assert len(set(directions())) == len(directions()) == 2 * len(TRIALS)
    for trial in TRIALS.values():
        advised, bland = (f.n * f.seconds for f in (trial.advised, trial.bland))
        assert advised == bland


def test_what_is_handed_out_is_the_path_that_was_tried():
    for pair, trial in TRIALS.items():
        tried = trial.advised.path
        sharp = tried in (paths.attitude_steps, paths.both_steps)
        assert manoeuvre_path(*pair) == (None if sharp else tried.__name__)


@pytest.mark.parametrize(
    "path", dict.fromkeys(t.advised.path for t in TRIALS.values()), ids=lambda p: p.__name__
)
def test_targets_start_at_rest_and_belong_together(path):
    target = paths.tracked(path, T)
    assert np.linalg.norm(target.vel[0]) < 0.05
    assert np.allclose(np.diff(target.pos, axis=0) / DT, target.vel[:-1], atol=0.05)
    # No more than the controller may ask for.
    assert np.abs(target.acc[:, :2]).max() < 0.6 * 9.81
    assert target.pos[:, 2].min() >= 0.05 - 1e-9


def test_steps_are_as_large_and_as_frequent_as_advised():
    sharp = paths.attitude_steps(T).dither[:, :2]
    steps = np.flatnonzero(np.abs(np.diff(sharp, axis=0)).sum(axis=1) > 1e-9)
    assert np.diff(steps) * DT == pytest.approx(paths.STEP_EVERY, abs=2 * DT)
    assert np.ptp(sharp, axis=0) == pytest.approx([0.3, 0.3])
    both = paths.both_steps(T).dither
    assert not np.any(np.any(both[:, :2] != 0, axis=1) & (both[:, 3] != 0))
    assert np.ptp(both[:, 3]) == pytest.approx(0.3)


def test_speeds_heights_and_turns_are_as_advised():
    speed = np.abs(paths.tracked(flight_paths.two_speeds, T).vel[:, 0])
    for wanted in (0.5, 3.0):
        assert np.sum(np.abs(speed - wanted) < 1e-3) * DT > 1.9
    assert np.abs(paths.tracked(flight_paths.fast_lines, T).vel[:, 0]).max() > 2.0
    height = paths.tracked(flight_paths.heights, T).pos[:, 2]
    for wanted in (1.0, 0.3, 0.1, 0.05):
        assert np.sum(np.abs(height - wanted) < 1e-3) * DT > 1.0
    yaw = paths.tracked(flight_paths.turning, T).yaw
    assert np.abs(yaw).max() < np.pi
    assert yaw[np.searchsorted(T, [2.9, 5.9, 8.9, 11.9])] == pytest.approx(
        np.pi / 2 * np.asarray([0.0, 1.0, 0.0, -1.0])
    )
    swing = paths.tracked(flight_paths.pumping, T).acc[:, 2] / 9.81
    assert np.abs(swing).max() == pytest.approx(0.5, abs=0.1)


@pytest.fixture(scope="module")
def few():
    """A range with the effects of these tests alone."""
    tried = {"mass", "thrust_gain", "drag", "rotor_drag", "delay", "clock_drift"}
    return Range(exclude=set(registry.names("effect")) - tried)


def test_fast_lines_tell_mass_from_thrust_where_hover_does_not(few):
    found = few.margins("mass", "thrust_gain")
    assert found.bland < Decision().decidable_chi2 < found.advised
    assert found.separated
    assert found.seconds == 10.0


@pytest.mark.parametrize(("truth", "rival"), [("rotor_drag", "drag"), ("drag", "rotor_drag")])
def test_tumbling_tells_drag_of_the_rotors_from_drag_of_the_body(few, truth, rival):
    found = few.margins(truth, rival)
    assert found.bland < Decision().decidable_chi2 < found.advised
    assert found.separated


@pytest.mark.parametrize(
    ("truth", "rival"),
    [
        ("clock_drift", "delay"),
        pytest.param("delay", "clock_drift", marks=pytest.mark.exhaustive),
    ],
)
def test_steps_tell_a_drifting_clock_from_a_delay(few, truth, rival):
    found = few.margins(truth, rival)
    assert Decision().decidable_chi2 < found.advised > found.bland
    assert found.separated


def test_a_pair_without_advice_is_refused():
    with pytest.raises(ValueError, match=r"must be a pair that there is advice for .* got 'drag'"):
        Range().margins("drag", "wind")
