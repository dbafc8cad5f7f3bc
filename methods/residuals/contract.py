r"""What a residual is: fitted once to calibration transitions, frozen, bounded.

Features of one drone, in this order (paper, Sec. III-A):

    position (3) [m], velocity (3) [m/s], roll, pitch, yaw [rad], nominal acceleration (3) [m/s^2]

Target: (v' - v) / dt - a_nominal [m/s^2], which added to the nominal step reproduces the observed
next velocity exactly. Every output passes 35 tanh(y / 35), the paper's bound; every feature is
standardised and clipped to +-5 standard deviations in fit and use, because a policy in training
leaves the calibration data.

A model below `AbstractHistoryModel` is given more: after these twelve the last `HISTORY` commands,
oldest first and that of the step itself last, each roll, pitch, yaw [rad] and thrust [N]; zeros
stand for commands from before the reset.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

BOUND = 35.0
"""Largest correction along each axis [m/s^2]; paper, Sec. III-A."""
CLIP = 5.0
"""Largest standardised feature [standard deviations]."""
HISTORY = 5
"""Commands that an `AbstractHistoryModel` sees, one a control step."""


class Transitions(eqx.Module):
    """Calibration data, one row a control step of one drone."""

    features: Float[Array, "samples 12"]
    """Features, see the top of this module."""
    target: Float[Array, "samples 3"]
    """Acceleration that the nominal simulator lacks, world frame [m/s^2]."""
    weight: Float[Array, " samples"]
    """Weight of each row in the loss [-]."""
    history: Float[Array, "samples steps 4"] | None = None
    """The last `HISTORY` commands of each row, see the top of this module; None: not recorded."""

    def recalled(self) -> Float[Array, "samples features"]:
        """Features followed by the last commands.

        Raises:
            ValueError: The commands were not recorded.
        """
        if self.history is None or self.history.shape[1] != HISTORY:
            got = None if self.history is None else self.history.shape
            raise ValueError(
                f"`history` must hold the last {HISTORY} commands of each row, got {got}; "
                "`command_history` makes it of a flight's commands."
            )
        return jnp.concatenate([self.features, self.history.reshape(len(self.history), -1)], axis=1)


def command_history(cmd: Float[Array, "time 4"]) -> Float[Array, "time steps 4"]:
    """The last `HISTORY` commands at each step of a flight that starts with a reset."""
    padded = jnp.concatenate([jnp.zeros((HISTORY - 1, 4), cmd.dtype), cmd])
    return jnp.stack([padded[i : i + len(cmd)] for i in range(HISTORY)], axis=1)


class Scale(eqx.Module):
    """Standardises features."""

    mean: Float[Array, " features"]
    """Mean of each feature."""
    std: Float[Array, " features"]
    """Standard deviation of each feature, never zero."""

    def __call__(self, features: Float[Array, "*n features"]) -> Float[Array, "*n features"]:
        """Standardised and clipped features [-]."""
        return jnp.clip((features - self.mean) / self.std, -CLIP, CLIP)

    def clipped(self, features: Float[Array, "*n features"]) -> Float[Array, "*n features"]:
        """Features clipped, in their own units."""
        return self(features) * self.std + self.mean


def make_scale(features: Float[Array, "samples features"]) -> Scale:
    """The scale of a data set; a constant feature (yaw) is left as it is."""
    std = jnp.std(features, axis=0)
    return Scale(jnp.mean(features, axis=0), jnp.where(std > 1e-6, std, 1.0))


def bounded(acceleration: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """`acceleration` [m/s^2], smoothly limited to +-`BOUND`."""
    return BOUND * jnp.tanh(acceleration / BOUND)


class AbstractResidualModel(eqx.Module):
    """A fitted, frozen residual."""

    @abc.abstractmethod
    def __call__(self, features: Float[Array, "drones features"]) -> Float[Array, "drones 3"]:
        """Correction of each drone's acceleration, world frame [m/s^2], within `BOUND`."""


class AbstractHistoryModel(AbstractResidualModel):
    """A residual whose features go on with the last `HISTORY` commands."""


def inputs(
    model: AbstractResidualModel, transitions: Transitions
) -> Float[Array, "samples features"]:
    """Inputs of `model` on these rows."""
    if isinstance(model, AbstractHistoryModel):
        return transitions.recalled()
    return transitions.features


class AbstractResidual(eqx.Module):
    """A class of residual. Fields are the settings of its fit."""

    version: eqx.AbstractClassVar[str]
    """Declared version; results are reused only while it stays the same."""

    @abc.abstractmethod
    def fit(
        self,
        transitions: Transitions,
        key: PRNGKeyArray,
        init: AbstractResidualModel | None = None,
    ) -> AbstractResidualModel:
        """The model that fits the transitions; `init` starts from an earlier fit of its class."""


def blank(residual: AbstractResidual) -> AbstractResidualModel:
    """A model of that class with arrays of the right shapes and meaningless numbers."""
    feature_key, target_key, fit_key = jax.random.split(jax.random.key(0), 3)
    cmd_key = jax.random.fold_in(feature_key, 1)
    rows = Transitions(
        features=jax.random.normal(feature_key, (64, 12)),
        target=jax.random.normal(target_key, (64, 3)),
        weight=jnp.ones(64),
        history=jax.random.normal(cmd_key, (64, HISTORY, 4)),
    )
    return residual.fit(rows, fit_key)
