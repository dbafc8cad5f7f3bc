"""One training epoch, as every benchmark of training times it."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

from methods.adjoint import buffers
from methods.bptt import BPTT, optimizer, update
from methods.policy import Policy
from simulators.contract import AbstractSimulator
from tasks.contract import AbstractTask


def epoch_of(
    trainer: BPTT, task: AbstractTask, simulator: AbstractSimulator, policy: Policy, key: jax.Array
) -> Callable[[], dict[str, Any]]:
    """A function that trains for the same epoch each time, in the memory of the one before.

    It gives the epoch's row. It ran once, so it is compiled, and skipped no update.
    """
    state = optimizer(trainer).init(eqx.filter(policy, eqx.is_inexact_array))
    kept = buffers(policy, task, trainer.worlds(task.n_drones))

    def epoch() -> dict[str, Any]:
        nonlocal kept
        *_, row, kept = update((trainer, task, simulator, policy, state, key), kept)
        return jax.block_until_ready(row)

    assert not epoch()["skipped"]
    return epoch
