"""Rotations against SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulators.algebra.rotation import body_z, quat_to_rpy, rotate, rotate_back, rpy_to_quat

RPY = np.random.default_rng(0).uniform([-3, -1.5, -3], [3, 1.5, 3], (50, 3))
VECTOR = np.random.default_rng(1).normal(size=(50, 3))
TRUE = Rotation.from_euler("xyz", RPY)


def test_quaternions_of_angles_equal_scipys():
    quat, expected = np.asarray(rpy_to_quat(jnp.asarray(RPY))), TRUE.as_quat()
    np.testing.assert_allclose(
        quat * np.sign(np.sum(quat * expected, -1))[:, None], expected, atol=1e-6
    )


def test_angles_survive_the_way_through_quaternions():
    np.testing.assert_allclose(quat_to_rpy(rpy_to_quat(jnp.asarray(RPY))), RPY, atol=1e-4)


def test_rotations_equal_scipys():
    quat, vector = jnp.asarray(TRUE.as_quat()), jnp.asarray(VECTOR)
    np.testing.assert_allclose(rotate(quat, vector), TRUE.apply(VECTOR), atol=1e-5)
    np.testing.assert_allclose(rotate_back(quat, vector), TRUE.inv().apply(VECTOR), atol=1e-5)
    np.testing.assert_allclose(body_z(quat), TRUE.apply([0.0, 0.0, 1.0]), atol=1e-5)


@pytest.mark.parametrize("angles", [[0.0, 0.0, 0.0], [0.0, np.pi / 2, 0.0]])
def test_derivatives_are_finite_at_level_and_at_the_pole(angles):
    jacobian = jax.jacfwd(lambda x: quat_to_rpy(rpy_to_quat(x)))(jnp.asarray(angles))
    assert jnp.isfinite(jacobian).all()


def test_the_derivative_at_level_is_the_identity():
    jacobian = jax.jacrev(lambda x: quat_to_rpy(rpy_to_quat(x)))(jnp.zeros(3))
    np.testing.assert_allclose(jacobian, np.eye(3), atol=1e-6)
