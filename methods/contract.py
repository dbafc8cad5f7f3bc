"""What a training method is: `train(setup, key, init) -> Trained`, evaluated alike for all."""

import abc
import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from methods.training.context import Context
from methods.training.policy import AbstractPolicy
from simulators.contract import AbstractSimulator
from simulators.effects.contract import AbstractEffect
from tasks.contract import AbstractTask


@dataclasses.dataclass(frozen=True)
class Setup:
    """What a method is given."""

    task: AbstractTask
    """Task and team size."""
    nominal: AbstractSimulator
    """The low-fidelity simulator, nominal."""
    reality: AbstractSimulator
    """The high-fidelity simulator, possibly with effects that the nominal one lacks. While a method
    trains, every step of it is billed to the run (`methods/training/meter.py`)."""
    parents: Mapping[str, "Trained"] = dataclasses.field(default_factory=dict)
    """What the methods named in `AbstractMethod.parents` trained, of the same seed."""
    context: Context = dataclasses.field(default_factory=Context)
    """What the harness gives beside the cell: progress, checkpoints, runs trained together."""


@dataclasses.dataclass(frozen=True)
class Ledger:
    """What a training run cost. The reality that the harness hands out bills its own flight."""

    hf_fleet_seconds: float = 0.0
    """Simulated high-fidelity flight, summed over drones [s]. Methods leave it out: it is what
    `setup.reality` counted while the method trained, and `inherited_fleet_seconds`."""
    inherited_fleet_seconds: float = 0.0
    """The part of it that a parent flew and that this run bears in full [s]."""
    calibration_flights: int = 0
    """Single-drone high-fidelity flights that a residual was fitted to."""
    calibration_crashes: int = 0
    """Crashes of those flights."""
    training_crashes: int = 0
    """Crashes while training in the high-fidelity simulator."""
    training_crash_step_rate: float = 0.0
    """Share of high-fidelity training steps with any drone in contact."""
    lf_collisions: int = 0
    """Crashes while training in the low-fidelity simulator; nobody pays for them."""
    epochs: int = 0
    """Policy updates; of `ppo`, rounds of flying and learning."""
    skipped_updates: int = 0
    """Updates left out because their gradient was not finite."""
    train_seconds: float = 0.0
    """Wall time, compilation included [s]; of what several runs do together, this run's share."""


@dataclasses.dataclass(frozen=True)
class Trained:
    """What a method returns."""

    policy: AbstractPolicy
    """The policy at the end of training, the shared one or one of the method's own architecture.

    Evaluation episodes never choose it.
    """
    ledger: Ledger
    """What it cost."""
    curves: Mapping[str, Float[np.ndarray, " epochs"]]
    """Per epoch: `reward` (exact penalty), `smooth_reward`, `crashes`, `grad_norm`."""
    status: str = "ok"
    """`ok`, `diverged`, or `budget` (a high-fidelity run that its epoch budget ended)."""
    residual: eqx.Module | None = None
    """The frozen residual, if the method fits one."""
    effects: tuple[AbstractEffect, ...] = ()
    """Effects that the nominal simulator was corrected by, the residual not among them."""
    notes: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Further numbers worth keeping, e.g. a residual's fit error; name -> value."""


class AbstractMethod(eqx.Module):
    """A way to train a swarm policy. Fields are its settings, their defaults the configuration."""

    version: eqx.AbstractClassVar[str]
    """Declared version; results are reused only while it stays the same."""
    parents: eqx.AbstractClassVar[tuple[str, ...]]
    """Methods whose trained policies this one starts from."""
    simulator: eqx.AbstractClassVar[str]
    """Name of the simulator in which the policy is trained."""

    resumes_from: ClassVar[tuple[str, ...]] = ()
    """Parents whose fitted residual it needs, too, which must be of its class's default shape."""
    identifies: ClassVar[bool] = False
    """Whether it searches all registered effects. Where the source of one changes, stored runs are
    told of; their keys do not hold the versions of effects that a method adds by itself."""
    parent_cells: ClassVar[Mapping[str, tuple[str, int]]] = {}
    """Parents of one fixed cell, name -> (task, team size); the others are of the run's own."""
    parents_fly_reality: ClassVar[bool] = False
    """Whether its parents are trained for the reality of its own row, effects included; otherwise
    they know the plain high-fidelity simulator. True where what is flown is flown by a parent."""

    @abc.abstractmethod
    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        """A trained policy.

        `init` replaces the fresh or parent's policy to start from; it is of the architecture that
        the method trains.
        """
