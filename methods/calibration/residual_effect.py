"""Puts a frozen residual into the point mass: a wrench effect that nobody differentiates."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from methods.residuals.contract import AbstractResidualModel
from simulators.algebra.rotation import body_z, quat_to_rpy
from simulators.effects.contract import FrozenEffect, Parameter
from simulators.flight import Flight
from simulators.vehicle import GRAVITY, Vehicle


def features(flight: Flight, mass: float) -> Float[Array, "drones 12"]:
    """A residual's features: the state before the step, attitude and thrust after the lag.

    `mass` [kg] is what the nominal simulator believes.
    """
    acc = flight.thrust[:, None] / mass * body_z(flight.quat)
    acc = acc - jnp.asarray([0.0, 0.0, GRAVITY])
    return jnp.concatenate([flight.pos, flight.vel, quat_to_rpy(flight.quat), acc], axis=-1)


class ResidualEffect(FrozenEffect):
    """Adds the residual's acceleration at every step, as a stop-gradient constant.

    The gradient of the policy flows only through the nominal dynamics (paper, Sec. III-B, stage
    4). The last acceleration is remembered, so that a backward pass need not compute it again.
    """

    model: AbstractResidualModel
    """The frozen residual."""
    mass: float = eqx.field(static=True)
    """Mass that the nominal simulator believes [kg]."""

    parameters: ClassVar[dict[str, Parameter]] = {}
    door: ClassVar[str] = "wrench"
    needs: ClassVar[tuple[str, ...]] = ()
    order: ClassVar[int] = 100
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> Float[Array, "drones 3"]:
        return jnp.zeros((n_drones, 3))

    def wrench(
        self, memory: Float[Array, "drones 3"], flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[Float[Array, "drones 3"], Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        acc = self.model(jax.lax.stop_gradient(features(flight, self.mass)))
        acc = jax.lax.stop_gradient(acc)
        return acc, vehicle.mass * acc, jnp.zeros_like(acc)

    def repeated(self, memory: Float[Array, "drones 3"]) -> "ResidualEffect":
        return ResidualEffect(_Known(jax.lax.stop_gradient(memory)), self.mass)


class _Known(AbstractResidualModel):
    """A residual whose accelerations were computed before."""

    acc: Float[Array, "drones 3"]
    """The accelerations [m/s^2, world]."""

    def __call__(self, features: Float[Array, "drones 12"]) -> Float[Array, "drones 3"]:
        return self.acc
