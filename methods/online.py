"""Online: a Hybrid whose residual is fitted again from the team's own first flights.

The Hybrid's policy is deployed; what the whole team flies, contacts and each other's air included,
goes on fitting the residual, and the policy is trained on under it. Both are billed here: those
flights with their crashes, and the calibration of the Hybrid without which there would be nothing
to deploy.
"""

import dataclasses
import time
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from methods.calibration.pool import transitions_of
from methods.calibration.team_flights import fly_team
from methods.contract import AbstractMethod, Setup, Trained
from methods.hybrid import trained_under
from methods.residuals.mlp import MLPEnsemble, MLPModel
from methods.training.bptt import BPTT
from methods.training.meter import billed
from methods.training.policy import AbstractPolicy
from tasks.contact import onsets
from tasks.contract import check_above, check_at_least


class Online(AbstractMethod):
    """Source: Pan et al. (2025), arXiv:2508.21065, whose one drone learns between its flights."""

    flights: int = eqx.field(static=True, default=3)
    """Episodes that the team flies after deployment; a choice."""
    refit_epochs: int = eqx.field(static=True, default=150)
    """Updates of the residual, which is of the class that a Hybrid has by default."""
    refit_lr: float = eqx.field(static=True, default=5e-3)
    """Their learning rate, that of a fit from the start."""
    hover_weight: float = eqx.field(static=True, default=4.0)
    """Extra weight of transitions at rest, in tasks that keep station; Hybrid's."""
    trainer: BPTT = eqx.field(default=BPTT(lr=1e-3, decay=0.99))
    """How the policy is trained on: for as long as a Hybrid, with its optimiser."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("hybrid",)
    simulator: ClassVar[str] = "point_mass"
    resumes_from: ClassVar[tuple[str, ...]] = ("hybrid",)

    def __check_init__(self) -> None:
        check_at_least(self, 1, "flights", "refit_epochs")
        check_above(self, 0, "refit_lr")
        check_at_least(self, 0, "hover_weight")

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        flight_key, fit_key, train_key = jax.random.split(key, 3)
        task, nominal, parent = setup.task, setup.nominal, setup.parents["hybrid"]
        policy = init or parent.policy
        with setup.context.in_turn():
            begin = time.perf_counter()
            setup.context.progress("team flights", 0, 1, float("nan"))
            keys = jax.random.split(flight_key, self.flights)
            reality = billed(setup.reality, self.flights * task.horizon * task.n_drones)
            flown = fly_team(task, nominal, reality, policy, keys)
            setup.context.progress("residual fit", 0, 1, float("nan"))
            weight = self.hover_weight if task.station_keeping else 0.0
            rows = transitions_of(flown, nominal, weight)
            fitted = parent.residual if isinstance(parent.residual, MLPModel) else None
            refit = MLPEnsemble(epochs=self.refit_epochs, lr=self.refit_lr)
            model = jax.block_until_ready(refit.fit(rows, fit_key, fitted))
            seconds = time.perf_counter() - begin
        before = parent.ledger
        bill = dataclasses.replace(
            before,
            hf_fleet_seconds=0.0,
            inherited_fleet_seconds=before.hf_fleet_seconds,
            training_crashes=int(jnp.sum(onsets(flown.contact))),
            training_crash_step_rate=float(jnp.mean(jnp.any(flown.contact, axis=-1))),
            train_seconds=seconds,
        )
        return trained_under(model, setup, self.trainer, policy, train_key, bill)
