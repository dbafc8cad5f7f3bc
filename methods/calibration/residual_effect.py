"""Puts a frozen residual into the point mass: a wrench effect that nobody differentiates.

A residual that wants the last commands is told them: the memory of its effect keeps them.
"""

import math
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from methods.residuals.contract import HISTORY, AbstractHistoryModel, AbstractResidualModel
from simulators.algebra.rotation import body_z, quat_to_rpy
from simulators.effects.contract import FrozenEffect, ListeningEffect, Parameter
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, GRAVITY, Vehicle


def features(flight: Flight, mass: float) -> Float[Array, "drones 12"]:
    """A residual's features: the state before the step, attitude and thrust after the lag.

    `mass` [kg] is what the nominal simulator believes.
    """
    acc = flight.thrust[:, None] / mass * body_z(flight.quat)
    acc = acc - jnp.asarray([0.0, 0.0, GRAVITY])
    return jnp.concatenate([flight.pos, flight.vel, quat_to_rpy(flight.quat), acc], axis=-1)


class Recalled(NamedTuple):
    """Memory of a residual's effect."""

    acc: Float[Array, "drones 3"]
    """The last acceleration [m/s^2, world]."""
    past: Float[Array, "steps drones 4"]
    """Commands, one an integration step, oldest first; none if the residual wants none."""


class ResidualEffect(FrozenEffect, ListeningEffect):
    """Adds the residual's acceleration at every step, as a stop-gradient constant.

    The gradient of the policy flows only through the nominal dynamics (paper, Sec. III-B, stage
    4). The last acceleration is remembered, so that a backward pass need not compute it again.
    """

    model: AbstractResidualModel
    """The frozen residual."""
    mass: float = eqx.field(static=True)
    """Mass that the nominal simulator believes [kg]."""

    parameters: ClassVar[dict[str, Parameter]] = {}
    order: ClassVar[int] = 100
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> Recalled:
        # As many as the simulators take.
        steps = HISTORY * math.ceil(CONTROL_DT / dt - 1e-9) if self._recalls else 0
        return Recalled(jnp.zeros((n_drones, 3)), jnp.zeros((steps, n_drones, 4)))

    @property
    def _recalls(self) -> bool:
        return isinstance(self.model, AbstractHistoryModel)

    def hear(self, memory: Recalled, cmd: Float[Array, "drones 4"], dt: float) -> Recalled:
        if not len(memory.past):
            return memory
        past = jnp.concatenate([memory.past[1:], jax.lax.stop_gradient(cmd)[None]])
        return memory._replace(past=past)

    def wrench(
        self, memory: Recalled, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[Recalled, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        seen = features(flight, self.mass)
        if self._recalls:
            every = len(memory.past) // HISTORY
            last = memory.past[every - 1 :: every]
            seen = jnp.concatenate([seen, jnp.moveaxis(last, 0, 1).reshape(len(seen), -1)], axis=-1)
        acc = jax.lax.stop_gradient(self.model(jax.lax.stop_gradient(seen)))
        return memory._replace(acc=acc), vehicle.mass * acc, jnp.zeros_like(acc)

    def repeated(self, memory: Recalled) -> "ResidualEffect":
        return ResidualEffect(_Known(jax.lax.stop_gradient(memory.acc)), self.mass)


class _Known(AbstractResidualModel):
    """A residual whose accelerations were computed before."""

    acc: Float[Array, "drones 3"]
    """The accelerations [m/s^2, world]."""

    def __call__(self, features: Float[Array, "drones 12"]) -> Float[Array, "drones 3"]:
        return self.acc
