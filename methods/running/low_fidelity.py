"""What the configurations that train in the point mass share: BPTT in it, and the bill."""

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

from jaxtyping import PRNGKeyArray

from methods.contract import Ledger, Setup, Trained
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy
from simulators.contract import AbstractSimulator
from simulators.vehicle import CONTROL_DT

NOTHING = Ledger()
"""The bill of a configuration that flies nothing before it trains."""


def check_step(dt: float) -> None:
    """Raises a ValueError unless a control step is a whole number of integration steps of `dt` [s].

    Else the point mass would be trained in with another step than the one asked for.
    """
    steps = CONTROL_DT / dt if dt > 0.0 else 0.0
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
        raise ValueError(f"`dt` must divide the control step of {CONTROL_DT} s, got {dt}.")


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
