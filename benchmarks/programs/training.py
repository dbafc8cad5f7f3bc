"""One training epoch, as every benchmark of training times it."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

from methods.training.bptt import BPTT, optimizer, update
from methods.training.policy import Policy
from simulators.contract import AbstractSimulator
from tasks.contract import AbstractTask


def epoch_of(
    trainer: BPTT, task: AbstractTask, simulator: AbstractSimulator, policy: Policy, key: jax.Array
) -> Callable[[], dict[str, Any]]:
    """A function that trains for the same epoch each time, in the memory of the one before.

    It gives the epoch's row. It ran once, so it is compiled, and skipped no update.
    """
    state = optimizer(trainer.clip).init(eqx.filter(policy, eqx.is_inexact_array))
    rule, rates = trainer.rule(task.n_drones), (trainer.learning_rate(0), key)
    kept = trainer.room(policy, task)

    def epoch() -> dict[str, Any]:
        nonlocal kept
        *_, row, kept = update((rule, task, simulator, policy, state, *rates), kept)
        return jax.block_until_ready(row)

    assert not epoch()["skipped"]
    return epoch
