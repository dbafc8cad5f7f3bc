"""Collision: drones that touch each other, or the floor, push each other away.

Each drone is a ball of `radius` towards others and of `clearance` towards the floor at z = 0. Force
and torque are those of `simulators/algebra/impacts.py`: Hunt and Crossley's normal force and
regularised friction, which drags the balls' surfaces along and so turns the drones.

- A point mass does not turn: the torque is lost there, and friction meets balls that rest again at
  every step, so that less of it acts than between drones that turn.
- The simulators' own floors stay: crazyflow and RotorPy stop a drone at z = 0 dead. A floor that
  pushes needs a clearance above the depth of the impacts, and a start from above it.
- Where the integration step is longer than `LONGEST_STEP`, the contact is followed in parts of it.
  The integrator still moves a drone by whole steps: of an elastic impact at 1 m/s a point mass of
  4 ms steps keeps 99.6 % of the rate, one of 20 ms steps 58 to 89 %, by where it begins.
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.algebra.impacts import LEAST_RESTITUTION, Balls, Surface, damping_of, push
from simulators.algebra.rotation import rotate
from simulators.effects.card import EffectCard, Input, Shown, percent
from simulators.effects.contract import Number, StiffEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import COLLISION_RADIUS, Vehicle


class Collision(StiffEffect):
    """Source: Hunt and Crossley (1975) with the exponent of Hertz; friction after Coulomb."""

    radius: Number = parameter(
        "m", 0.0, 0.3, source=f"paper, Sec. IV-A: {COLLISION_RADIUS:g}; the bound is a guess"
    )
    """Distance of a drone's centre from what others touch of it [m]."""
    clearance: Number = parameter("m", 0.0, 0.1, source="a Crazyflie's legs: 0.02; a guess")
    """Height of a drone's centre above the floor that it touches [m]."""
    stiffness: Number = parameter(
        "N/m^1.5", 200.0, 10000.0, 2000.0, source="a guess: an impact of 1 m/s is 11 mm deep"
    )
    """Force at a depth of 1 m [N/m^1.5]."""
    restitution: Number = parameter("-", LEAST_RESTITUTION, 1.0, 0.5, source="a guess")
    """Share of its speed that an impact of 1 m/s leaves [-]; slower ones keep more."""
    friction: Number = parameter("-", 0.0, 1.0, 0.3, source="a guess")
    """Friction over the normal force [-]."""

    order: ClassVar[int] = 6
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="collision",
        noun="a push between drones that touch",
        physics="Drones that touch each other or the floor push each other away.",
        shown={
            "radius": Shown("radius", 1000.0, "mm"),
            "clearance": Shown("clearance", 1000.0, "mm"),
            "restitution": percent("restitution"),
        },
        inputs=frozenset({Input.NEIGHBOUR}),
        no_candidate="a collision is seen or not; it has no slope to follow",
    )

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        force, torque = push(_balls(flight, vehicle), self.surface(), dt)
        return None, force.T, torque.T

    def surface(self) -> Surface:
        """What the drones are made of."""
        of = [self.radius, self.clearance, self.stiffness, self.restitution, self.friction]
        radius, clearance, stiffness, restitution, friction = map(jnp.asarray, of)
        return Surface(radius, clearance, stiffness, damping_of(restitution), friction)


def _balls(flight: Flight, vehicle: Vehicle) -> Balls:
    """The drones as balls."""
    n, (a, b, c) = len(flight.pos), vehicle.inertia
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])  # it is symmetric
    inverse = adjugate / jnp.dot(a, adjugate[0])
    # Columns of the inverse in the world frame: R J^-1 R', applied to the world's axes.
    unit = jnp.broadcast_to(jnp.eye(3, dtype=flight.pos.dtype), (n, 3, 3))
    axes = rotate(jnp.repeat(flight.quat[:, None], 3, axis=1), unit)
    turned = jnp.einsum("ab,dai,dbj->ijd", inverse, axes, axes)
    return Balls(
        pos=flight.pos.T,
        vel=flight.vel.T,
        ang_vel=rotate(flight.quat, flight.ang_vel).T,
        inverse_mass=jnp.broadcast_to(1.0 / vehicle.mass, (n,)),
        inverse_inertia=turned,
    )
