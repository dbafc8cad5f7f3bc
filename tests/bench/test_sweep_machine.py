"""Sweeps under any sequence of filters, interruptions, lost folders and new programs: no row goes.

A row of a finished run never disappears or changes unless `--replace` was given and the new run is
there; the rows are those of all runs that finished.
"""

import csv
import io
import math
import shutil
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import at_once
import fakes
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    rule,
    run_state_machine_as_test,
)
from outcomes import MACHINE
from pandera.config import config_context

import bench.plan.expansion
from bench.execution.sweep import recorded_tables, sweep
from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite
from bench.store.store import Store
from bench.store.tables import IDENTITY, SCHEMAS
from bench.text.errors import UsageError

METHODS = ("instant", "child", "failing")
VERSIONED = {"instant": fakes.Instant, "child": fakes.Child, "failing": fakes.Failing}
FILTERS = st.sampled_from([["child"], ["instant"], ["failing"], ["instant", "child"], METHODS])
SEEDS = st.integers(1, 2)


class Rows(NamedTuple):
    """The rows of a run as text, by table."""

    run: str
    results: str
    curves: str
    trajectories: str
    runs: str

    @property
    def reward(self):
        rows = csv.DictReader(io.StringIO(self.results))
        return next(float(row["value"]) for row in rows if row["metric"] == "reward")


class SweepMachine(RuleBasedStateMachine):
    """`rows` is what the tables hold of finished runs, by identity; `seen` counts what happened."""

    def __init__(self, trainer, sources):
        super().__init__()
        self.trainer, self.sources = trainer, sources
        self.rows, self.seen = {}, Counter()

    @initialize(methods=FILTERS, seeds=SEEDS)
    def begin(self, methods, seeds):
        """A table of a part."""
        self.folder = tempfile.TemporaryDirectory()
        self.out = Path(self.folder.name)
        self.store = Store(self.out)
        self.sources.clear()
        for kind in VERSIONED.values():
            kind.version = "1"
        self.sweep(methods, seeds)

    def plan(self, methods, seeds):
        rows = tuple(Row(method) for method in METHODS if method in methods)
        return expand(Suite("test", "", ("spread",), (2,), seeds, rows))

    def recorded(self):
        """Rows of finished runs as they are in the tables, by identity."""
        tables = recorded_tables(self.out)
        statuses, found = tables.column("status"), {}
        assert len(tables.identities()) == len(tables.runs)
        frames = [getattr(tables, name) for name in SCHEMAS]
        assert not any(frame.duplicated().any() for frame in frames)
        parts = [dict(iter(frame.groupby("run"))) for frame in frames]
        for identity, run in tables.identities().items():
            if statuses[run] != "failed":
                own = [
                    part.get(run, frame.iloc[:0]) for part, frame in zip(parts, frames, strict=True)
                ]
                found[identity] = Rows(run, *(frame.to_csv(index=False) for frame in own))
        return found

    def finished(self):
        """Identity of each run whose folder is sound and finished, by name."""
        contents = [self.store.read(name) for name in self.store.names() if self.sound(name)]
        return {c["run"]: tuple(c[column] for column in IDENTITY) for c in contents}

    def sound(self, name):
        return self.store.status(name) not in ("", "failed")

    def of_others(self, plan):
        """Identities of rows that other programs made: under another key, and under the same."""
        programs = recorded_tables(self.out).runs.set_index("run")["program"]
        there = [(run, self.rows[run.identity]) for run in plan.runs if run.identity in self.rows]
        other_key = {run.identity for run, row in there if row.run != run.name}
        same_key = {run.identity for run, row in there if programs[row.run] != run.program}
        return other_key, same_key - other_key

    @rule(methods=FILTERS, seeds=SEEDS, replace=st.booleans())
    def run(self, methods, seeds, replace):
        self.sweep(methods, seeds, replace=replace)

    @rule(
        methods=FILTERS,
        seeds=SEEDS,
        replace=st.booleans(),
        retry_failed=st.booleans(),
        fail_fast=st.booleans(),
        failing=st.sampled_from(["", "failing", "instant"]),
        dying=st.sampled_from(["", "instant", "child"]),
    )
    def run_in_trouble(self, methods, seeds, failing, dying, **options):
        self.trainer.failing, self.trainer.dying = {failing}, {dying}
        self.sweep(methods, seeds, **options)
        self.trainer.failing, self.trainer.dying = set(), set()

    @rule(methods=FILTERS, seeds=SEEDS, replace=st.booleans(), most=st.integers(0, 2))
    def run_interrupted(self, methods, seeds, replace, most):
        """By Ctrl-C after `most` runs."""
        self.trainer.most = most
        self.sweep(methods, seeds, replace=replace)
        self.trainer.most = math.inf

    @rule(methods=FILTERS, seeds=SEEDS, shift=st.sampled_from([0.0, -9.0]))
    def run_elsewhere(self, methods, seeds, shift):
        """In a clone; with a `shift` lost parents do not come out there as their rows say."""
        self.clone()
        self.trainer.shift = {"instant": shift}
        self.sweep(methods, seeds)
        self.trainer.shift = {}

    def sweep(self, methods, seeds, replace=False, **options):
        plan = self.plan(methods, seeds)
        stored, content = self.finished(), self.files()
        other_key, same_key = self.of_others(plan)
        replaced = other_key | same_key if replace else set()
        self.trainer.trained.clear()
        if other_key and not replace:
            with pytest.raises(UsageError, match="--replace"):
                sweep(plan, self.out, self.out, 1, **options)
            assert (self.files(), self.trainer.trained) == (content, [])
            self.seen["refused"] += 1
            return
        status = sweep(plan, self.out, self.out, 1, replace=replace, **options)
        self.check_trained(plan, stored, replaced)
        if status == 130:
            assert self.files() == content
            self.seen["interrupted"] += 1
            return
        self.rows = self.check_rows(plan, status, replaced)

    def check_trained(self, plan, stored, replaced):
        """Nothing is trained that has a row or a folder, but lost parents of what is trained."""
        trained = self.trainer.trained
        assert len(trained) == len({*trained})
        for run in plan.runs:
            if run.name not in trained or run.identity in replaced:
                continue
            assert run.name not in stored
            if run.identity in self.rows:
                assert any(run.name in other.parents.values() for other in plan.runs)
                row, lost = self.rows[run.identity], not self.sound(run.name)
                kept = lost or self.store.metrics(run.name)["reward"] == row.reward
                assert kept  # what does not reproduce its row is in quarantine
                self.seen["unlike its row" if lost else "trained again"] += 1

    def check_rows(self, plan, status, replaced):
        """The rows of now, which are those of before, replaced ones and new ones."""
        after, finished = self.recorded(), self.finished()
        now = {run.identity: run.name for run in plan.runs if run.name in finished}
        for identity, rows in self.rows.items():
            if identity in replaced and identity in now:
                name = now[identity]
                assert after[identity].run == name
                assert after[identity].reward == self.store.metrics(name)["reward"]
                self.seen["replaced"] += 1
            else:
                assert after[identity] == rows
        assert after.keys() == {*self.rows, *finished.values()}
        names = {row.run for row in after.values()}
        if status == 0:
            assert {run.name for run in plan.runs} <= names
        else:
            assert status == 1
            assert any(run.name not in finished for run in plan.runs)
        return after

    def files(self):
        """Content of the tables."""
        return {path.name: path.read_bytes() for path in self.out.iterdir() if path.is_file()}

    @rule()
    def clone(self):
        """What was committed and not recorded is lost, too."""
        shutil.rmtree(self.store.runs, ignore_errors=True)

    @rule(share=st.sets(st.integers(0, 5), min_size=1))
    def lose_folders(self, share):
        for place, name in enumerate(self.store.names()):
            if place in share:
                shutil.rmtree(self.store.runs / name)

    @rule(place=st.integers(0, 5))
    def damage(self, place):
        names = self.store.names()
        if (
            place < len(names)
            and (policy := self.store.runs / names[place] / "policy.npz").exists()
        ):
            policy.write_bytes(b"")

    @rule(method=st.sampled_from(METHODS))
    def change_version(self, method):
        VERSIONED[method].version = str(1 + int(VERSIONED[method].version) % 2)

    @rule(method=st.sampled_from(METHODS))
    def change_source(self, method):
        """Of a method, under its version; its runs come out alike."""
        self.sources[VERSIONED[method]] = f"edit {len(self.sources)}"

    def teardown(self):
        for kind in VERSIONED.values():
            kind.version = "1"
        if hasattr(self, "folder"):
            self.folder.cleanup()


@pytest.fixture
def make_machine(plugins, monkeypatch):
    trainer, sources = at_once.install(monkeypatch, documents=False), {}
    own = bench.plan.expansion.own_source
    monkeypatch.setattr(bench.plan.expansion, "own_source", lambda cls: sources.get(cls, own(cls)))
    with config_context(validation_enabled=False):
        yield lambda: SweepMachine(trainer, sources)


def test_no_row_of_a_finished_run_goes_or_changes_unless_it_is_replaced(make_machine):
    run_state_machine_as_test(
        make_machine,
        settings=MACHINE,
    )


def test_the_machine_meets_what_it_is_there_for(make_machine):
    """Its checks, on one walk by hand through all that can happen to a row."""
    machine = make_machine()
    machine.begin(["instant"], 2)
    machine.run_elsewhere(["child"], 1, shift=-9.0)
    assert machine.seen == {"unlike its row": 1}
    machine.run_elsewhere(["child"], 2, shift=0.0)
    assert machine.seen["trained again"] == 2
    machine.run_interrupted(["failing"], 2, replace=False, most=1)
    assert machine.seen["interrupted"] == 1
    machine.change_version("instant")
    machine.run(["instant"], 1, replace=False)
    assert machine.seen["refused"] == 1
    machine.run(["instant"], 1, replace=True)
    assert machine.seen["replaced"] == 1
    machine.change_source("instant")
    machine.run(["instant"], 2, replace=True)
    assert machine.seen["replaced"] == 3
    methods = sorted(identity[0] for identity in machine.rows)
    assert methods == ["child", "child", "failing", "instant", "instant"]
    machine.teardown()
