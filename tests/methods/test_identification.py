"""What is logged of calibration flights, and which of the sets that they allow is trained in."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import same

from diagnosis.fit import search
from diagnosis.fit.fit import Fit
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.windows import Normal
from diagnosis.replay.library import make_library
from methods.calibration import identification
from methods.calibration.identification import (
    DITHER,
    HELD,
    NOISE_ATTITUDE,
    NOISE_POS,
    NOISE_VEL,
    logged,
    standing,
)
from simulators.algebra.rotation import quat_to_rpy
from simulators.crazyflow import Crazyflow
from simulators.point_mass import PointMass

KEY = jax.random.key(3)
SIZES = {"pos": NOISE_POS, "vel": NOISE_VEL, "rpy": NOISE_ATTITUDE}


@pytest.fixture(scope="module")
def flights():
    """As they were flown, and as they are logged."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification, "logged", lambda flights, key: flights)
        flown = identification.fly(PointMass(), Crazyflow(), KEY)
    return flown, identification.fly(PointMass(), Crazyflow(), KEY)


def seen(flight):
    """What motion capture sees."""
    values = {"pos": flight.pos, "vel": flight.vel, "rpy": quat_to_rpy(flight.quat)}
    return {name: np.asarray(value, float) for name, value in values.items()}


@pytest.mark.parametrize("when", ["before", "after"])
def test_logs_carry_white_noise_of_the_stated_sizes(flights, when):
    flown, log = (seen(getattr(x, when)) for x in flights)
    for name, size in SIZES.items():
        noise = log[name] - flown[name]
        n = noise[..., 0].size
        assert noise.shape == (3, 500, 1, 3)
        spread = noise.std(axis=(0, 1, 2))
        np.testing.assert_allclose(spread, size, rtol=4.0 / np.sqrt(2.0 * n))
        np.testing.assert_allclose(noise.mean(axis=(0, 1, 2)), 0.0, atol=4.0 * size / np.sqrt(n))
        follows = np.mean(noise[:, 1:] * noise[:, :-1]) / size**2
        assert abs(follows) < 4.0 / np.sqrt(3.0 * n)


def test_noise_of_one_quantity_says_nothing_of_another(flights):
    flown, log = (seen(x.before) for x in flights)
    columns = [(log[name] - flown[name]).reshape(-1, 3) for name in SIZES]
    correlation = np.corrcoef(np.concatenate(columns, axis=1).T)
    off = correlation[~np.eye(9, dtype=bool)]
    assert np.abs(off).max() < 4.5 / np.sqrt(1500.0)


def test_what_stands_after_a_step_stands_before_the_next(flights):
    for flight in flights:
        for name in ("pos", "vel", "quat"):
            after, before = getattr(flight.after, name), getattr(flight.before, name)
            np.testing.assert_allclose(after[:, :-1], before[:, 1:], atol=1e-6)


def test_what_motion_capture_does_not_see_is_logged_as_it_was(flights):
    flown, log = flights
    np.testing.assert_array_equal(log.action, flown.action)
    np.testing.assert_array_equal(log.contact, flown.contact)
    for when in ("before", "after"):
        for name in ("t", "thrust", "ang_vel"):
            one, other = (getattr(getattr(x, when), name) for x in (log, flown))
            np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(jnp.linalg.norm(log.before.quat, axis=-1), 1.0, atol=1e-6)


def test_a_key_repeats_its_flights_and_another_key_flies_and_logs_others(flights):
    flown, log = flights
    assert same(identification.fly(PointMass(), Crazyflow(), KEY), log)
    assert same(logged(flown, KEY), logged(flown, KEY))
    assert not np.array_equal(logged(flown, KEY).before.pos, log.before.pos)  # its own key
    other = identification.fly(PointMass(), Crazyflow(), jax.random.key(4))
    moved = np.asarray(other.action - log.action)
    # Blocks of a dither that is held, seen through the tracker.
    assert np.abs(moved).max() > DITHER
    assert np.abs(np.asarray(other.after.pos - log.after.pos)).max() > 10.0 * NOISE_POS


def test_dither_is_held_bounded_and_another_in_each_flight(monkeypatch):
    given, whole = [], identification._fly
    spy = lambda *a: given.append(np.asarray(a[3])) or whole(*a)  # noqa: E731
    monkeypatch.setattr(identification, "_fly", spy)
    identification.fly(PointMass(), Crazyflow(), KEY)
    blocks = given[0].reshape(3, -1, HELD, 3)
    np.testing.assert_array_equal(blocks, blocks[:, :, :1].repeat(HELD, axis=2))
    assert 0.98 * DITHER < np.abs(blocks).max() <= DITHER
    assert len(np.unique(blocks[:, :, 0])) > 0.99 * blocks[:, :, 0].size


def test_drones_stand_at_first_and_noise_does_not_make_them_fly(flights):
    """Until rotors carry them, for about a tenth of a second; then for good."""
    for flight in flights:
        rows = np.asarray(standing(flight)).sum(axis=1)
        assert (rows >= 3).all()
        assert (rows <= 15).all()
        assert (np.diff(np.asarray(standing(flight)).astype(int), axis=1) <= 0).all()


def chosen(monkeypatch, *sets):
    """The choice among (evidence, chi-square), all of which a search finds."""
    evidence = {chi2: evidence for evidence, chi2 in sets}
    found = [_fit(chi2) for _, chi2 in sets]
    known = types.SimpleNamespace(log_evidence=lambda fit: evidence[fit.objective])

    class Fits(search.Fits):
        weighed = lambda self, phi: self  # noqa: E731

    fits = object.__new__(Fits)  # without flights: the choice alone is asked
    vars(fits).update(evidence=known, by_set={frozenset({str(f.objective)}): f for f in found})
    monkeypatch.setattr(search.Fits, "of", lambda evidence: fits)
    monkeypatch.setattr(identification.Evidence, "of", lambda likelihood: None)
    monkeypatch.setattr(identification, "search", lambda fits, largest: fits)
    monkeypatch.setattr(identification, "dispersion", lambda normal, n: 1.0)
    best = identification.choose(object.__new__(Likelihood), 3, 3).objective
    return evidence[best], best


def _fit(chi2):
    one, none = np.zeros(1), np.zeros((1, 1))
    normal = Normal(
        none[None],
        none,
        np.asarray([chi2]),
        one,
        np.zeros(1, int),
        one,
        np.zeros((1, 9)),
        np.zeros(1, bool),
    )
    return Fit(frozenset(), one, normal, one, one, 0.0)


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        ([(50.0, 900.0), (49.0, 880.0)], (49.0, 880.0)),  # as likely, and the better fit
        ([(50.0, 900.0), (47.9, 800.0)], (50.0, 900.0)),  # a better fit that is less likely
        ([(50.0, 900.0), (49.0, 910.0)], (50.0, 900.0)),
    ],
)
def test_of_equally_likely_sets_the_better_fit_is_taken(monkeypatch, sets, expected):
    assert chosen(monkeypatch, *sets) == expected


@pytest.mark.parametrize(
    ("name", "values", "acts"),
    [
        ("attitude_loop", {"natural_freq": 20.0, "damping": 1.0}, True),
        ("attitude_loop", {"natural_freq": 3e7, "damping": 1.97}, False),
        ("attitude_loop", {"natural_freq": float("inf"), "damping": 0.3}, False),
        ("drag", {"c": 0.0}, False),
        ("drag", {"c": 0.1}, True),
    ],
)
def test_what_does_nothing_is_not_trained_with(name, values, acts):
    library = make_library(PointMass())
    assert identification._acts(library, name, values) is acts
