"""Contact, the exact penalty and its differentiable surrogate."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tasks import contact
from tasks.contact import GRACE, PENALTY, distances, in_contact, penalty, soft_penalty

INNER, OUTER = contact.CONTACT_DISTANCE, contact.CONTACT_DISTANCE + contact._MARGIN
"""Where the surrogate turns from a line into a parabola, and where it ends [m]."""
STEEPEST = PENALTY / contact._MARGIN
"""Largest slope of the surrogate [1/m]."""


def pair(distance, z=1.0):
    return jnp.asarray([[0.0, 0.0, z], [distance, 0.0, z], [9.0, 9.0, z]])


def soft(distance):
    """The surrogate of one drone with one neighbour at a distance."""
    return soft_penalty(jnp.asarray([[jnp.inf, distance], [distance, jnp.inf]]))[0]


@pytest.mark.parametrize(("distance", "touching"), [(0.05, True), (0.299, True), (0.301, False)])
def test_two_drones_touch_below_0_30_m(distance, touching):
    assert in_contact(pair(distance), jnp.asarray(0.0)).tolist() == [touching, touching, False]
    expected = [PENALTY * touching, PENALTY * touching, 0.0]
    assert penalty(distances(pair(distance))).tolist() == expected


@pytest.mark.parametrize(
    ("z", "t", "touching"),
    [
        (0.0, 0.3, False),
        (-0.001, GRACE, False),
        (0.0, GRACE + 0.02, True),
        (-0.001, 4.0, True),
        (0.001, 4.0, False),
    ],
)
def test_the_floor_counts_after_the_grace_time(z, t, touching):
    pos = pair(1.0).at[0, 2].set(z)
    assert in_contact(pos, jnp.asarray(t)).tolist() == [touching, False, False]


def test_the_floor_is_not_part_of_the_penalty():
    assert not penalty(distances(pair(1.0, z=-0.1))).any()


def test_the_penalty_counts_every_other_drone_in_contact():
    """A row 0.2 m apart: the middle one touches two, its neighbours one each."""
    row = jnp.asarray([[0.0, 0.0, 1.0], [0.2, 0.0, 1.0], [0.4, 0.0, 1.0]])
    assert penalty(distances(row)).tolist() == [PENALTY, 2 * PENALTY, PENALTY]


def test_distances_are_euclidean_and_infinite_to_oneself():
    pos = np.random.default_rng(0).normal(size=(4, 3))
    expected = np.linalg.norm(pos[:, None] - pos[None], axis=-1)
    np.fill_diagonal(expected, np.inf)
    np.testing.assert_allclose(distances(jnp.asarray(pos)), expected, rtol=1e-5)


def test_the_surrogate_has_the_stated_values():
    middle = 0.5 * (INNER + OUTER)
    touching = 0.5 + INNER / contact._MARGIN
    stated = {OUTER + 0.1: 0.0, OUTER: 0.0, middle: 0.125, INNER: 0.5, 0.0: touching}
    for distance, expected in stated.items():
        assert float(soft(distance)) == pytest.approx(PENALTY * expected, abs=1e-5)


@pytest.mark.parametrize(("border", "slope"), [(INNER, -STEEPEST), (OUTER, 0.0)])
def test_the_surrogate_is_once_differentiable_at_its_borders(border, slope):
    """Difference quotients from both sides, by differences of 1 mm."""
    step = 1e-3
    left = (soft(border) - soft(border - step)) / step
    right = (soft(border + step) - soft(border)) / step
    # The quotient of a parabola errs by half of its curvature times the step.
    error = 0.5 * STEEPEST / contact._MARGIN * step
    np.testing.assert_allclose([left, right], slope, atol=1.1 * error + 1e-3)


def test_the_surrogate_falls_with_distance_and_its_slope_is_bounded():
    at = jnp.linspace(0.0, OUTER + 0.2, 81)
    slopes = jax.vmap(jax.grad(soft))(at)
    assert (slopes <= 0).all()
    assert float(jnp.abs(slopes).max()) <= STEEPEST * (1 + 1e-5)
    assert (slopes[at < OUTER - 0.01] < 0).all()


def test_the_surrogate_pushes_drones_apart_even_when_they_coincide():
    """The gradient is finite at zero distance and separates any two that are not exact copies."""
    slope = jax.grad(lambda p: soft_penalty(distances(p)).sum())
    assert jnp.isfinite(slope(pair(0.0))).all()
    pushed = -slope(pair(0.1))
    assert pushed[0, 0] < 0 < pushed[1, 0]
    assert not pushed[2].any()
