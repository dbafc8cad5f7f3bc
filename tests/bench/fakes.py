"""Methods that train in no time, fail, or die: plug-ins for the tests of the harness."""

import dataclasses
import os
import signal
import time
from pathlib import Path
from typing import ClassVar

import equinox as eqx
import jax
import numpy as np

from bench.store import checkpoints
from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.running.high_fidelity import train_in_reality
from methods.training.bptt import BPTT
from methods.training.meter import Metered
from methods.training.policy import make_policy
from simulators.point_mass import PointMass


class Calm(PointMass):
    """A point mass as reality: a process that evaluates in it has next to nothing to compile."""

    name: ClassVar[str] = "calm"


class Inner(eqx.Module):
    """Nested settings."""

    epochs: int = eqx.field(static=True, default=3)
    lr: float = eqx.field(static=True, default=0.5)


class Instant(AbstractMethod):
    """A fresh policy; `log` gets a line for each training."""

    log: str = eqx.field(static=True, default="")
    inner: Inner = Inner()
    wait_for: str = eqx.field(static=True, default="")

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "point_mass"

    def train(self, setup, key, init=None):
        _log(self.log, setup)
        while self.wait_for and not Path(self.wait_for).exists():
            time.sleep(0.05)
        nominal = setup.nominal
        policy = make_policy(setup.task, nominal.spec, nominal.action_space, key)
        return _trained(policy, setup, self.inner.epochs)


class Child(AbstractMethod):
    """The policy of its parent `instant`, as it is."""

    log: str = eqx.field(static=True, default="")

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("instant",)
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup, key, init=None):
        _log(self.log, setup)
        return _trained(setup.parents["instant"].policy, setup, 1)


class Failing(AbstractMethod):
    """Raises, unless the file that the environment names is there."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup, key, init=None):
        if not Path(os.environ["FAKES_CURE"]).exists():
            raise RuntimeError("the propellers fell off")
        nominal = setup.nominal
        policy = make_policy(setup.task, nominal.spec, nominal.action_space, key)
        return _trained(policy, setup, 1)


class Heir(AbstractMethod):
    """Starts from `failing`."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("failing",)
    simulator: ClassVar[str] = "point_mass"

    def train(self, setup, key, init=None):
        return _trained(setup.parents["failing"].policy, setup, 1)


class Dying(AbstractMethod):
    """Kills its own process."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup, key, init=None):
        os.kill(os.getpid(), signal.SIGKILL)


class Flown(AbstractMethod):
    """A real training, billed as high-fidelity flight; its process is killed at epoch `die_at`.

    Only once: the file `grave` remembers it.
    """

    trainer: BPTT = BPTT(epochs=8, n_worlds=1, smoothing=2, patience=6, min_improvement=0.5)
    die_at: int = eqx.field(static=True, default=0)
    grave: str = eqx.field(static=True, default="")

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup, key, init=None):
        checkpoints.EVERY = 0.0

        def progress(stage, epoch, epochs, reward):
            setup.context.progress(stage, epoch, epochs, reward)
            if self.grave:
                with Path(self.grave).open("a") as file:
                    file.write(f"{epoch}\n")
                if epoch == self.die_at and Path(self.grave).read_text().count("\n") == epoch:
                    os.kill(os.getpid(), signal.SIGKILL)

        nominal = setup.nominal
        policy = make_policy(setup.task, nominal.spec, nominal.action_space, key)
        context = dataclasses.replace(setup.context, progress=progress)
        cell = Setup(setup.task, nominal, Metered(nominal, setup.reality.meter), context=context)
        return train_in_reality(self.trainer, cell, policy, key, "flown")


class Ouroboros(AbstractMethod):
    """Its own parent."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ("ouroboros",)
    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup, key, init=None):
        raise AssertionError("cannot be planned")


def _log(path, setup):
    if path:
        with Path(path).open("a") as file:
            file.write(f"n{setup.task.n_drones}\n")


def _trained(policy, setup, epochs):
    setup.context.progress("fake training", 1, epochs, -1.0)
    column = np.zeros(epochs, np.float32)
    return Trained(
        policy=policy,
        ledger=Ledger(epochs=epochs, inherited_fleet_seconds=120.0, train_seconds=0.25),
        curves=dict.fromkeys(("reward", "smooth_reward", "crashes", "grad_norm"), column),
        notes={"leaves": float(len(jax.tree.leaves(eqx.filter(policy, eqx.is_array))))},
    )
