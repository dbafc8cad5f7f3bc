"""Affine residual: five bagged weighted least-squares fits, averaged."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from methods.residuals.contract import (
    AbstractResidual,
    AbstractResidualModel,
    Scale,
    Transitions,
    bounded,
    make_scale,
)


class AffineModel(AbstractResidualModel):
    """correction = mean over members of bound(W z + b), z the standardised features."""

    scale: Scale
    """Standardises the features."""
    weight: Float[Array, "members 13 3"]
    """Per member: a row for each feature, the intercept last."""

    def __call__(self, features: Float[Array, "drones 12"]) -> Float[Array, "drones 3"]:
        z = self.scale(features)
        members = jnp.einsum("df,mfa->mda", z, self.weight[:, :-1]) + self.weight[:, None, -1]
        return jnp.mean(bounded(members), axis=0)


class Affine(AbstractResidual):
    """Source: paper, Sec. V-D, class (i). Fitted in closed form: least squares has one optimum."""

    members: int = eqx.field(static=True, default=5)
    """Size of the bagged ensemble."""
    ridge: float = eqx.field(static=True, default=1e-6)
    """Share of the identity in the normal equations; a constant feature leaves them singular."""

    version: ClassVar[str] = "1"

    def fit(
        self,
        transitions: Transitions,
        key: PRNGKeyArray,
        init: AbstractResidualModel | None = None,
    ) -> AffineModel:
        """The closed form; it needs no start, so `init` does not change it."""
        scale = make_scale(transitions.features)
        z = scale(transitions.features)
        n = len(z)
        design = jnp.concatenate([z, jnp.ones((n, 1))], axis=-1)

        def member(key: PRNGKeyArray) -> Float[Array, "13 3"]:
            drawn = jax.random.randint(key, (n,), 0, n)
            weight = transitions.weight * jnp.bincount(drawn, length=n)
            left = (design * weight[:, None]).T
            gram = left @ design / jnp.sum(weight)
            right = left @ transitions.target / jnp.sum(weight)
            return jnp.linalg.solve(gram + self.ridge * jnp.eye(len(gram)), right)

        weights = jnp.stack([member(k) for k in jax.random.split(key, self.members)])
        return AffineModel(scale=scale, weight=weights)
