"""Recalibrated: a Hybrid whose vehicle has changed, adapted with a few flights of the changed one.

Single-drone flights of the changed vehicle, the residual fitted on from the one there was, the
policy trained on from the one there was. Those flights are billed here; what the Hybrid that it
starts from has flown is that one's. They follow the first references of the Hybrid's own pool with
the same dither, because both draw from the run's seed: two vehicles on the same paths. Without
flights the policy is trained on under the residual as it is: the control that says what the flights
are worth.

With twelve drones on circle 4 of 15 such trainings diverged, and 2 of 5 without flights. The likely
cause: the point mass gives thrust at once, and the loop by which a policy holds its altitude ends
in chatter (`reports/paper.md`, on drones off their specification).
"""

from typing import ClassVar

import equinox as eqx
from jaxtyping import PRNGKeyArray

from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.hybrid import Hybrid, trained_under
from methods.residuals.contract import AbstractResidualModel
from methods.residuals.mlp import MLPEnsemble, MLPModel
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy
from tasks.contract import check_above, check_at_least


class Recalibrated(AbstractMethod):
    """Source: paper, Sec. V-C. It gives no learning rates."""

    flights: int = eqx.field(static=True, default=20)
    """Calibration flights of the changed vehicle; 0: only the policy is trained on."""
    refit_epochs: int = eqx.field(static=True, default=150)
    """Updates of the residual, which is of the class that a Hybrid has by default."""
    refit_lr: float = eqx.field(static=True, default=5e-3)
    """Their learning rate, that of a fit from the start."""
    trainer: BPTT = eqx.field(default=BPTT(lr=1e-3, decay=0.99))
    """How the policy is trained on: for as long as a Hybrid, with its optimiser."""

    version: ClassVar[str] = "2"
    parents: ClassVar[tuple[str, ...]] = ("lf_baseline", "hybrid")
    simulator: ClassVar[str] = "point_mass"
    resumes_from: ClassVar[tuple[str, ...]] = ("hybrid",)

    def __check_init__(self) -> None:
        check_at_least(self, 0, "flights")
        check_at_least(self, 1, "refit_epochs")
        check_above(self, 0, "refit_lr")

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        parent = setup.parents["hybrid"]
        if not self.flights:
            if not isinstance(parent.residual, AbstractResidualModel):
                raise TypeError("The Hybrid that `recalibrated` starts from has no residual.")
            policy = init or parent.policy
            return trained_under(parent.residual, setup, self.trainer, policy, key, Ledger())
        hybrid = Hybrid(flights=self.flights, trainer=self.trainer)
        refit = MLPEnsemble(epochs=self.refit_epochs, lr=self.refit_lr)
        fitted = parent.residual if isinstance(parent.residual, MLPModel) else None
        return hybrid.adapted(setup, key, init or parent.policy, refit, fitted)
