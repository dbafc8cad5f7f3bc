"""HF hot start: the LF baseline, fine-tuned in the high-fidelity simulator."""

from typing import ClassVar

import equinox as eqx
from jaxtyping import PRNGKeyArray

from methods.bptt import BPTT
from methods.contract import AbstractMethod, Setup, Trained
from methods.high_fidelity import train_in_reality
from methods.policy import Policy


class HFHotStart(AbstractMethod):
    """Source: paper, Sec. IV-C: reduced learning rate, 500 epochs at most, patience 100."""

    trainer: BPTT = eqx.field(
        default=BPTT(epochs=500, lr=1e-3, n_worlds=1, patience=100, smoothing=20)
    )
    """How the policy is fine-tuned."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("lf_baseline",)
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup: Setup, key: PRNGKeyArray, init: Policy | None = None) -> Trained:
        policy = init or setup.parents["lf_baseline"].policy
        return train_in_reality(self.trainer, setup, policy, key, "HF fine-tuning")
