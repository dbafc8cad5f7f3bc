"""HF scratch: trained in the high-fidelity simulator from random weights."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
from jaxtyping import PRNGKeyArray

from methods.contract import AbstractMethod, Setup, Trained
from methods.running.high_fidelity import train_in_reality
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy, make_policy
from tasks.contract import check_at_least


class HFScratch(AbstractMethod):
    """Accurate but expensive. Source: paper, Sec. IV-C.

    The number of epochs is linear in the team size, `epochs_base + epochs_per_drone N`: the line
    through the paper's 1400 epochs at N = 12 and about 1900 at N = 18. All are flown.
    """

    trainer: BPTT = eqx.field(default=BPTT(epochs=10**6, n_worlds=1, decay=1.0))
    """How the policy is trained; its `epochs` limits the budget, by default to nothing."""
    epochs_base: int = eqx.field(static=True, default=400)
    """Budget at N = 0 [epochs]."""
    epochs_per_drone: float = eqx.field(static=True, default=83.3)
    """Growth of the budget [epochs per drone]."""

    version: ClassVar[str] = "2"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "crazyflow"

    def __check_init__(self) -> None:
        check_at_least(self, 1, "epochs_base")
        check_at_least(self, 0, "epochs_per_drone")

    def budget(self, n_drones: int) -> int:
        """Number of epochs for a team."""
        budget = round(self.epochs_base + self.epochs_per_drone * n_drones)
        return min(budget, self.trainer.epochs)

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        policy_key, train_key = jax.random.split(key)
        reality = setup.reality
        policy = init or make_policy(setup.task, reality.spec, reality.action_space, policy_key)
        trainer = dataclasses.replace(self.trainer, epochs=self.budget(setup.task.n_drones))
        return train_in_reality(trainer, setup, policy, train_key, "HF training")
