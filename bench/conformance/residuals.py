"""What a residual must keep to: bounded, deterministic, drone by drone, better than nothing."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bench.conformance.suite import Check, close, declaration_checks, demand, equal, finite
from methods.residuals.contract import (
    BOUND,
    HISTORY,
    AbstractResidual,
    AbstractResidualModel,
    Transitions,
    inputs,
)

KEY = jax.random.key(5)
SIZE = np.array([2, 2, 2, 1.5, 1.5, 1.5, 0.4, 0.4, 0, 6, 6, 6])
"""Half the range of each feature: m, m/s, rad (yaw is always zero), m/s^2."""
PUSH = np.array([0.3, -0.2, 0.5])
"""What the simulator lacks in these data, besides a drag of 0.4 1/s [m/s^2]."""
SAMPLES = 150


def declarations(cls: type[Any]) -> list[Check]:
    """Checks of what the class says of itself; the others need them."""
    return declaration_checks(cls, AbstractResidual)


def behaviour(cls: type[Any]) -> list[Check]:
    """Checks of one fit and its model."""

    @functools.cache
    def fitted() -> AbstractResidualModel:
        return cls().fit(_transitions(), KEY)

    sentences = {
        "`fit` returns a frozen model": _model,
        "the model gives each drone a correction": _shape,
        "the fit is better than no residual": _learns,
        "corrections stay within the bound, whatever the features": _bounded,
        "each drone is corrected by itself": _alone,
        "the same data and key give the same fit": _repeats,
        "a fit can start from an earlier one": _init,
        "heavier rows pull the fit towards them": _weights,
        "compiled equals eager, and it can be differentiated": _compiled,
    }
    return [Check(text, functools.partial(check, cls, fitted)) for text, check in sentences.items()]


def _features(n: int = SAMPLES, seed: int = 0) -> Float[Array, "samples 12"]:
    return jnp.asarray(np.random.default_rng(seed).uniform(-1, 1, (n, 12)) * SIZE, jnp.float32)


def _law(x: Float[Array, "samples 12"]) -> np.ndarray:
    return np.asarray(PUSH - 0.4 * np.asarray(x[:, 3:6]), np.float32)


def _transitions() -> Transitions:
    x = _features()
    return _rows(x, jnp.asarray(_law(x)), jnp.ones(len(x)))


def _rows(x: Array, target: Array, weight: Array) -> Transitions:
    """Rows whose last commands, if anybody looks at them, were idle."""
    return Transitions(x, target, weight, jnp.zeros((len(x), HISTORY, 4)))


def _called(model: AbstractResidualModel, x: Float[Array, "samples 12"]) -> Array:
    """What a model makes of features after idle commands."""
    return model(inputs(model, _rows(x, jnp.zeros((len(x), 3)), jnp.ones(len(x)))))


def _model(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    model = fitted()
    demand(
        isinstance(model, AbstractResidualModel),
        f"`fit` must return an AbstractResidualModel, got {type(model).__name__}",
    )
    demand(
        finite(eqx.filter(model, eqx.is_array)), "the fitted model holds NaN or infinite numbers"
    )


def _shape(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    for n in (1, 3, 12):
        y = np.asarray(_called(fitted(), _features(n)))
        demand(y.shape == (n, 3), f"for {n} drones the model must return ({n}, 3), got {y.shape}")
        demand(np.isfinite(y).all(), "the model returns NaN or infinite corrections")


def _learns(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    x = _features(seed=1)
    left = float(np.mean((np.asarray(_called(fitted(), x)) - _law(x)) ** 2))
    before = float(np.mean(_law(x) ** 2))
    demand(
        left < before,
        f"on fresh samples of a push and a linear drag the squared error is {left:.3f} with the "
        f"residual and {before:.3f} without; the target is what the nominal acceleration lacks",
    )


def _bounded(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    signs = np.sign(np.random.default_rng(2).uniform(-1, 1, (32, 12)))
    for size in (1e2, 1e6, 1e30, np.inf):
        y = np.asarray(_called(fitted(), jnp.asarray(size * signs, jnp.float32)))
        demand(
            np.isfinite(y).all() and (np.abs(y) <= BOUND).all(),
            f"with features of {size:g} a correction is {np.abs(y).max():g} m/s^2, the bound is "
            f"{BOUND:g}; clip the features (`make_scale`) and pass the output through `bounded`",
        )


def _alone(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    x = _features(6, seed=3)
    alone = jnp.concatenate([_called(fitted(), row[None]) for row in x])
    demand(
        close(_called(fitted(), x), alone, 1e-5, 1e-5),
        "a drone's correction depends on other drones",
    )


def _repeats(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    demand(
        equal(fitted(), cls().fit(_transitions(), KEY)),
        "two fits to the same data with the same key differ; take randomness from `key` alone",
    )


def _init(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    x = _features()
    before = np.mean((np.asarray(_called(fitted(), x)) - _law(x)) ** 2)
    model = cls().fit(_transitions(), KEY, init=fitted())
    after = np.mean((np.asarray(_called(model, x)) - _law(x)) ** 2)
    demand(
        after <= 1.05 * before + 1e-3,
        f"starting from the earlier fit (`init`) the error grows from {before:.4g} to {after:.4g}",
    )


def _weights(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    # Few places, each seen at both: what a flexible model remembers of single rows cannot help it.
    places = jnp.tile(_features(5), (SAMPLES // 5, 1))
    sign = np.repeat([1.0, -1.0], SAMPLES // 2)
    target = jnp.asarray(np.repeat(sign[:, None], 3, axis=1), jnp.float32)
    means = []
    for weight in (1.0, 9.0):
        rows = _rows(places, target, jnp.asarray(np.where(sign > 0, weight, 1.0), jnp.float32))
        means.append(float(np.mean(np.asarray(_called(cls().fit(rows, KEY), places)))))
    demand(
        abs(means[0]) < 0.1 and abs(means[1] - 0.8) < 0.1,
        f"rows at +1 m/s^2 with nine times the weight of those at -1 move the mean correction from "
        f"{means[0]:.2f} to {means[1]:.2f}, not from 0 to 0.8; use `transitions.weight`",
    )


def _compiled(cls: type[Any], fitted: functools._lru_cache_wrapper) -> None:
    model, x = fitted(), _features(4, seed=4)
    demand(
        close(eqx.filter_jit(_called)(model, x), _called(model, x)),
        "compiled it gives other numbers than eager",
    )
    slope = eqx.filter_jit(jax.grad(lambda x: jnp.sum(_called(model, x))))(x)
    demand(finite(slope), "the derivative by the features is not finite")
