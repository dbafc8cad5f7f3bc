"""LF baseline: trained in the nominal point mass, deployed as it is."""

from typing import ClassVar

import equinox as eqx
import jax
from jaxtyping import PRNGKeyArray

from methods.contract import AbstractMethod, Setup, Trained
from methods.running.low_fidelity import train_in_point_mass
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy, make_policy


class LFBaseline(AbstractMethod):
    """No residual, no high-fidelity flight. Source: paper, Sec. IV-C."""

    trainer: BPTT = eqx.field(default=BPTT())
    """How the policy is trained."""

    version: ClassVar[str] = "2"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "point_mass"

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        policy_key, train_key = jax.random.split(key)
        simulator = setup.nominal
        policy = init or make_policy(setup.task, simulator.spec, simulator.action_space, policy_key)
        return train_in_point_mass(self.trainer, setup, simulator, policy, train_key, "LF training")
