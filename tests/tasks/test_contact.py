"""Contact, the exact penalty and its differentiable surrogate."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tasks import contact
from tasks.contact import (
    GRACE,
    PENALTY,
    in_contact,
    nearest,
    penalty,
    soft_penalty,
    surrogate,
)
from tasks.contract import spawn_grid

INNER, OUTER = contact.CONTACT_DISTANCE, contact.CONTACT_DISTANCE + contact._MARGIN
"""Where the surrogate turns from a line into a parabola, and where it ends [m]."""
STEEPEST = PENALTY / contact._MARGIN
"""Largest slope of the surrogate [1/m]."""


def pair(distance, z=1.0):
    return jnp.asarray([[0.0, 0.0, z], [distance, 0.0, z], [9.0, 9.0, z]])


def soft(distance):
    """The surrogate of one drone with one neighbour at a distance."""
    return surrogate(jnp.asarray(distance))


@pytest.mark.parametrize(("distance", "touching"), [(0.05, True), (0.299, True), (0.301, False)])
def test_two_drones_touch_below_0_30_m(distance, touching):
    assert in_contact(pair(distance), jnp.asarray(0.0)).tolist() == [touching, touching, False]
    expected = [PENALTY * touching, PENALTY * touching, 0.0]
    assert penalty(pair(distance)).tolist() == expected


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
    assert not penalty(pair(1.0, z=-0.1)).any()


def test_the_penalty_counts_every_other_drone_in_contact():
    """A row 0.2 m apart: the middle one touches two, its neighbours one each."""
    row = jnp.asarray([[0.0, 0.0, 1.0], [0.2, 0.0, 1.0], [0.4, 0.0, 1.0]])
    assert penalty(row).tolist() == [PENALTY, 2 * PENALTY, PENALTY]


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
    slope = jax.grad(lambda p: soft_penalty(p).sum())
    assert jnp.isfinite(slope(pair(0.0))).all()
    pushed = -slope(pair(0.1))
    assert pushed[0, 0] < 0 < pushed[1, 0]
    assert not pushed[2].any()


# All teams below `MANY` run the same lines.
@pytest.mark.parametrize(
    "n",
    [
        3,
        contact.MANY,
        *(pytest.param(n, marks=pytest.mark.exhaustive) for n in (2, 12, contact.MANY - 1)),
    ],
)
@pytest.mark.parametrize(("wide", "tolerance"), [(False, 1e-4), (True, 1e-10)])
def test_the_push_is_the_derivative_of_all_pairs(n, wide, tolerance):
    """Two worlds of drones within reach of each other, against automatic differentiation."""
    with jax.enable_x64(wide):
        _push_of_all_pairs(n, tolerance)


def _push_of_all_pairs(n, tolerance):
    pos = 0.15 * jax.random.normal(jax.random.key(n), (2, n, 3))
    weight = jnp.cos(jnp.arange(n))
    others = ~jnp.eye(n, dtype=bool)

    def paired(pos):
        return jnp.sum(
            jnp.where(others, surrogate(contact._length(contact._squared(pos))), 0.0), axis=-1
        )

    found, expected = (
        jax.jit(jax.vmap(jax.grad(lambda p, f=f: jnp.sum(weight * f(p)))))(pos)
        for f in (soft_penalty, paired)
    )
    assert float(jnp.abs(expected).max()) > 0.5
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)


FORMATIONS = ("grid", "ring", "between", "heap")


def formation(n, kind, key=0):
    """A large team: on its spawn grid, on a ring, between both, or in a heap."""
    keys = jax.random.split(jax.random.key(key), 2)
    grid = spawn_grid(n, keys[0])
    angle = 2.0 * jnp.pi * jnp.arange(n) / n
    ring = 0.05 * n * jnp.stack([jnp.cos(angle), jnp.sin(angle), 0.0 * angle], axis=-1)
    shaken = 0.1 * jax.random.normal(keys[1], (n, 3))
    places = {"grid": grid, "ring": ring, "between": 0.5 * (grid + ring), "heap": 0.0 * grid}
    return places[kind] + shaken * (4.0 if kind == "heap" else 1.0)


@pytest.mark.parametrize("n", [contact.MANY, pytest.param(150, marks=pytest.mark.exhaustive)])
def test_sweeps_find_what_all_pairs_show(monkeypatch, n):
    """In every formation, two teams each."""
    places = [formation(n, kind, key) for kind in FORMATIONS for key in (0, 1)]
    pos, t = jnp.stack(places), jnp.zeros(())

    def seen(pos):
        weight = jnp.cos(jnp.arange(n))
        slope = jax.grad(lambda p: jnp.sum(weight * soft_penalty(p)))(pos)
        return nearest(pos, 3), in_contact(pos, t), penalty(pos), soft_penalty(pos), slope

    swept = jax.jit(jax.vmap(seen))(pos)
    monkeypatch.setattr(contact, "MANY", n + 1)
    paired = jax.jit(jax.vmap(lambda pos: seen(pos)))(pos)
    for one, other in zip(swept[:3], paired[:3], strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(swept[3:], paired[3:], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)
    assert (np.abs(swept[4]).reshape(len(FORMATIONS), -1).max(axis=1) > 0.0).all()


def test_a_sweep_looks_as_far_as_it_must():
    """One drone far from all others, and coinciding ones."""
    pos = formation(contact.MANY, "ring").at[0].set(jnp.asarray([500.0, 0.0, 0.0]))
    pos = pos.at[2].set(pos[1])
    apart = np.linalg.norm(np.asarray(pos)[:, None] - np.asarray(pos)[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    found = np.take_along_axis(apart, np.asarray(nearest(pos, 3)), axis=1)
    np.testing.assert_allclose(found, np.sort(apart, axis=1)[:, :3], rtol=1e-5)
    assert penalty(pos)[1:3].tolist() == [PENALTY, PENALTY]
    assert jnp.isfinite(jax.grad(lambda p: soft_penalty(p).sum())(pos)).all()
