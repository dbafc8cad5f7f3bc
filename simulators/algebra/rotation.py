"""Extrinsic xyz Euler angles (roll, pitch, yaw) and scalar-last quaternions, body to world.

Written out instead of taken from ``jax.scipy.spatial.transform`` because these run in the inner
loop of every rollout and must be differentiable at level attitude.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def rpy_to_quat(rpy: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    """Quaternion (scalar last) of roll, pitch, yaw [rad]."""
    cr, cp, cy = jnp.moveaxis(jnp.cos(0.5 * rpy), -1, 0)
    sr, sp, sy = jnp.moveaxis(jnp.sin(0.5 * rpy), -1, 0)
    return jnp.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=-1,
    )


def quat_to_rpy(quat: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Roll, pitch, yaw [rad] of a unit quaternion (scalar last), pitch within +-89.9 degrees."""
    x, y, z, w = jnp.moveaxis(quat, -1, 0)
    roll = jnp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    # arcsin's slope is infinite at 1, which rounding alone can reach.
    pitch = jnp.arcsin(jnp.clip(2 * (w * y - z * x), -0.9999985, 0.9999985))
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.stack([roll, pitch, yaw], axis=-1)


def body_z(quat: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """The body's z axis in the world frame, along which the thrust acts."""
    x, y, z, w = jnp.moveaxis(quat, -1, 0)
    return jnp.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)


def along(axis: Float[Array, "*n 3"], vector: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """The part of `vector` along the unit vector `axis`."""
    return jnp.sum(axis * vector, axis=-1, keepdims=True) * axis


def rotate(quat: Float[Array, "*n 4"], vector: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """`vector` turned from the body frame into the world frame."""
    axis, w = quat[..., :3], quat[..., 3:]
    t = 2.0 * jnp.cross(axis, vector)
    return vector + w * t + jnp.cross(axis, t)


def rotate_back(quat: Float[Array, "*n 4"], vector: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """`vector` turned from the world frame into the body frame."""
    return rotate(quat * jnp.asarray([-1.0, -1.0, -1.0, 1.0]), vector)
