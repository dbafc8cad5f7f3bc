"""History residual: the MLP's ensemble, which also sees the last five commands: 32-128-128-3.

A point mass has no rotors and no attitude loop of its own. What they hide from the twelve features
of the paper (rotor speeds, angular velocities) follows from the commands before; if Hybrid's gap
comes from them, this residual closes part of it.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from methods.residuals.contract import (
    AbstractHistoryModel,
    AbstractResidual,
    AbstractResidualModel,
    Scale,
    Transitions,
)
from methods.residuals.mlp import fit_ensemble, members_of


class HistoryModel(AbstractHistoryModel):
    """correction = mean over members of bound(net(z)), z the standardised features and commands."""

    scale: Scale
    """Standardises the features and commands."""
    nets: eqx.nn.MLP
    """The members, stacked along a leading axis."""

    def __call__(self, features: Float[Array, "drones features"]) -> Float[Array, "drones 3"]:
        return jnp.mean(members_of(self.nets, self.scale(features)), axis=0)


class History(AbstractResidual):
    """A choice, no source; settings as the MLP's, so that only the features differ."""

    members: int = eqx.field(static=True, default=5)
    """Size of the bagged ensemble."""
    width: int = eqx.field(static=True, default=128)
    """Width of both hidden layers."""
    epochs: int = eqx.field(static=True, default=300)
    """Full-batch updates."""
    lr: float = eqx.field(static=True, default=5e-3)
    """Adam's learning rate at the start, falling to zero as a cosine."""
    max_samples: int = eqx.field(static=True, default=5000)
    """Largest bootstrap resample of one member [rows]."""

    version: ClassVar[str] = "1"

    def fit(
        self,
        transitions: Transitions,
        key: PRNGKeyArray,
        init: AbstractResidualModel | None = None,
    ) -> HistoryModel:
        fitted = (init.scale, init.nets) if isinstance(init, HistoryModel) else None
        return HistoryModel(*fit_ensemble(self, transitions.recalled(), transitions, key, fitted))
