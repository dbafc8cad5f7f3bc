r"""Circle: orbit a vertical axis at a fixed radius, height and tangential speed.

With n the horizontal unit vector away from the axis and t the unit tangent (anticlockwise):

    offset = nearest point of the ring (R, z_0) - p,   v* = v_t t,   a* = -v_t^2 / R n
    reward = -|offset| - w |v* - v|

From the paper: target tangential velocity, fixed radius, specified altitude. Chosen here:
R = max(1 m, spacing 0.8 m), z_0 = 1 m, v_t = 1 m/s, w = 0.5. The task is singular on the axis, so
drones spawn on a ring of radius R, randomly rotated and jittered, in order.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from tasks.contract import (
    SPAWN_JITTER,
    AbstractTargetTask,
    Target,
    TaskState,
    check_above,
    check_at_least,
    direction,
    ring_offset,
    ring_radius,
    shortfall,
)


class Circle(AbstractTargetTask):
    """Source: paper, Sec. IV-B."""

    n_drones: int = eqx.field(static=True, default=3)
    """Team size."""
    horizon: int = eqx.field(static=True, default=500)
    """Episode length [steps]."""
    n_neighbors: int = eqx.field(static=True, default=3)
    """Observed neighbours."""
    observe_attitude: bool = eqx.field(static=True, default=False)
    """Whether roll and pitch are observed."""
    altitude: float = eqx.field(static=True, default=1.0)
    """Height of the orbit [m]."""
    speed: float = eqx.field(static=True, default=1.0)
    """Tangential speed [m/s]."""
    vel_weight: float = eqx.field(static=True, default=0.5)
    """Weight of the velocity error [s]."""

    version: ClassVar[str] = "2"
    station_keeping: ClassVar[bool] = False

    def __check_init__(self) -> None:
        check_above(self, 0, "altitude")
        check_at_least(self, 0, "vel_weight")

    @property
    def radius(self) -> float:
        """Radius of the orbit [m]."""
        return ring_radius(self.n_drones, spacing=0.8, smallest=1.0)

    def reset(self, key: PRNGKeyArray) -> tuple[Float[Array, "drones 3"], None]:
        turn_key, jitter_key = jax.random.split(key)
        turn = jax.random.uniform(turn_key, maxval=2.0 * jnp.pi)
        angle = 2.0 * jnp.pi * jnp.arange(self.n_drones) / self.n_drones + turn
        xy = self.radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
        xy = xy + jax.random.uniform(
            jitter_key, xy.shape, minval=-SPAWN_JITTER, maxval=SPAWN_JITTER
        )
        return jnp.concatenate([xy, jnp.zeros((self.n_drones, 1))], axis=-1), None

    def target(self, state: TaskState) -> Target:
        pos = state.flight.pos
        center = jnp.asarray([0.0, 0.0, self.altitude])
        out = direction(pos[:, :2])
        flat = jnp.zeros_like(out[:, 0])
        tangent = jnp.stack([-out[:, 1], out[:, 0], flat], axis=-1)
        inward = jnp.stack([-out[:, 0], -out[:, 1], flat], axis=-1)
        return Target(
            offset=ring_offset(pos, center, self.radius),
            vel=self.speed * tangent,
            acc=self.speed**2 / self.radius * inward,
            slack=self.radius * shortfall(pos[:, :2]),
            vel_slack=abs(self.speed) * shortfall(pos[:, :2]),
        )

    def task_reward(
        self, distance: Float[Array, " drones"], vel_error: Float[Array, " drones"]
    ) -> Float[Array, " drones"]:
        return -distance - self.vel_weight * vel_error
