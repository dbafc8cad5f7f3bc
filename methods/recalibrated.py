"""Recalibrated: a Hybrid whose vehicle has changed, adapted with a few flights of the changed one.

Single-drone flights of the changed vehicle, the residual fitted on from the one there was, the
policy trained on from the one there was. Those flights are billed here; what the Hybrid that it
starts from has flown is that one's.
"""

from typing import ClassVar

import equinox as eqx
from jaxtyping import PRNGKeyArray

from methods.bptt import BPTT
from methods.contract import AbstractMethod, Setup, Trained
from methods.hybrid import Hybrid
from methods.policy import Policy
from methods.residuals.mlp import MLPEnsemble, MLPModel


class Recalibrated(AbstractMethod):
    """Source: paper, Sec. V-C. It gives no learning rates; both here are choices."""

    flights: int = eqx.field(static=True, default=20)
    """Calibration flights of the changed vehicle."""
    refit_epochs: int = eqx.field(static=True, default=150)
    """Updates of the residual, which is of the class that a Hybrid has by default."""
    refit_lr: float = eqx.field(static=True, default=5e-3)
    """Their learning rate, that of a fit from the start."""
    trainer: BPTT = eqx.field(default=BPTT(epochs=400, lr=1e-3))
    """How the policy is trained on; the learning rate is the hot start's."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("lf_baseline", "hybrid")
    simulator: ClassVar[str] = "point_mass"
    goes_on_from: ClassVar[tuple[str, ...]] = ("hybrid",)

    def __check_init__(self) -> None:
        for name in ("flights", "refit_epochs"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be at least 1, got {getattr(self, name)}.")
        if not self.refit_lr > 0.0:
            raise ValueError(f"`refit_lr` must be above 0, got {self.refit_lr}.")

    def train(self, setup: Setup, key: PRNGKeyArray, init: Policy | None = None) -> Trained:
        parent = setup.parents["hybrid"]
        hybrid = Hybrid(flights=self.flights, trainer=self.trainer)
        refit = MLPEnsemble(epochs=self.refit_epochs, lr=self.refit_lr)
        fitted = parent.residual if isinstance(parent.residual, MLPModel) else None
        return hybrid.adapted(setup, key, init or parent.policy, refit, fitted)
