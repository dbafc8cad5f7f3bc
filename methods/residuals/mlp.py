"""MLP residual: five bagged networks 12-128-128-3, averaged; the paper's default."""

import functools
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from methods.residuals.contract import (
    AbstractResidual,
    AbstractResidualModel,
    Scale,
    Transitions,
    bounded,
    make_scale,
)


class MLPModel(AbstractResidualModel):
    """correction = mean over members of bound(net(z)), z the standardised features."""

    scale: Scale
    """Standardises the features."""
    nets: eqx.nn.MLP
    """The members, stacked along a leading axis."""

    def __call__(self, features: Float[Array, "drones 12"]) -> Float[Array, "drones 3"]:
        return jnp.mean(members_of(self.nets, self.scale(features)), axis=0)


def members_of(
    nets: eqx.nn.MLP, z: Float[Array, "samples features"]
) -> Float[Array, "members samples 3"]:
    """Output [m/s^2] of each member of an ensemble for standardised features."""
    return eqx.filter_vmap(lambda net: bounded(jax.vmap(net)(z)))(nets)


class MLPEnsemble(AbstractResidual):
    """Source: paper, Sec. III-A; Pan et al. (2026) for the bagged ensemble of accelerations."""

    members: int = eqx.field(static=True, default=5)
    """Size of the bagged ensemble."""
    width: int = eqx.field(static=True, default=128)
    """Width of both hidden layers."""
    epochs: int = eqx.field(static=True, default=300)
    """Full-batch updates."""
    lr: float = eqx.field(static=True, default=5e-3)
    """Adam's learning rate at the start, falling to zero as a cosine."""
    max_samples: int = eqx.field(static=True, default=5000)
    """Largest bootstrap resample of one member [rows]; a choice that bounds the fit's time."""

    version: ClassVar[str] = "1"

    def fit(
        self,
        transitions: Transitions,
        key: PRNGKeyArray,
        init: AbstractResidualModel | None = None,
    ) -> MLPModel:
        fitted = (init.scale, init.nets) if isinstance(init, MLPModel) else None
        return MLPModel(*fit_ensemble(self, transitions.features, transitions, key, fitted))


def fit_ensemble(
    settings: Any,
    features: Float[Array, "samples features"],
    transitions: Transitions,
    key: PRNGKeyArray,
    fitted: tuple[Scale, eqx.nn.MLP] | None,
) -> tuple[Scale, eqx.nn.MLP]:
    """Scale and members, fitted to resamples of the rows; the fit goes on from `fitted`.

    `settings` has the fields of an `MLPEnsemble`.
    """
    draw_key, net_key = jax.random.split(key)
    n = len(features)
    shape = (settings.members, min(n, settings.max_samples))
    drawn = jax.random.randint(draw_key, shape, 0, n)
    if fitted is None:
        size, width = features.shape[1], settings.width
        make = lambda key: eqx.nn.MLP(size, 3, width, 2, activation=jnp.tanh, key=key)  # noqa: E731
        nets = eqx.filter_vmap(make)(jax.random.split(net_key, settings.members))
        fitted = make_scale(features), nets
    scale, nets = fitted
    rows = scale(features)[drawn], transitions.target[drawn], transitions.weight[drawn]
    return scale, fit_nets(nets, *rows, settings.lr, settings.epochs)


@functools.cache
def _optimizer(lr: float, epochs: int) -> optax.GradientTransformation:
    return optax.adam(optax.cosine_decay_schedule(lr, epochs))


@eqx.filter_jit
def fit_nets(
    nets: eqx.nn.MLP,
    z: Float[Array, "members samples features"],
    target: Float[Array, "members samples 3"],
    weight: Float[Array, "members samples"],
    lr: float,
    epochs: int,
) -> eqx.nn.MLP:
    """The ensemble after so many full-batch updates, each member on rows of its own."""
    optimizer = _optimizer(lr, epochs)
    params, static = eqx.partition(nets, eqx.is_inexact_array)

    def loss(params: eqx.nn.MLP) -> Float[Array, ""]:
        nets = eqx.combine(params, static)
        predicted = eqx.filter_vmap(lambda net, z: bounded(jax.vmap(net)(z)))(nets, z)
        squared = jnp.sum((predicted - target) ** 2, axis=-1)
        # Summed over members, which are independent; averaged over samples.
        return jnp.sum(jnp.mean(weight * squared, axis=-1) / jnp.mean(weight, axis=-1))

    def update(carry: tuple, _: None) -> tuple[tuple, None]:
        params, state = carry
        updates, state = optimizer.update(jax.grad(loss)(params), state)
        return (optax.apply_updates(params, updates), state), None

    start = (params, optimizer.init(params))
    (params, _), _ = jax.lax.scan(update, start, None, length=epochs)
    return eqx.combine(params, static)
