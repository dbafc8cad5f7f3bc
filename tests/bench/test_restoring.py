"""Parents whose folders are gone, and whose policies are kept beside the tables: not trained."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest
from clones import assert_kept, forget, lines, rows, trained_methods
from outcomes import make_template, outcome

from bench.execution import policies
from bench.execution.policies import keep
from bench.execution.sweep import _make_way
from bench.execution.worker import _parents
from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite
from bench.store.kept import KeptRun, load_kept, path_of, restorer, save_kept
from bench.store.resume import make_standing
from bench.store.store import Store
from bench.store.tables import Tables
from methods.residuals.contract import blank
from methods.residuals.mlp import MLPEnsemble
from methods.training.policy import make_policy
from simulators.point_mass import PointMass
from tasks.figure8 import Figure8
from tasks.spread import Spread

PLAIN = """
tasks = ["spread"]
team_sizes = [2]
seeds = 2
[[methods]]
method = "instant"
[[methods]]
method = "child"
"""


@pytest.fixture
def suite(tmp_path, monkeypatch):
    """A suite of default settings; no built-in one needs a residual of its runs."""
    monkeypatch.setattr(policies, "runs_to_resume", set)
    path = tmp_path / "plain.toml"
    path.write_text(PLAIN)
    return path


@pytest.fixture
def clone(sweep, suite, out):
    """A clone with the rows of `instant` alone and their kept policies; its lines."""
    sweep("--method", "instant", of=suite)
    keep(out, (), ())
    forget(out)
    return lines(out)


def test_a_parent_whose_policy_is_kept_is_restored_and_not_trained(
    sweep, suite, trainer, out, clone
):
    row = Tables.load(out).runs.set_index(["method", "seed"]).loc[("instant", 0)]
    status, said, _ = sweep(of=suite)
    assert status == 0
    assert "Restored from kept policies, because others start from them: 2." in said
    assert "Trained again" not in said
    assert trained_methods(trainer) == ["child", "child"]
    assert_kept(clone, lines(out))
    content = Store(out).read(row["run"])
    assert content["committed"] == row["committed"]
    assert content["provenance"]["machine"] == row["machine"]
    assert content["ledger"]["hf_fleet_seconds"] == 90.0
    assert content["notes"] == {"training_reward": -4.5}
    trained = Store(out).trained(row["run"], make_template(seed=7))
    observed = jax.random.normal(jax.random.key(3), (2, Spread(n_drones=2).obs_size))
    assert np.array_equal(trained.policy(observed), trainer.policy(observed))


def test_runs_that_nobody_starts_from_are_not_restored(sweep, suite, out, clone):
    assert sweep("--method", "instant", of=suite)[0] == 0
    assert Store(out).names() == []


def change(out, how):
    path = path_of(out, "spread", 2)
    save_kept(path, {run: how(kept) for run, kept in load_kept(path).items()})


def test_a_policy_of_a_row_that_was_replaced_is_not_restored(sweep, suite, trainer, out, clone):
    change(out, lambda kept: kept._replace(committed="2020-01-01T00:00:00+00:00"))
    assert sweep(of=suite)[0] == 0
    assert trained_methods(trainer) == ["child", "child", "instant", "instant"]
    assert_kept(clone, lines(out))
    keep(out, ("spread",), ())
    found = load_kept(path_of(out, "spread", 2))
    committed = {row["run"]: row["committed"] for _, row in Tables.load(out).runs.iterrows()}
    assert {run: kept.committed for run, kept in found.items()} == committed


def test_a_stale_policy_hides_none_of_another_folder(sweep, suite, trainer, out, clone, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(out, other)
    change(out, lambda kept: kept._replace(committed="2020-01-01T00:00:00+00:00"))
    assert sweep("--reuse", str(other), of=suite)[0] == 0
    assert trained_methods(trainer) == ["child", "child"]


def test_an_older_file_says_nothing_of_rows_and_is_used(sweep, suite, trainer, out, clone):
    change(out, lambda kept: kept._replace(committed=""))
    with np.load(path_of(out, "spread", 2)) as stored:
        assert {name.count("/") for name in stored.files} == {1}
    assert sweep(of=suite)[0] == 0
    assert trained_methods(trainer) == ["child", "child"]


def test_a_run_of_another_key_is_not_restored(sweep, suite, trainer, out, clone):
    tables = Tables.load(out)
    runs = tables.runs.assign(key="0" * 16)
    dataclasses.replace(tables, runs=runs).save(out)
    assert sweep(of=suite)[0] == 0
    assert trained_methods(trainer) == ["child", "child", "instant", "instant"]


@pytest.mark.parametrize("damage", [b"no archive", b""])
def test_a_damaged_file_is_said_and_the_parent_trained(sweep, suite, trainer, out, clone, damage):
    path_of(out, "spread", 2).write_bytes(damage)
    status, _, error = sweep(of=suite)
    assert status == 0
    assert "cannot be restored from its kept policy" in error
    assert trained_methods(trainer) == ["child", "child", "instant", "instant"]


def test_arrays_of_another_shape_are_said_and_the_parent_trained(sweep, suite, trainer, out, clone):
    change(out, lambda kept: kept._replace(policy=dict([*kept.policy.items()][:-1])))
    _, _, error = sweep(of=suite)
    assert "does not fit its run" in error
    assert "instant" in trained_methods(trainer)


def test_replacing_trains_what_another_machine_made(sweep, suite, trainer, out, clone):
    tables = Tables.load(out)
    dataclasses.replace(tables, runs=tables.runs.assign(machine="another one")).save(out)
    assert sweep("--replace", of=suite)[0] == 0
    assert trained_methods(trainer) == ["child", "child", "instant", "instant"]
    assert len(rows(out)) == 4


# The residual that `hybrid_once` starts from.


@pytest.fixture
def hybrid(tmp_path, monkeypatch):
    """Tables of a Hybrid, its folder, its child `hybrid_once` and the residual."""
    found = expand(Suite("s", "", ("figure8",), (3,), 1, (Row("hybrid_once"),))).runs
    (parent,) = [run for run in found if run.method == "hybrid"]
    (child,) = [run for run in found if run.method == "hybrid_once"]
    monkeypatch.setattr(policies, "runs_to_resume", lambda: {parent.name})
    store, residual = Store(tmp_path / "results"), blank(MLPEnsemble())
    left = outcome(parent, policy=make_template(seed=1), minutes=40.0)
    notes = {"training_reward": -4.5, "residual_error_rms": 0.25}
    trained = dataclasses.replace(
        left.trained, residual=residual, policy=_figure8_policy(), notes=notes
    )
    bill = {"calibration_crashes": 0.0, "epochs": 2.0, "train_seconds": 0.0}
    metrics = left.metrics | notes | bill  # as `bench.execution.worker.metrics` gives them
    store.commit(parent, dataclasses.replace(left, trained=trained, metrics=metrics))
    store.tables(store.sound(print), {parent.name}).save(store.directory)
    return store, parent, child, residual


def _figure8_policy():
    nominal = PointMass()
    return make_policy(Figure8(n_drones=3), nominal.spec, nominal.action_space, jax.random.key(5))


def restored(store, run):
    said = []
    left = restorer([store.directory], Tables.load(store.directory), said.append)(run)
    assert said == []
    return left


def test_a_child_gets_the_residual_and_the_bill_of_its_restored_parent(hybrid):
    store, parent, child, residual = hybrid
    keep(store.directory, (), ())
    before = json.loads((store.runs / parent.name / "run.json").read_text())
    forget(store.directory)
    store.commit(parent, restored(store, parent))
    (found,) = _parents(child, store, Figure8(n_drones=3), PointMass()).values()
    assert jax.tree.all(jax.tree.map(np.array_equal, found.residual, residual))
    assert found.ledger.hf_fleet_seconds == 2400.0
    after = store.read(parent.name)
    for entry in ("ledger", "notes", "provenance", "program", "committed", "packages"):
        assert after[entry] == before[entry]
    assert after["files"]["residual.npz"] == before["files"]["residual.npz"]
    assert after["files"]["policy.npz"] == before["files"]["policy.npz"]


def test_a_residual_that_was_not_kept_is_kept_as_long_as_its_folder_is_there(hybrid):
    store, parent, _, _ = hybrid
    keep(store.directory, (), ())
    path = path_of(store.directory, "figure8", 3)
    whole = load_kept(path)[parent.name]
    save_kept(path, {parent.name: KeptRun(whole.policy, [], "")})  # as an older program did
    assert restored(store, parent).trained.residual is None
    keep(store.directory, (), ())
    assert len(load_kept(path)[parent.name].residual) == len(whole.residual) > 0
    assert restored(store, parent).trained.residual is not None


def test_only_who_starts_from_a_residual_needs_one(hybrid):
    """A Hybrid without one is restored for a run that deploys it, else trained again."""
    store, parent, _, residual = hybrid
    keep(store.directory, (), ())
    path = path_of(store.directory, "figure8", 3)
    save_kept(path, {parent.name: KeptRun(load_kept(path)[parent.name].policy, [], "")})
    forget(store.directory)
    recorded = Tables.load(store.directory)
    kept = restorer([store.directory], recorded, print)
    hybrid = Row("hybrid", residual="mlp", deployed_in="crazyflow+mass(e=0.2)")
    deployed = expand(Suite("s", "", ("figure8",), (3,), 1, (hybrid,)))

    def standing(plan):
        store_again = Store(store.directory)
        return make_standing(plan, store_again.sound(print), recorded, kept=kept)

    before = standing(deployed)
    assert [run.name for run in before.restored] == [parent.name]
    assert before.again == []
    left = restored(store, parent)
    store.commit(parent, left)
    assert standing(deployed).restored == []  # it is in place now
    once = expand(Suite("s", "", ("figure8",), (3,), 1, (Row("hybrid_once"),)))
    resumed = standing(once)
    assert parent in resumed.again
    sound = store.sound(print)
    _make_way(resumed, store, sound)
    assert parent.name not in sound
    whole = dataclasses.replace(left, trained=dataclasses.replace(left.trained, residual=residual))
    assert store.commit(parent, whole)
    assert parent not in standing(once).again


def test_built_in_suites_start_from_the_residuals_of_these_cells():
    """`hybrid_once`: figure8, N = 3; then off-spec worlds, and what transfers to RotorPy."""
    cells = {tuple(run.split("-")[2:4]) for run in policies.runs_to_resume()}
    off_spec = {(task, f"n{n}") for task in ("circle", "figure8") for n in (3, 7, 12)}
    transfer = {(task, f"n{n}") for task in ("spread", "pitchandexpand") for n in (3, 12)}
    assert cells == off_spec | transfer
