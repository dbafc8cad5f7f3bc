r"""A zero-training PD controller that tracks a position trajectory.

Paper, Sec. II-D, with target position, velocity and acceleration p*, v*, a*:

    T = a* + k_p (p* - p) + k_d (v* - v) + [0, 0, g]
    phi_cmd = -arcsin(T_y / |T|),  theta_cmd = atan2(T_x, T_z),  T_cmd = m |T|
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from simulators.flight import Flight
from simulators.vehicle import GRAVITY, VEHICLES, ActionSpace

# Tilt beyond this is never asked for, so that arcsin keeps a finite slope.
_LARGEST_SINE = 0.999


class PDTracker(eqx.Module):
    """Source: Mellinger and Kumar (2011) as used in the paper, Sec. II-D."""

    kp: float = 6.0
    """Position gain [1/s^2]; untuned, mean error 0.05 to 0.13 m on the pilot's LF references."""
    kd: float = 4.0
    """Velocity gain [1/s]."""
    mass: float = VEHICLES["cf21B_500"].mass
    """The mass that the controller believes [kg]."""
    action_space: ActionSpace = ActionSpace()
    """How the command becomes an action."""

    def cmd(
        self,
        flight: Flight,
        pos: Float[Array, "drones 3"],
        vel: Float[Array, "drones 3"],
        acc: Float[Array, "drones 3"],
    ) -> Float[Array, "drones 4"]:
        """Roll, pitch, yaw [rad] and thrust [N] towards a target, world frame, SI units."""
        wanted = acc + self.kp * (pos - flight.pos) + self.kd * (vel - flight.vel)
        wanted = wanted + jnp.asarray([0.0, 0.0, GRAVITY])
        norm = jnp.sqrt(jnp.sum(wanted**2, axis=-1) + 1e-12)
        roll = -jnp.arcsin(jnp.clip(wanted[:, 1] / norm, -_LARGEST_SINE, _LARGEST_SINE))
        pitch = jnp.arctan2(wanted[:, 0], wanted[:, 2])
        return jnp.stack([roll, pitch, jnp.zeros_like(roll), self.mass * norm], axis=-1)

    def action(
        self,
        flight: Flight,
        pos: Float[Array, "drones 3"],
        vel: Float[Array, "drones 3"],
        acc: Float[Array, "drones 3"],
    ) -> tuple[Float[Array, "drones 3"], Bool[Array, " drones"]]:
        """The action within [-1, 1], and for which drones it had to be clipped."""
        action = self.action_space.to_action(self.cmd(flight, pos, vel, acc))
        clipped = jnp.any(jnp.abs(action) > 1.0, axis=-1)
        return jnp.clip(action, -1.0, 1.0), clipped
