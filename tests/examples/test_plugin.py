"""The example plug-in, installed as its README says and used as any third party's method."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pandas as pd
import pytest
from installed import fresh_registry
from jax.flatten_util import ravel_pytree

from bench.plan.expansion import expand
from bench.plan.suite import load_suite
from methods.contract import Setup
from methods.training.evaluate import evaluate
from methods.training.policy import PolicyController, make_policy
from simulators import registry
from simulators.point_mass import PointMass
from tasks.circle import Circle

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "examples" / "plugin"
SUITE = """
tasks = ["circle"]
team_sizes = [2]
seeds = 1

[[methods]]
method = "random_search"
settings = { iterations = 3, directions = 2, top = 1 }
task_settings.horizon = 10
"""
NOMINAL = PointMass()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder into which the plug-in, and a broken one, are installed."""
    source, site = tmp_path_factory.mktemp("source") / "plugin", tmp_path_factory.mktemp("site")
    shutil.copytree(SOURCE, source, ignore=shutil.ignore_patterns("build", "*.egg-info"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    options = ["--no-index", "--no-deps", "--no-build-isolation", "--target", str(site)]
    subprocess.run([*pip, *options, str(source)], check=True, timeout=600)
    info = site / "shattered-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: shattered\nVersion: 2.0\n")
    (info / "entry_points.txt").write_text("[bench.methods]\nshattered = shattered:Method\n")
    (site / "shattered.py").write_text("raise ImportError('the frame is cracked')\n")
    return site


@pytest.fixture
def installed(site):
    """The folder is on the path of this process."""
    with fresh_registry(site):
        yield


@pytest.fixture
def method(installed):
    """The class that the plug-in registers."""
    return registry.load("method", "random_search")


def bench(site, programs, *arguments):
    """What the command line says and does in a process that has the folder on its path."""
    script = "import sys; from bench.cli.app import main; sys.exit(main())"
    paths = os.pathsep.join((str(site), str(ROOT)))
    return subprocess.run(
        [sys.executable, "-c", script, *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
        env=os.environ | {"PYTHONPATH": paths, "JAX_COMPILATION_CACHE_DIR": str(programs)},
    )


def weights(policy):
    return ravel_pytree(eqx.filter(policy, eqx.is_inexact_array))[0]


def test_an_installed_method_gets_its_row_beside_a_broken_plugin(site, tmp_path, program_cache):
    suite, out = tmp_path / "mine.toml", tmp_path / "out"
    suite.write_text(SUITE)
    done = bench(site, program_cache, "run", str(suite), "--out", str(out), "--jobs", "1")
    assert (done.returncode, done.stderr) == (0, "")
    runs = pd.read_parquet(out / "runs.parquet").set_index("method")
    assert runs["status"].to_dict() == {"random_search": "ok"}
    row = [line for line in (out / "leaderboard.md").read_text().splitlines() if "random" in line]
    assert any("random_search" in line and "1 ok" in line for line in row)
    results = pd.read_parquet(out / "results.parquet").set_index("metric")["value"]
    assert results["epochs"] == 3
    assert results["fleet_minutes"] == 0
    assert np.isfinite(results["reward"])


def test_the_suite_of_the_plugin_compares_it_with_the_lf_baseline(installed):
    runs = expand(load_suite(str(SOURCE / "suite.toml"))).runs
    assert {(run.method, run.seed) for run in runs} == {
        (name, seed) for name in ("lf_baseline", "random_search") for seed in (0, 1)
    }
    assert {run.variant for run in runs} == {""}


def test_random_search_climbs_in_the_simulator_in_which_it_trains(method, key):
    task = Circle(n_drones=2, horizon=200)
    trained = method(iterations=60, directions=8, top=4).train(Setup(task, NOMINAL, NOMINAL), key)
    fresh = make_policy(task, NOMINAL.spec, NOMINAL.action_space, jax.random.split(key)[0])
    before, after = (
        evaluate(task, NOMINAL, PolicyController(task, policy), seed=0, n_episodes=8).reward
        for policy in (fresh, trained.policy)
    )
    assert before < 0
    assert after > 0.5 * before
    assert trained.ledger.epochs == len(trained.curves["reward"]) == 60
    assert trained.ledger.lf_collisions == trained.curves["crashes"].sum()


def test_random_search_starts_from_init_and_repeats_itself(method, key):
    task = Circle(n_drones=2, horizon=5)
    init = make_policy(task, NOMINAL.spec, NOMINAL.action_space, jax.random.key(5))
    search = method(iterations=2, directions=2, top=1, step_size=1e-9)
    first, second, other = (
        search.train(Setup(task, NOMINAL, NOMINAL), k, init) for k in (key, key, jax.random.key(1))
    )
    np.testing.assert_array_equal(weights(first.policy), weights(second.policy))
    np.testing.assert_allclose(weights(first.policy), weights(init), atol=1e-6)
    assert not np.array_equal(first.curves["reward"], other.curves["reward"])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"iterations": 0}, "`iterations` must be above 0, got 0."),
        ({"noise": -0.1}, "`noise` must be above 0, got -0.1."),
        ({"top": 4, "directions": 3}, "`directions` must be at least 4, got 3."),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused(method, settings, message):
    with pytest.raises(ValueError, match=message):
        method(**settings)
