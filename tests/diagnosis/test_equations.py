"""What flights have of their own, against explicit least squares."""

import numpy as np
import pytest

from diagnosis.fit.equations import Switched, dispersion, loosened, moved, spread_between
from diagnosis.fit.windows import Normal
from diagnosis.replay.whitening import shaken

N_PARAMS, N_WINDOWS = 3, 10


def normal_of(flights):
    """Normal equations of (J, r) a flight, cut into windows."""
    windows = [
        (J, r, i)
        for i, (J_all, r_all) in enumerate(flights)
        for J, r in zip(np.split(J_all, N_WINDOWS), np.split(r_all, N_WINDOWS), strict=True)
    ]
    n = len(windows)
    return Normal(
        H=np.stack([J.T @ J for J, _, _ in windows]),
        g=np.stack([J.T @ r for J, r, _ in windows]),
        c=np.asarray([r @ r for _, r, _ in windows]),
        dof=np.asarray([float(len(r)) for _, r, _ in windows]),
        flight=np.asarray([i for _, _, i in windows]),
        t=0.5 * np.arange(n) % 5.0,
        kind=np.zeros((n, 9)),
        doubtful=np.zeros(n, bool),
    )


def draws(rng, n_flights, own=(0.0, 0.0, 0.0), rows=60):
    """Linear flights with noise of one, whose parameters differ by `own` standard deviations."""
    mixed = rng.normal(size=(N_PARAMS, N_PARAMS)) * 0.3 + np.eye(N_PARAMS)
    flights = []
    for _ in range(n_flights):
        J = rng.normal(size=(rows, N_PARAMS)) @ mixed
        flights.append((J, J @ (rng.normal(size=N_PARAMS) * own) + rng.normal(size=rows)))
    return flights


def test_every_flight_takes_its_most_likely_draw():
    """Chi-square after any common step is the least over the draws, their cost included."""
    rng = np.random.default_rng(0)
    flights, spread = draws(rng, 4, own=(0.3, 0.0, 0.2)), np.asarray([0.09, 0.0, 0.04])
    loose = np.flatnonzero(spread)
    for step in np.concatenate([np.zeros((1, N_PARAMS)), rng.normal(size=(3, N_PARAMS))]):
        expected = 0.0
        for J, r in flights:
            cost = np.diag(1.0 / np.sqrt(spread[loose]))
            design = np.concatenate([J[:, loose], cost])
            target = np.concatenate([r - J @ step, np.zeros(len(loose))])
            expected += np.linalg.lstsq(design, target, rcond=None)[1][0]
        assert moved(loosened(normal_of(flights), spread), step).chi2 == pytest.approx(expected)


def test_what_is_taken_away_belongs_to_its_flight_and_counts_no_number():
    normal = normal_of(draws(np.random.default_rng(1), 3))
    loose = loosened(normal, np.asarray([0.1, 0.0, 0.0]))
    assert loose.dof.sum() == normal.dof.sum()
    one = loose.of(loose.flight == 1)
    alone = loosened(normal.of(normal.flight == 1), np.asarray([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(one.H.sum(axis=0), alone.H.sum(axis=0))
    assert loosened(normal, np.zeros(N_PARAMS)) is normal


def test_the_spread_between_flights_is_found_where_it_is():
    """One parameter of three differs by 0.5; noise is one, so that the dispersion is near one."""
    everything = np.ones(N_PARAMS, bool)
    found = []
    for seed in range(20):
        flights = draws(np.random.default_rng(seed), 16, own=(0.0, 0.5, 0.0))
        found.append(spread_between(normal_of(flights), everything))
    found = np.asarray(found)
    assert (found[:, 1] > 0).all()
    assert np.median(found[:, 1]) == pytest.approx(0.25, rel=0.3)
    assert np.median(found[:, [0, 2]]) == 0.0
    held = spread_between(normal_of(flights), np.asarray([True, False, True]))
    assert held[1] == 0.0


def test_like_flights_draw_nothing():
    everything = np.ones(N_PARAMS, bool)
    loose = [
        spread_between(normal_of(draws(np.random.default_rng(s), 8)), everything).any()
        for s in range(50)
    ]
    assert sum(loose) <= 2
    few = draws(np.random.default_rng(0), 3, own=(2.0, 2.0, 2.0))
    assert not spread_between(normal_of(few), everything).any()


@pytest.mark.parametrize("onset", [-1.0, 0.0, 1.2, 1.3, 4.9, 9.0])
def test_what_is_switched_on_acts_in_the_windows_from_its_onset_on(onset):
    """Against flights whose slopes are put at zero before it; a flight's windows in any order."""
    flights, columns = draws(np.random.default_rng(5), 3), [0, 2]
    shuffled = np.random.default_rng(6).permutation(3 * N_WINDOWS)
    found = Switched(normal_of(flights).of(shuffled), columns).at(onset)
    on = np.repeat(0.5 * np.arange(N_WINDOWS) >= onset - 0.25, 60 // N_WINDOWS)
    for i, (J, r) in enumerate(flights):
        J = J.copy()
        J[np.ix_(~on, columns)] = 0.0
        np.testing.assert_allclose(found.H[i], J.T @ J, atol=1e-9)
        np.testing.assert_allclose(found.g[i], J.T @ r, atol=1e-9)
        assert found.c[i] == pytest.approx(r @ r)
    assert found.flight.tolist() == [0, 1, 2]


def test_shaken_windows_move_as_white_noise_moves_them():
    """Covariances of velocity and position against sums of many small random accelerations."""
    seconds, n, noise = 0.5, 200, 0.3
    rng, dt = np.random.default_rng(0), seconds / 200
    acc = rng.normal(size=(20_000, n)) * noise * np.sqrt(n)
    vel = np.cumsum(acc * dt, axis=1)
    pos = np.cumsum(vel * dt, axis=1)
    at = np.asarray([99, 199])
    A = shaken((dt * (at + 1.0))[:, None], seconds, noise)
    for column in (0, 1):
        x, v = A[:, :, column], A[:, :, 3 + column]
        drawn = np.cov(np.concatenate([pos[:, at], vel[:, at]], axis=1).T)
        found = np.concatenate([x, v], axis=1).T @ np.concatenate([x, v], axis=1)
        # Three polynomials hold all of the mean and most of what is faster.
        np.testing.assert_allclose(found, drawn, rtol=0.2)
        np.testing.assert_allclose(found[3, 3], (noise * seconds) ** 2, rtol=1e-6)
    assert not A[:, :, [2, 5, 6, 7, 8]].any()


def test_what_two_flights_draw_for_themselves_is_no_dispersion():
    """Its entries stand after all windows and would make a block of time of their own."""
    rng = np.random.default_rng(4)
    normal = normal_of(draws(rng, 2, own=(0.5, 0.0, 0.0), rows=2000))
    loose = loosened(normal, np.asarray([0.25, 0.0, 0.0]))
    assert dispersion(loose, 2) == pytest.approx(dispersion(normal, 2))
