r"""Pitchandexpand: follow a sphere around a fixed centre whose radius swings.

With s = 2 pi t / P + s_0, s_0 ~ U(0, 2 pi), x the vector from the centre and rho its length:

    r(t)   = r_N + A sin(s),   u = x / max(rho, CORE)
    offset = r u - x,   v* = dr/dt u,   a* = d2r/dt2 u
    reward = -|offset| + w (exp(-|v - v*|) - 1)

Within `tasks.contract.CORE` of the centre, where a unit vector would jump, distance and velocity
error have a slack (`tasks/contract.py`): the distance is |r - rho| everywhere.

From the paper: a spherical shell around a static origin, sinusoidal radius, the bounded velocity
term. Chosen here: r_N = max(1 m, 0.35 m sqrt(N)) so that the area per drone does not shrink,
A = 0.4 m, P = 4 s, centre at r_N + A + 0.4 m above ground, w = 0.5; spawn on a grid.
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
    direction,
    shortfall,
    spawn_grid,
)


class PitchAndExpand(AbstractTargetTask):
    """Source: paper, Sec. IV-B."""

    n_drones: int = eqx.field(static=True, default=3)
    """Team size."""
    horizon: int = eqx.field(static=True, default=500)
    """Episode length [steps]."""
    n_neighbors: int = eqx.field(static=True, default=3)
    """Observed neighbours."""
    observe_attitude: bool = eqx.field(static=True, default=False)
    """Whether roll and pitch are observed."""
    amplitude: float = eqx.field(static=True, default=0.4)
    """Swing of the radius [m]."""
    period: float = eqx.field(static=True, default=4.0)
    """Period of the swing [s]."""
    clearance: float = eqx.field(static=True, default=0.4)
    """Height of the sphere's lowest point at its largest [m]."""
    vel_weight: float = eqx.field(static=True, default=0.5)
    """Weight of the bounded velocity term."""

    version: ClassVar[str] = "2"
    station_keeping: ClassVar[bool] = False

    def __check_init__(self) -> None:
        check_above(self, 0, "period", "clearance")
        check_at_least(self, 0, "vel_weight")
        if not abs(self.amplitude) < self.radius:
            raise ValueError(
                f"`amplitude` must be below the mean radius {self.radius:g}, got {self.amplitude}."
            )

    @property
    def radius(self) -> float:
        """Mean radius of the sphere [m]."""
        return max(1.0, 0.35 * self.n_drones**0.5)

    def reset(self, key: PRNGKeyArray) -> tuple[Float[Array, "drones 3"], Float[Array, ""]]:
        spawn_key, phase_key = jax.random.split(key)
        phase = jax.random.uniform(phase_key, maxval=2.0 * jnp.pi)
        return spawn_grid(self.n_drones, spawn_key), phase

    def target(self, state: TaskState) -> Target:
        rate = 2.0 * jnp.pi / self.period
        s = rate * CONTROL_DT * state.step + state.goal
        height = self.radius + abs(self.amplitude) + self.clearance
        relative = state.flight.pos - jnp.asarray([0.0, 0.0, height])
        away = direction(relative)
        radius = self.radius + self.amplitude * jnp.sin(s)
        growth = self.amplitude * rate * jnp.cos(s)
        return Target(
            offset=radius * away - relative,
            vel=growth * away,
            acc=-self.amplitude * rate**2 * jnp.sin(s) * away,
            slack=radius * shortfall(relative),
            vel_slack=jnp.abs(growth) * shortfall(relative),
        )

    def task_reward(
        self, distance: Float[Array, " drones"], vel_error: Float[Array, " drones"]
    ) -> Float[Array, " drones"]:
        return -distance + self.vel_weight * (jnp.exp(-vel_error) - 1.0)
