"""The gradient that a rollout passes back, against the adjoint of a linear flight by hand."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from cells import CLIMB, climb_gradient, lift

from simulators.point_mass import PointMass
from tasks.rollout import COTANGENT_LIMIT, episode

KEY = jax.random.key(0)


def gradient(task, decay, limit=None):
    def total(controller):
        return episode(task, PointMass(), controller, KEY, decay, limit).smooth_reward

    return np.asarray(eqx.filter_jit(eqx.filter_grad(total))(lift(task, 0.1)).actions)


@pytest.mark.parametrize("decay", [0.5, 0.9, 1.0])
def test_decay_scales_the_gradient_through_k_steps_by_its_kth_power(decay):
    found = gradient(CLIMB, decay)[:, :, 2]
    expected = climb_gradient(CLIMB, decay)
    np.testing.assert_allclose(found, np.stack([expected] * 2, axis=-1), rtol=1e-4)
    # Per step of delay: all but the last action, whose effect is felt at once, are scaled.
    assert (found[:-1, 0] < climb_gradient(CLIMB, 1.0)[:-1]).all() == (decay < 1.0)


def test_the_cotangent_of_the_carried_state_is_clipped():
    task = dataclasses.replace(CLIMB, weight=100.0, horizon=40)
    found = gradient(task, 0.99)[:, 0, 2]
    np.testing.assert_allclose(found, climb_gradient(task, 0.99, COTANGENT_LIMIT), rtol=1e-4)
    assert (found[:20] < 0.6 * climb_gradient(task, 0.99)[:20]).all()
    # The direct effect on the next reward, plus the bounded rest, on height and velocity.
    push = climb_gradient(dataclasses.replace(task, horizon=1), 1.0)[0] / task.weight
    assert found.max() <= push * (task.weight + COTANGENT_LIMIT) + push / 0.02 * COTANGENT_LIMIT


@pytest.mark.parametrize(("decay", "limit"), [(1.0, 50.0), (0.99, 50.0), (0.99, 1e9)])
def test_a_limit_that_is_given_holds_with_and_without_decay(decay, limit):
    task = dataclasses.replace(CLIMB, weight=100.0, horizon=40)
    found = gradient(task, decay, limit)[:, 0, 2]
    np.testing.assert_allclose(found, climb_gradient(task, decay, limit), rtol=1e-4)


def test_plain_back_propagation_is_not_clipped():
    task = dataclasses.replace(CLIMB, weight=1e4)
    np.testing.assert_allclose(gradient(task, 1.0)[:, 0, 2], climb_gradient(task, 1.0), rtol=1e-4)
