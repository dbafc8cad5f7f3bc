"""HF hot start: the LF baseline, fine-tuned in the high-fidelity simulator."""

from typing import ClassVar

import equinox as eqx
from jaxtyping import PRNGKeyArray

from methods.contract import AbstractMethod, Setup, Trained
from methods.running.high_fidelity import train_in_reality
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy


class HFHotStart(AbstractMethod):
    """Source: paper, Sec. IV-C, with 500 epochs.

    The paper ends it early by a patience of 100 epochs, and reduces the learning rate; here the
    whole budget is flown, at the rate that trials chose (`reports/tuning.md`).
    """

    trainer: BPTT = eqx.field(default=BPTT(epochs=500, n_worlds=1, decay=1.0))
    """How the policy is fine-tuned."""

    version: ClassVar[str] = "2"
    parents: ClassVar[tuple[str, ...]] = ("lf_baseline",)
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        policy = init or setup.parents["lf_baseline"].policy
        return train_in_reality(self.trainer, setup, policy, key, "HF fine-tuning")
