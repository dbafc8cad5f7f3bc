"""A store under any sequence of commits, kills, failures and damage agrees with a dictionary."""

import errno
import os
import tempfile

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)
from outcomes import MACHINE, FailingDisk, MortalDisk, make_template, outcome, plan

from bench.store.record import FILES, Outcome
from bench.store.resume import make_standing
from bench.store.store import Store
from bench.store.tables import Tables

N_RUNS = 3
SEEDS = st.integers(0, N_RUNS - 1)


class Killed(BaseException):
    """The end of a process."""


class KilledDisk(MortalDisk):
    """Once the process is killed, not even what it would tidy up happens."""

    def end(self):
        raise Killed


class StoreMachine(RuleBasedStateMachine):
    """`kept` is what should be there: status and flight minutes by run."""

    def __init__(self, planned, policy):
        super().__init__()
        self.planned, self.policy = planned, policy
        self.kept = {}
        self.damaged = set()

    @initialize()
    def begin(self):
        self.folder = tempfile.TemporaryDirectory()
        self.store = Store(self.folder.name)

    def outcome(self, run, ok, minutes):
        if not ok:
            return Outcome("failed", cause="bad luck")
        return outcome(run, policy=self.policy, minutes=minutes)

    def expect(self, run, ok, minutes):
        """What a commit should leave: a finished run stays as it is."""
        if run.name in self.damaged or self.kept.get(run.name, ("failed",))[0] == "failed":
            return ("budget", minutes) if ok else ("failed", 0)
        return self.kept[run.name]

    @rule(seed=SEEDS, ok=st.booleans(), minutes=st.integers(1, 9))
    def commit(self, seed, ok, minutes):
        run = self.planned.runs[seed]
        expected = self.expect(run, ok, minutes)
        self.store.commit(run, self.outcome(run, ok, minutes))
        self.kept[run.name] = expected
        self.damaged.discard(run.name)

    @rule(seed=SEEDS, ok=st.booleans(), minutes=st.integers(1, 9), left=st.integers(0, 30))
    def die(self, seed, ok, minutes, left):
        """Afterwards there is the old one, the new one, or none instead of a failed or damaged."""
        run = self.planned.runs[seed]
        new, old = self.expect(run, ok, minutes), self.kept.get(run.name)
        try:
            Store(self.folder.name, KilledDisk(left)).commit(run, self.outcome(run, ok, minutes))
        except Killed:
            pass
        else:
            old = new
        if not (self.store.runs / run.name).exists():
            assert old is None or old[0] == "failed" or run.name in self.damaged
            self.kept.pop(run.name, None)
            self.damaged.discard(run.name)
        elif self.store.status(run.name):
            status = self.store.status(run.name)
            failed = status == "failed"
            found = (status, 0 if failed else self.store.metrics(run.name)["fleet_minutes"])
            assert found in (old, new)
            self.kept[run.name] = found
            self.damaged.discard(run.name)
        else:
            assert run.name in self.damaged

    @rule(seed=SEEDS, code=st.sampled_from([errno.ENOSPC, errno.EROFS]))
    def fail(self, seed, code):
        run = self.planned.runs[seed]
        failing = Store(self.folder.name, FailingDisk(code, lambda p: p.name == "run.json"))
        if run.name in self.damaged or self.kept.get(run.name, ("failed",))[0] == "failed":
            with pytest.raises(OSError, match=os.strerror(code)):
                failing.commit(run, self.outcome(run, True, 1))
            if run.name in self.damaged:  # it was moved out of the way first
                self.damaged.discard(run.name)
                del self.kept[run.name]

    @rule(seed=SEEDS, file=st.sampled_from([*FILES, "run.json"]), size=st.integers(0, 40))
    def damage(self, seed, file, size):
        run = self.planned.runs[seed]
        path = self.store.runs / run.name / file
        if path.exists() and path.stat().st_size > size:
            os.truncate(path, size)
            self.damaged.add(run.name)

    @rule()
    def look(self):
        """A sweep begins: what is left over goes, what is damaged is put in quarantine."""
        self.store.tidy()
        warnings = []
        sound = self.store.sound(warnings.append)
        assert len(warnings) == len(self.damaged)
        for name in self.damaged:
            del self.kept[name]
        self.damaged.clear()
        assert {n: c["status"] for n, c in sound.items()} == {
            n: status for n, (status, _) in self.kept.items()
        }
        standing = make_standing(self.planned, sound, Tables.empty(), retry_failed=True)
        finished = {n for n, (status, _) in self.kept.items() if status != "failed"}
        assert {r.name for r in standing.done} == finished
        assert [r.name for r in standing.missing] == [
            r.name for r in self.planned.runs if r.name not in finished
        ]
        tables = self.store.tables(sound, ())
        rows = tables.results.set_index("metric").loc[:, "value"]
        billed = rows[rows.index == "fleet_minutes"].sum()
        assert billed == sum(minutes for _, minutes in self.kept.values())
        ledgers = [content.get("ledger", {}) for content in sound.values()]
        assert billed == sum(ledger.get("hf_fleet_seconds", 0) for ledger in ledgers) / 60
        assert not list(self.store.runs.glob(".part-*"))

    @invariant()
    def nothing_but_what_was_committed_is_there(self):
        if hasattr(self, "store"):
            assert set(self.store.names()) == set(self.kept)

    def teardown(self):
        if hasattr(self, "store"):
            self.look()
            self.folder.cleanup()


def test_a_store_agrees_with_a_dictionary(plugins):
    planned, policy = plan(seeds=N_RUNS), make_template(seed=1)
    run_state_machine_as_test(
        lambda: StoreMachine(planned, policy),
        settings=MACHINE,
    )
