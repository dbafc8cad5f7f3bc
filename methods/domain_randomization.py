"""Domain randomization: trained in a point mass whose unknowns are drawn anew in every episode.

No high-fidelity flight at all. What `grey_box` identifies from three flights is drawn here from
what is published of small quadrotors, before anybody has flown this one:

    attitude lag     0.05 to 0.15 s     guess around the attitude loops of Crazyflies: natural
                                        frequencies of 12.5 to 22 rad/s, damping 0.65 to 0.75
    thrust lag       0.03 to 0.15 s     motors: 0.057/0.062 s (cf21B), 0.072 s (Eschmann et al.,
                                        arXiv 2404.07837), 0.136/0.106 s (cf2x L250)
    delay            0 to 0.06 s        published range of command delays
    drag             0 to 0.6 1/s       real logs 0.33 to 0.44, data sheets none
    thrust gain      -0.14 to 0.03      a fleet of one airframe: 0.86 to 1.03 of nominal

It is the control that says what identification adds. Source: randomized dynamics, Peng et al.
(2018), arXiv 1710.06537.
"""

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax
from jaxtyping import PRNGKeyArray

from methods.contract import AbstractMethod, Setup, Trained
from methods.running.low_fidelity import check_step, train_in_point_mass
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy, make_policy
from methods.training.varied import vary
from simulators.contract import AbstractSimulator, with_effects
from simulators.effects.delay import Delay
from simulators.effects.drag import Drag
from simulators.effects.thrust_gain import ThrustGain
from simulators.effects.thrust_lag import ThrustLag

RANGES = {
    "attitude_tau": (0.05, 0.15),
    "thrust_lag": (0.03, 0.15),
    "delay": (0.0, 0.06),
    "drag": (0.0, 0.6),
    "thrust_gain": (-0.14, 0.03),
}
"""Smallest and largest value of each [s, s, s, 1/s, -]; sources stand at the top of the module."""


class DomainRandomization(AbstractMethod):
    """Source: Peng et al. (2018), arXiv 1710.06537; ranges as at the top of this module."""

    dt: float = eqx.field(static=True, default=0.01)
    """Integration step of the point mass [s], that of `grey_box`."""
    trainer: BPTT = eqx.field(default=BPTT(decay=0.99))
    """How the policy is trained."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "point_mass"

    def __check_init__(self) -> None:
        check_step(self.dt)

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        policy_key, train_key = jax.random.split(key)
        nominal = dataclasses.replace(setup.nominal, dt=self.dt)
        policy = init or make_policy(setup.task, nominal.spec, nominal.action_space, policy_key)
        return train_in_point_mass(
            self.trainer, setup, randomized(nominal), policy, train_key, "randomized training"
        )


def randomized(nominal: AbstractSimulator) -> AbstractSimulator:
    """The nominal point mass, its attitude lag and the effects of `RANGES` drawn at every reset."""
    thrust_lag = ThrustLag(up=RANGES["thrust_lag"][0], down=RANGES["thrust_lag"][0])
    effects = [thrust_lag, Delay(seconds=0.0), Drag(c=0.0), ThrustGain(e=0.0)]
    order = ("attitude_tau", "thrust_lag", "thrust_lag", "delay", "drag", "thrust_gain")
    return vary(with_effects(nominal, effects), _numbers, [RANGES[name] for name in order])


def _numbers(simulator: Any) -> list[Any]:
    """What is drawn, in the order of `randomized`."""
    found = {type(effect): effect for effect in simulator.effects}
    lag = found[ThrustLag]
    others = (found[Delay].seconds, found[Drag].c, found[ThrustGain].e)
    return [simulator.attitude_tau, lag.up, lag.down, *others]
