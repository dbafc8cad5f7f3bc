r"""Spread: each drone takes its own landmark on a randomly rotated formation circle.

    landmark_i = [R cos(2 pi i / N + phi), R sin(2 pi i / N + phi), z_0],  phi ~ U(0, 2 pi)
    v* = a*    = 0
    reward_i   = -d_i + w (1/N) sum_j (exp(-d_j^2 / (2 s^2)) - 1),  d = distance to the landmark

From the paper: unique landmarks, random rotation per episode, reward for proximity and for full
formation coverage as a team. Chosen here: R = max(1 m, spacing 0.8 m), z_0 = 1 m, w = 0.5,
s = 0.3 m; spawn on a grid.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from tasks.contract import (
    AbstractTargetTask,
    Target,
    TaskState,
    check_above,
    check_at_least,
    ring_radius,
    spawn_grid,
)


class Spread(AbstractTargetTask):
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
    """Height of the formation [m]."""
    coverage_weight: float = eqx.field(static=True, default=0.5)
    """Weight of the team's coverage term."""
    coverage_width: float = eqx.field(static=True, default=0.3)
    """Distance at which a landmark counts as 61 % covered [m]."""

    version: ClassVar[str] = "1"
    station_keeping: ClassVar[bool] = True

    def __check_init__(self) -> None:
        check_above(self, 0, "altitude", "coverage_width")
        check_at_least(self, 0, "coverage_weight")

    @property
    def radius(self) -> float:
        """Radius of the formation circle [m]."""
        return ring_radius(self.n_drones, spacing=0.8, smallest=1.0)

    def reset(self, key: PRNGKeyArray) -> tuple[Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        spawn_key, turn_key = jax.random.split(key)
        turn = jax.random.uniform(turn_key, maxval=2.0 * jnp.pi)
        angle = 2.0 * jnp.pi * jnp.arange(self.n_drones) / self.n_drones + turn
        xy = self.radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
        landmarks = jnp.concatenate([xy, jnp.full((self.n_drones, 1), self.altitude)], axis=-1)
        return spawn_grid(self.n_drones, spawn_key), landmarks

    def target(self, state: TaskState) -> Target:
        pos = state.flight.pos
        rest = jnp.zeros_like(pos)
        return Target(offset=state.goal - pos, vel=rest, acc=rest)

    def task_reward(
        self, distance: Float[Array, " drones"], vel_error: Float[Array, " drones"]
    ) -> Float[Array, " drones"]:
        covered = jnp.exp(-0.5 * (distance / self.coverage_width) ** 2)
        return -distance + self.coverage_weight * (jnp.mean(covered) - 1.0)
