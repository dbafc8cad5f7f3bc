"""Upper reference: what a score of 1 means. Hot start with four times the epochs; no competitor.

Its settled reward, of one seed a cell, is the upper end of the cell's scores
(`bench/stats/scores.py`).
"""

from typing import ClassVar

import equinox as eqx
from jaxtyping import PRNGKeyArray

from methods.contract import AbstractMethod, Setup, Trained
from methods.hf_hotstart import HFHotStart
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy


class UpperReference(AbstractMethod):
    """Source: this project. The best policy that this trainer finds where it will be deployed."""

    trainer: BPTT = eqx.field(default=BPTT(epochs=2000, n_worlds=1, decay=1.0))
    """How the policy is fine-tuned: as in a hot start, with four times the epochs."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("lf_baseline",)
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        return HFHotStart(self.trainer).train(setup, key, init)
