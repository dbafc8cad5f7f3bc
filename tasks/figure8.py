r"""Figure8: the whole team accompanies one target that moves along a lemniscate.

With phase s = 2 pi t / P + s_0, s_0 ~ U(0, 2 pi):

    q(t)   = [A sin(s), (A / 2) sin(2 s), z_0]                           (Gerono's lemniscate)
    offset = nearest point of the horizontal ring of radius r_N around q - p
    v*     = dq/dt,   a* = d2q/dt2
    reward = -|offset| - w |v* - v|

From the paper: one moving target for all, a lemniscate, collisions kept off by the penalty. N
drones cannot be at one point, and the paper's reward hardly depends on N; so the team is asked to
be on a ring around the target that has room for it: r_N = max(0.5 m, spacing 0.8 m). Which place
on the ring is nobody's. Chosen too: A = 1.5 m, P = 8 s, z_0 = 1 m, w = 0.5; spawn on a grid.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simulators.vehicle import CONTROL_DT
from tasks.contract import (
    AbstractTargetTask,
    Target,
    TaskState,
    check_above,
    check_at_least,
    ring_offset,
    ring_radius,
    shortfall,
    spawn_grid,
)


class Figure8(AbstractTargetTask):
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
    """Height of the target [m]."""
    amplitude: float = eqx.field(static=True, default=1.5)
    """Half the length of the lemniscate [m]."""
    period: float = eqx.field(static=True, default=8.0)
    """Time of one lap [s]."""
    vel_weight: float = eqx.field(static=True, default=0.5)
    """Weight of the velocity error [s]."""

    version: ClassVar[str] = "2"
    station_keeping: ClassVar[bool] = False

    def __check_init__(self) -> None:
        check_above(self, 0, "altitude", "period")
        check_at_least(self, 0, "vel_weight")

    @property
    def radius(self) -> float:
        """Radius of the ring around the target [m]."""
        return ring_radius(self.n_drones, spacing=0.8, smallest=0.5)

    def reset(self, key: PRNGKeyArray) -> tuple[Float[Array, "drones 3"], Float[Array, ""]]:
        spawn_key, phase_key = jax.random.split(key)
        phase = jax.random.uniform(phase_key, maxval=2.0 * jnp.pi)
        return spawn_grid(self.n_drones, spawn_key), phase

    def target(self, state: TaskState) -> Target:
        rate = 2.0 * jnp.pi / self.period
        s = rate * CONTROL_DT * state.step + state.goal
        a = self.amplitude
        center = jnp.stack([a * jnp.sin(s), 0.5 * a * jnp.sin(2.0 * s), s * 0 + self.altitude])
        vel = rate * a * jnp.stack([jnp.cos(s), jnp.cos(2.0 * s), s * 0])
        acc = -(rate**2) * a * jnp.stack([jnp.sin(s), 2.0 * jnp.sin(2.0 * s), s * 0])
        pos = state.flight.pos
        return Target(
            offset=ring_offset(pos, center, self.radius),
            vel=jnp.broadcast_to(vel, pos.shape),
            acc=jnp.broadcast_to(acc, pos.shape),
            slack=self.radius * shortfall((pos - center)[:, :2]),
        )

    def task_reward(
        self, distance: Float[Array, " drones"], vel_error: Float[Array, " drones"]
    ) -> Float[Array, " drones"]:
        return -distance - self.vel_weight * vel_error
