"""A method's training, its high-fidelity flight billed by the reality that it was given."""

import dataclasses

from jaxtyping import PRNGKeyArray

from methods.contract import AbstractMethod, Setup, Trained
from methods.training.meter import Meter, metered


def train_metered(method: AbstractMethod, setup: Setup, key: PRNGKeyArray) -> Trained:
    """What `method` trains, its high-fidelity flight billed by the reality that it was given.

    The ledger's `hf_fleet_seconds` is what the meter counted and what the run inherits; what the
    method writes there itself is replaced.
    """
    meter = Meter()
    given = dataclasses.replace(setup, reality=metered(setup.reality, meter))
    trained = method.train(given, key)
    if not isinstance(trained, Trained):
        raise TypeError(
            f"`train` of `{type(method).__name__}` must return a Trained, got {trained!r:.80}."
        )
    seconds = meter.fleet_seconds + trained.ledger.inherited_fleet_seconds
    ledger = dataclasses.replace(trained.ledger, hf_fleet_seconds=seconds)
    return dataclasses.replace(trained, ledger=ledger)
