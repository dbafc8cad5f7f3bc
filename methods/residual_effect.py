"""Puts a frozen residual into the point mass: a wrench effect that nobody differentiates."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Float

from methods.residuals.contract import AbstractResidualModel
from simulators.effects.contract import Parameter, WrenchEffect
from simulators.flight import Flight
from simulators.rotation import body_z, quat_to_rpy
from simulators.vehicle import GRAVITY, Vehicle
from tasks.rollout import RESIDUAL


def features(flight: Flight, mass: float) -> Float[Array, "drones 12"]:
    """A residual's features: the state before the step, attitude and thrust after the lag.

    `mass` [kg] is what the nominal simulator believes.
    """
    acc = flight.thrust[:, None] / mass * body_z(flight.quat)
    acc = acc - jnp.asarray([0.0, 0.0, GRAVITY])
    return jnp.concatenate([flight.pos, flight.vel, quat_to_rpy(flight.quat), acc], axis=-1)


class ResidualEffect(WrenchEffect):
    """Adds the residual's acceleration at every step, as a stop-gradient constant.

    The gradient of the policy flows only through the nominal dynamics (paper, Sec. III-B, stage
    4). The output is named, so that a checkpointed rollout keeps it instead of computing the
    ensemble twice.
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

    def init(self, n_drones: int, dt: float) -> None:
        return None

    def wrench(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        acc = self.model(jax.lax.stop_gradient(features(flight, self.mass)))
        acc = checkpoint_name(jax.lax.stop_gradient(acc), RESIDUAL)
        return None, self.mass * acc, jnp.zeros_like(acc)
