"""Hybrid once: one calibration of one drone serves all teams and tasks, as the paper's title says.

The paper calibrates once per task and team size, although nothing in its residual depends on
either. Here the residual of one Hybrid, three drones on `figure8`, whose paths cover the most
directions and speeds, is frozen for all. Every run bears the cost of that calibration in full.
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
from jaxtyping import PRNGKeyArray

from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.hybrid import trained_under
from methods.residuals.contract import AbstractResidualModel
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy, make_policy


class HybridOnce(AbstractMethod):
    """Source: paper, Sec. III, with one pool instead of one per task and team size."""

    trainer: BPTT = eqx.field(default=BPTT(lr=1e-3, decay=0.99))
    """How the policy is trained."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("hybrid",)
    parent_cells: ClassVar[Mapping[str, tuple[str, int]]] = {"hybrid": ("figure8", 3)}
    parents_fly_reality: ClassVar[bool] = True
    resumes_from: ClassVar[tuple[str, ...]] = ("hybrid",)
    simulator: ClassVar[str] = "point_mass"

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        policy_key, train_key = jax.random.split(key)
        task, nominal, parent = setup.task, setup.nominal, setup.parents["hybrid"]
        if not isinstance(parent.residual, AbstractResidualModel):
            raise TypeError("The Hybrid that `hybrid_once` starts from has no residual.")
        policy = init or make_policy(task, nominal.spec, nominal.action_space, policy_key)
        bill = Ledger(
            inherited_fleet_seconds=parent.ledger.hf_fleet_seconds,
            calibration_flights=parent.ledger.calibration_flights,
            calibration_crashes=parent.ledger.calibration_crashes,
        )
        return trained_under(parent.residual, setup, self.trainer, policy, train_key, bill)
