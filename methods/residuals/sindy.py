r"""SINDy residual: a sparse linear fit over a physical library, by pysindy's STLSQ.

Library of one drone, with thrust over mass f = a_nominal + [0, 0, g], v velocity, s = |v|:

    1,  f_x, f_y, f_z,  |f|,  sin(roll), sin(pitch),  v_x, v_y, v_z,  s v_x, s v_y, s v_z

that is thrust, attitude projections and linear drag (paper, Sec. V-D, class (ii)); the constant and
quadratic drag are ours.
Position is not in it: no physical effect of free flight depends on it.
"""

import threading
import warnings
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pysindy
from jaxtyping import Array, Float, PRNGKeyArray

from methods.residuals.contract import (
    AbstractResidual,
    AbstractResidualModel,
    Scale,
    Transitions,
    bounded,
    make_scale,
)
from simulators.vehicle import GRAVITY

TERMS = (
    *("1", "f_x", "f_y", "f_z", "|f|", "sin(roll)", "sin(pitch)"),
    *("v_x", "v_y", "v_z", "s v_x", "s v_y", "s v_z"),
)
"""Names of the library's terms."""
_QUIET = threading.Lock()
"""Held while warnings are off: that is a state of the whole process."""


def library(features: Float[Array, "*n 12"]) -> Float[Array, "*n terms"]:
    """The library's terms, in the order of `TERMS`."""
    vel, rpy = features[..., 3:6], features[..., 6:9]
    force = features[..., 9:12] + jnp.asarray([0.0, 0.0, GRAVITY])
    size = jnp.linalg.norm(force, axis=-1, keepdims=True)
    speed = jnp.linalg.norm(vel, axis=-1, keepdims=True)
    tilt = jnp.sin(rpy[..., :2])
    return jnp.concatenate([jnp.ones_like(size), force, size, tilt, vel, speed * vel], axis=-1)


class SindyModel(AbstractResidualModel):
    """correction = bound(library(features) @ coefficients)."""

    scale: Scale
    """Clips the features."""
    coefficients: Float[Array, "terms 3"]
    """Coefficient of each term [m/s^2 per unit of the term]; zero where left out."""

    def __call__(self, features: Float[Array, "drones 12"]) -> Float[Array, "drones 3"]:
        return bounded(library(self.scale.clipped(features)) @ self.coefficients)


class Sindy(AbstractResidual):
    """Source: Brunton et al. (2016), sequentially thresholded least squares, pysindy."""

    threshold: float = eqx.field(static=True, default=0.02)
    """Smallest coefficient kept, terms scaled to unit deviation [m/s^2]."""
    alpha: float = eqx.field(static=True, default=1e-4)
    """Ridge parameter of the least squares."""

    version: ClassVar[str] = "1"

    def fit(
        self,
        transitions: Transitions,
        key: PRNGKeyArray,
        init: AbstractResidualModel | None = None,
    ) -> SindyModel:
        """The sparse fit; it draws nothing and needs no start."""
        scale = make_scale(transitions.features)
        terms = np.asarray(library(scale.clipped(transitions.features)), float)
        # STLSQ thresholds coefficients, so every term is brought to the same size first.
        size = np.where(terms.std(axis=0) > 1e-9, terms.std(axis=0), 1.0)
        root = np.sqrt(np.asarray(transitions.weight, float))[:, None]
        model = pysindy.STLSQ(threshold=self.threshold, alpha=self.alpha)
        with _QUIET, warnings.catch_warnings():
            # A collinear library is ridge-regularised; pysindy warns about each elimination.
            warnings.simplefilter("ignore")
            model.fit(root * terms / size, root * np.asarray(transitions.target, float))
        coefficients = model.coef_.T / size[:, None]
        return SindyModel(scale=scale, coefficients=jnp.asarray(coefficients, float))
