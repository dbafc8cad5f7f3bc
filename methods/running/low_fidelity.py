"""What the configurations that train in the point mass share: BPTT in it, and the bill."""

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

from jaxtyping import PRNGKeyArray

from methods.contract import Ledger, Setup, Trained
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy
from simulators.contract import AbstractSimulator

NOTHING = Ledger()
"""The bill of a configuration that flies nothing before it trains."""


def train_in_point_mass(
    trainer: BPTT,
    setup: Setup,
    simulator: AbstractSimulator,
    policy: AbstractPolicy,
    key: PRNGKeyArray,
    stage: str,
    bill: Ledger = NOTHING,
    notes: Mapping[str, float] = MappingProxyType({}),
) -> Trained:
    """`policy` trained in `simulator`, the nominal point mass or a corrected one.

    `bill` is what came before (calibration flights, time), `notes` what is known of it.
    """
    training = trainer.train(setup.task, simulator, policy, key, setup.context, stage)
    return Trained(
        policy=training.policy,
        ledger=dataclasses.replace(
            bill,
            lf_collisions=training.crashes,
            epochs=training.epochs,
            skipped_updates=training.skipped,
            train_seconds=bill.train_seconds + training.seconds,
        ),
        curves=training.curves,
        status="diverged" if training.diverged else "ok",
        notes={"training_reward": training.final_reward, **notes},
    )
