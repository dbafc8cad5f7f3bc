"""Sweeps without worker processes and without training: for tests that take seconds."""

import math

from outcomes import make_template, outcome

from bench.execution import sweep
from bench.execution.executor import AbstractExecutor, Ended
from bench.execution.worker import Done
from bench.store.record import Outcome
from bench.store.store import Store


class AtOnce(AbstractExecutor):
    """Does what it is given in this process, one task after the other.

    Before task number `most` it raises KeyboardInterrupt, as Ctrl-C would.
    """

    slots = 1

    def __init__(self, do, most=math.inf):
        self.do, self.left, self.ended = do, most, []

    def start(self, slot, task):
        if self.left <= 0:
            raise KeyboardInterrupt
        self.left -= 1
        self.ended.append(self.do(slot, task))

    def _poll(self, left):
        ended, self.ended = self.ended, []
        return ended

    def stop(self):
        pass


class Trainer:
    """What workers are in these tests: the same program leaves the same outcome of a run.

    A child is trained only where the folders of all its parents are in place.
    """

    def __init__(self):
        self.policy = make_template(seed=1)
        self.trained = []
        """Names of the runs that were done, in order."""
        self.shift = {}
        """Method -> what its rewards are off by, as on another machine."""
        self.failing = set()
        """Methods whose runs fail by themselves."""
        self.dying = set()
        """Methods whose worker dies."""
        self.most = math.inf
        """Runs after which Ctrl-C is pressed."""

    def executor(self, *_):
        """In the place of `make_executor`."""
        return AtOnce(self.do, self.most)

    def do(self, slot, task):
        (run,), directory = task.args
        store = Store(directory)
        for parent in run.parents.values():
            assert store.status(parent) == "budget"
        self.trained.append(run.name)
        if run.method in self.dying:
            return Ended(slot, error="its worker process was ended by SIGKILL")
        status, cause = "budget", ""
        if run.method in self.failing:
            status, cause = "failed", "the propellers fell off"
            store.commit(run, Outcome(status, cause=cause))
        else:
            store.commit(run, outcome(run, self.reward(run), self.policy))
        return Ended(slot, [Done(status, cause)])

    def reward(self, run):
        """The reward of a run, by its key."""
        return -1.0 - int(run.key[:3], 16) / 7.0 + self.shift.get(run.method, 0.0)


def do_really(monkeypatch):
    """Sweeps do what workers do, but in this process."""

    def do(slot, task):
        return Ended(slot, task(lambda *_: None))

    monkeypatch.setattr(sweep, "make_executor", lambda *_: AtOnce(do))


def install(monkeypatch, documents=True):
    """A trainer that all sweeps of a test use; `documents`: whether they write any."""
    trainer = Trainer()
    monkeypatch.setattr(sweep, "make_executor", trainer.executor)
    if not documents:
        monkeypatch.setattr(sweep, "rebuild_report", lambda *_: None)
        monkeypatch.setattr(sweep, "rebuild_leaderboard", lambda *_: None)
    return trainer
