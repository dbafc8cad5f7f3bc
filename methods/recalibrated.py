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
    refit: MLPEnsemble = eqx.field(default=MLPEnsemble(epochs=150))
    """How the residual is fitted on; of the class that a Hybrid has by default."""
    trainer: BPTT = eqx.field(default=BPTT(epochs=400, lr=1e-3))
    """How the policy is trained on; the learning rate is the hot start's."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("lf_baseline", "hybrid")
    simulator: ClassVar[str] = "point_mass"

    def train(self, setup: Setup, key: PRNGKeyArray, init: Policy | None = None) -> Trained:
        parent = setup.parents["hybrid"]
        hybrid = Hybrid(flights=self.flights, trainer=self.trainer)
        fitted = parent.residual if isinstance(parent.residual, MLPModel) else None
        return hybrid.adapted(setup, key, init or parent.policy, self.refit, fitted)
