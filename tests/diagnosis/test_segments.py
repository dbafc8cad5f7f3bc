"""How flights are cut into windows, and what a hole in a log does to them."""

import numpy as np
import pytest
from flights_for_tests import SIGMA, point_mass_set, some_rows, thinned

from diagnosis.logs.flights import FlightLog
from diagnosis.logs.noise import estimate_noise
from diagnosis.logs.segments import (
    FORGET,
    N_WINDOWS,
    NODE_DT,
    REPLAY_WINDOW_S,
    body_rate,
    cut,
    filled,
)
from simulators.effects.wind import Wind


@pytest.fixture(scope="module")
def flights():
    return point_mass_set(Wind(x=0.3), n_flights=2, seconds=6.0).flights


def without(flight, rows):
    """The flight with some rows of its log lost."""
    return thinned(flight, np.setdiff1d(np.arange(len(flight.drones[0].t)), rows))


def test_every_row_is_a_node_of_one_window_at_most(flights):
    (group,) = cut(flights, 0.005)
    start = group.start[:, None] + REPLAY_WINDOW_S * np.arange(N_WINDOWS + 1)
    at = start[:, :, None, None] + 0.005 * group.place
    for i in range(2):
        mine = np.round(at[group.flight == i][group.valid[group.flight == i]] / NODE_DT)
        assert len(np.unique(mine)) == len(mine) > 200


def test_nodes_lie_within_their_window(flights):
    (group,) = cut(flights, 0.005)
    inside = group.place[group.valid] * 0.005
    assert inside.min() > 0
    assert inside.max() <= REPLAY_WINDOW_S + NODE_DT / 2


def test_the_window_before_the_first_is_never_scored(flights):
    (group,) = cut(flights, 0.005)
    assert not group.valid[:, 0].any()


def test_a_gap_masks_nodes_until_the_attitude_was_set_anew(flights):
    gone = np.arange(100, 120)  # 2.0 s to 2.4 s
    (group,) = cut([without(flights[0], gone)], 0.005)
    at = (
        group.start[:, None, None, None] + REPLAY_WINDOW_S * np.arange(N_WINDOWS + 1)[:, None, None]
    )
    at = (at + 0.005 * group.place)[group.valid]
    assert not np.any((at > 2.01) & (at < 2.5 + FORGET - 1e-6))
    fresh = group.start[:, None] + REPLAY_WINDOW_S * np.arange(N_WINDOWS + 1)
    assert fresh[group.fresh[..., 0]] == pytest.approx([0.0, 2.5])


def test_a_gap_makes_only_the_windows_after_it_doubtful(flights):
    (group,) = cut([without(flights[0], np.arange(150, 170))], 0.005)
    edges = group.start[:, None] + REPLAY_WINDOW_S * np.arange(N_WINDOWS + 1)
    doubtful = edges[group.doubtful]
    assert set(np.round(doubtful, 3)) == {-0.5, 0.0, 0.5, 1.0, 3.0, 3.5, 4.0, 4.5}


def test_one_missing_row_between_like_commands_is_interpolated():
    t = np.delete(np.arange(10) * 0.02, 5)
    cmd = np.column_stack([np.linspace(0, 0.09, 10)] * 3 + [np.full(10, 0.4)])
    times, cmds, unknown = filled(t, np.delete(cmd, 5, axis=0))
    assert unknown == []
    np.testing.assert_allclose(cmds, cmd, atol=1e-12)
    np.testing.assert_allclose(times, np.arange(10) * 0.02, atol=1e-12)


def test_one_missing_row_between_different_commands_stays_unknown():
    t = np.delete(np.arange(10) * 0.02, 5)
    cmd = np.zeros((9, 4))
    cmd[5:, 0] = 0.2
    _, cmds, unknown = filled(t, cmd)
    assert len(cmds) == 9
    np.testing.assert_allclose(unknown, [(0.1, 0.12)])


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.3, -0.2, 1.0)])
def test_body_rate_is_the_derivative_of_the_rotation(rpy):
    from scipy.spatial.transform import Rotation

    rpy, rate, h = np.asarray(rpy), np.array([0.5, -0.3, 0.8]), 1e-6
    before, after = (Rotation.from_euler("xyz", rpy + s * h * rate) for s in (-0.5, 0.5))
    turn = (before.inv() * after).as_rotvec() / h
    np.testing.assert_allclose(body_rate(rpy, rate), turn, atol=1e-5)


def test_noise_is_recovered_from_the_logs(flights):
    np.testing.assert_allclose(estimate_noise(flights), SIGMA, rtol=0.15)


def test_noise_is_recovered_when_time_is_not_uniform(flights):
    rng = np.random.default_rng(0)
    lost = [without(f, rng.choice(300, 30, replace=False)) for f in flights]
    np.testing.assert_allclose(estimate_noise(lost), SIGMA, rtol=0.2)


def test_a_drone_that_logs_later_is_not_flown_before(flights):
    """Nothing of it counts until its attitude was measured and its rotors have followed."""
    early, late = (flight.drones[0] for flight in flights)
    keep = late.t >= 1.8
    (group,) = cut([FlightLog("both", (early, some_rows(late, keep)))], 0.005)
    edges = group.start[:, None] + REPLAY_WINDOW_S * np.arange(N_WINDOWS + 1)
    at = edges[:, :, None] + 0.005 * group.place[:, :, 1]
    assert at[group.valid[:, :, 1]].min() >= 2.0 + FORGET - 1e-6
    assert edges[group.fresh[:, :, 1]] == pytest.approx([2.0])
    assert edges[group.fresh[:, :, 0]] == pytest.approx([0.0])
    assert group.doubtful[np.abs(edges - 2.0) < 1e-6].all()


def test_a_drone_that_has_landed_does_not_fly_away(flights):
    """After its last row it stays where it was seen last, for what others feel of it."""
    early, late = (flight.drones[0] for flight in flights)
    keep = late.t < 2.0
    (group,) = cut([FlightLog("both", (early, some_rows(late, keep)))], 0.005)
    edges = group.start[:, None] + REPLAY_WINDOW_S * np.arange(N_WINDOWS + 1)
    after = group.pos[edges > 2.0][:, 1]
    last = late.pos[keep][-1]
    np.testing.assert_allclose(after, np.broadcast_to(last, after.shape), atol=0.01)
