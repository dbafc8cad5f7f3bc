"""Outcomes of runs that nobody trained, and disks that fail: for the tests of the store."""

import abc
import errno
import functools
import os
import signal

import jax
import numpy as np
import pandas as pd
from hypothesis import HealthCheck, settings

from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite
from bench.store.disk import Disk
from bench.store.record import Outcome
from bench.store.tables import table
from methods.contract import Ledger, Trained
from methods.training.policy import make_policy
from simulators.point_mass import PointMass
from tasks.spread import Spread

MACHINE = settings(
    max_examples=20,
    stateful_step_count=15,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
"""How many ways through a machine of states are tried, always the same ones."""


def plan(seeds=2):
    """A suite of `instant` in one cell."""
    return expand(Suite("test", "", ("spread",), (2,), seeds, (Row("instant"),)))


@functools.cache
def make_template(seed=0, n_neighbors=3):
    simulator = PointMass()
    task = Spread(n_drones=2, n_neighbors=n_neighbors)
    return make_policy(task, simulator.spec, simulator.action_space, jax.random.key(seed))


def outcome(run, reward=-3.0, policy=None, minutes=1.5):
    """A run that ended on its budget."""
    column = np.asarray([-5.0, -4.0], np.float32)
    names = ("reward", "smooth_reward", "crashes", "grad_norm")
    trained = Trained(
        policy=make_template(seed=1) if policy is None else policy,
        ledger=Ledger(hf_fleet_seconds=60.0 * minutes, epochs=2, calibration_flights=7),
        curves=dict.fromkeys(names, column),
        status="budget",
        notes={"fit": 0.5, "unknown": float("nan")},
    )
    return Outcome(
        status="budget",
        trained=trained,
        metrics={
            "settled_reward": reward,
            "reward": reward,
            "training_reward": -4.5,
            "fleet_minutes": minutes,
            "lf_reward": float("nan"),
        },
        curves=table("curves", pd.DataFrame({"run": run.name, "epoch": [0, 1]} | trained.curves)),
        trajectory=table(
            "trajectories",
            [{"run": run.name, "drone": 0, "t": 0.1, "pos_x": 1.0, "pos_y": 2.0, "pos_z": 3.0}],
        ),
    )


class CountedDisk(Disk, abc.ABC):
    """Calls `at_point` before and after every change, and in the middle of every file."""

    def make_folder(self, path):
        self.at_point(path)
        super().make_folder(path)
        self.at_point(path)

    def write(self, path, content):
        self.at_point(path)
        path.write_bytes(content[: len(content) // 2])
        self.at_point(path)
        super().write(path, content)
        self.at_point(path)

    def flush_folder(self, path):
        self.at_point(path)
        super().flush_folder(path)

    def move(self, old, new):
        self.at_point(old)
        super().move(old, new)
        self.at_point(new)

    def remove(self, path):
        self.at_point(path)
        super().remove(path)
        self.at_point(path)

    @abc.abstractmethod
    def at_point(self, path):
        """Called before and after everything that touches the store."""


class MortalDisk(CountedDisk):
    """Nothing more happens once `left` points are passed: `end` is called at each that follows."""

    def __init__(self, left):
        self.left = left

    def at_point(self, path):
        self.left -= 1
        if self.left < 0:
            self.end()

    def end(self):
        os.kill(os.getpid(), signal.SIGKILL)


class FailingDisk(CountedDisk):
    """Every change that `where` is true of fails as the system would have it."""

    def __init__(self, code=errno.ENOSPC, where=lambda path: True):
        self.code = code
        self.where = where

    def at_point(self, path):
        if self.where(path):
            raise OSError(self.code, os.strerror(self.code), str(path))
