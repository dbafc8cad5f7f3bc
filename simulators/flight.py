"""The flight record: what can be measured of a team at one instant."""

import equinox as eqx
from jaxtyping import Array, Float


class Flight(eqx.Module):
    """One world now, all drones; world frame unless stated otherwise."""

    t: Float[Array, ""]
    """Time since the reset [s]."""
    pos: Float[Array, "drones 3"]
    """Position [m], z up."""
    vel: Float[Array, "drones 3"]
    """Velocity [m/s]."""
    quat: Float[Array, "drones 4"]
    """Attitude, body to world, scalar last."""
    ang_vel: Float[Array, "drones 3"]
    """Angular velocity, body frame [rad/s]; zero in a simulator without rotation."""
    thrust: Float[Array, " drones"]
    """Collective thrust as produced, not as commanded [N]."""
    torque: Float[Array, "drones 3"]
    """Torque by which the rotors' thrusts differ, about their centre, body frame [N m]; zero in a
    simulator without rotation."""
