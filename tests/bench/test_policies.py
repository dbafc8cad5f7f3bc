"""Policies that are kept beside their tables, and flown again."""

import dataclasses

import jax
import numpy as np
import pytest
from outcomes import make_template, outcome, plan
from rich.console import Console

from bench.execution import policies
from bench.execution.policies import deploy, keep, kept_policy
from bench.store.kept import load_kept, path_of
from bench.store.store import Store
from bench.store.tables import Tables
from bench.text.errors import UsageError
from methods.training.evaluate import evaluate
from methods.training.policy import PolicyController
from simulators.crazyflow import Crazyflow
from tasks.spread import Spread

TASK = Spread(n_drones=2)


@pytest.fixture
def runs(plugins):
    return plan().runs


@pytest.fixture
def folder(tmp_path, runs, monkeypatch):
    """Tables of two runs, and the folders that they came from; no suite trains them again."""
    monkeypatch.setattr(policies, "runs_to_resume", set)
    store = Store(tmp_path / "results")
    for seed, run in enumerate(runs):
        store.commit(run, outcome(run, policy=make_template(seed=seed)))
    store.tables(store.sound(print), {run.name for run in runs}).save(store.directory)
    return store.directory


def same(a, b):
    obs = jax.random.normal(jax.random.key(3), (2, TASK.obs_size))
    return np.array_equal(a(obs), b(obs))


def test_a_kept_policy_is_the_one_that_was_trained(folder, runs):
    path = path_of(folder, "spread", 2)
    assert keep(folder, (), ()) == {path: 2}
    for seed, run in enumerate(runs):
        kept = kept_policy(folder, TASK, "spread", run.name)
        assert same(kept, make_template(seed=seed))
        assert not same(kept, make_template(seed=7))


def test_policies_stay_when_their_folders_are_gone_and_others_come(folder, runs):
    store = Store(folder)
    store.quarantine(runs[1].name, "not here yet")
    assert list(keep(folder, (), ()).values()) == [1]
    before = load_kept(path_of(folder, "spread", 2))[runs[0].name].policy
    store.commit(runs[1], outcome(runs[1], policy=make_template(seed=1)))
    store.quarantine(runs[0].name, "lost")
    assert list(keep(folder, (), ()).values()) == [2]
    after = load_kept(path_of(folder, "spread", 2))[runs[0].name].policy
    assert before.keys() == after.keys()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_keeping_again_writes_the_same_bytes(folder):
    path = path_of(folder, "spread", 2)
    keep(folder, (), ())
    first = path.read_bytes()
    keep(folder, (), ())
    assert path.read_bytes() == first


def test_filters_choose_cells(folder):
    assert keep(folder, ("circle",), ()) == {}
    assert keep(folder, (), (3,)) == {}
    assert list(keep(folder, ("spread",), (2,)).values()) == [2]


def test_what_is_not_kept_or_of_another_shape_is_said(folder, runs):
    with pytest.raises(UsageError, match=r"holds no policy of .*`bench keep"):
        kept_policy(folder, TASK, "spread", runs[0].name)
    keep(folder, (), ())
    with pytest.raises(UsageError, match="does not fit its run"):
        kept_policy(folder, Spread(n_drones=2, n_neighbors=1), "spread", runs[0].name)
    path_of(folder, "spread", 2).write_bytes(b"no archive")
    with pytest.raises(UsageError, match="cannot be read"):
        load_kept(path_of(folder, "spread", 2))


def test_damage_inside_of_an_archive_is_one_line(folder):
    keep(folder, (), ())
    path = path_of(folder, "spread", 2)
    whole, refused = path.read_bytes(), 0
    for place in range(0, len(whole), len(whole) // 60):  # headers, compressed bytes, names
        path.write_bytes(whole[:place] + bytes(64) + whole[place + 64 :])
        try:
            load_kept(path)
        except UsageError:
            refused += 1
    assert refused > 30  # zeros in the place of zeros do no damage


def test_a_policy_that_is_older_than_its_row_is_not_flown(folder, runs, capsys):
    keep(folder, (), ())
    tables = Tables.load(folder)
    older = tables.runs["run"].eq(runs[0].name)
    again = tables.runs["committed"].mask(older, "later")
    method = tables.runs["method"].mask(older, "another")
    changed = tables.runs.assign(committed=again, method=method)
    dataclasses.replace(tables, runs=changed).save(folder)
    assert deploy(folder, "spread", 2, "", (), Console(width=200)) == 0
    said = capsys.readouterr().out
    assert f"Left out: the row of {runs[0].name} was made after its policy was kept." in said
    assert f"{runs[0].name}: settled" not in said
    assert f"{runs[1].name}: settled" in said
    assert deploy(folder, "spread", 2, "", [runs[1].method], Console(width=200)) == 0
    said = capsys.readouterr().out  # of a method that was not asked for nothing is said
    assert "Left out" not in said
    assert f"{runs[1].name}: settled" in said


def test_a_team_is_two_drones_at_least(folder):
    with pytest.raises(UsageError, match="`n_drones` must be at least 2, got -3"):
        deploy(folder, "spread", -3, "", (), Console())


def test_deploying_shows_what_evaluating_gives(folder, runs, capsys):
    with pytest.raises(UsageError, match="holds no policy of these methods"):
        deploy(folder, "spread", 2, "", (), Console())
    keep(folder, (), ())
    assert deploy(folder, "spread", 2, "", (), Console(width=120)) == 0
    shown = capsys.readouterr().out
    controller = PolicyController(TASK, make_template(seed=0))
    flown = evaluate(TASK, Crazyflow(), controller, 0)
    assert f"{runs[0].name}: settled reward {flown.settled_reward:.2f}" in shown
    with pytest.raises(UsageError, match="holds no policy of these methods"):
        deploy(folder, "spread", 2, "", ("hybrid",), Console())
