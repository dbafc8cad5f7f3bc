"""CONTRIBUTING.md: the code of its recipes is run, and its walks lead where they say."""

import ast
import importlib.util
import re
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from methods.contract import Setup
from methods.residuals.contract import Transitions
from methods.training.bptt import BPTT
from simulators import registry
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.point_mass import PointMass
from simulators.vehicle import GRAVITY
from tasks.circle import Circle
from tasks.contract import TaskState
from tasks.rollout import episode

HOUSE = Path(__file__).parents[2]
PAGE = (HOUSE / "CONTRIBUTING.md").read_text(encoding="utf-8")
WALKS = {
    sought: (place, there)
    for sought, place, there in re.findall(
        r"^\| (an? .*?) \| (.*?) \| (.*?) \|$", PAGE, re.MULTILINE
    )
}
PLUGINS = {"a method": "method", "a task": "task", "an effect": "effect"}
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
CODE = {
    text.split("\n", 1)[0].removeprefix("# "): text
    for language, text in BLOCKS
    if language == "python"
}


@pytest.fixture
def registered(tmp_path):
    """A function: the class that a recipe writes and registers for a kind of plug-in."""

    def load(kind):
        (points,) = (
            group
            for language, text in BLOCKS
            if language == "toml"
            for name, group in tomllib.loads(text)["project"]["entry-points"].items()
            if name == registry.GROUPS[kind]
        )
        ((_, target),) = points.items()
        module_name, class_name = target.split(":")
        path = tmp_path / "recipe.py"
        path.write_text(CODE[module_name.replace(".", "/") + ".py"], encoding="utf-8")
        spec = importlib.util.spec_from_file_location(f"recipe_{kind}", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return getattr(module, class_name)

    return load


def first_code(text):
    """The first words of a cell that are set as code."""
    return re.search(r"`(.*?)`", text)[1]


def test_the_walks_cover_what_a_newcomer_looks_for():
    pages = {first_code(sought) for sought in WALKS if sought.startswith("a table of")}
    assert {*PLUGINS, "a decision of the diagnosis"} == {s for s in WALKS if "`" not in s}
    assert {"reports/paper.md", "reports/blind.md"} <= pages


@pytest.mark.parametrize("sought", PLUGINS)
def test_every_plug_in_of_ours_is_where_the_walk_says(sought):
    place = first_code(WALKS[sought][0])
    project = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    own = project["entry-points"][registry.GROUPS[PLUGINS[sought]]]
    for name, target in own.items():
        assert target.split(":")[0].replace(".", "/") + ".py" == place.replace("NAME", name)
        assert target.split(":")[1] in classes_and_functions(place.replace("NAME", name))


@pytest.mark.parametrize("sought", [s for s in WALKS if s not in PLUGINS])
def test_every_other_walk_ends_at_what_it_names(sought):
    place, there = (first_code(cell) for cell in WALKS[sought])
    assert there in classes_and_functions(place)
    for file in re.findall(r"`([^`]*/[^`]*)`", WALKS[sought][1]):
        assert (HOUSE / file).is_file()
    if sought.startswith("a table of"):
        # The page's title is written by the module to which the walk leads, which puts a
        # simulator's name in before the colon.
        title = (HOUSE / first_code(sought)).read_text(encoding="utf-8").split("\n", 1)[0]
        writer = (HOUSE / place).read_text(encoding="utf-8")
        assert all(part in writer for part in title.removeprefix("# ").split(": "))


def classes_and_functions(place):
    tree = ast.parse((HOUSE / place).read_text(encoding="utf-8"))
    return {n.name for n in tree.body if isinstance(n, ast.ClassDef | ast.FunctionDef)}


def test_every_recipe_is_tested():
    assert len(CODE) == 4


def test_the_method_returns_the_best_of_its_trainings_and_bills_all(registered, key, monkeypatch):
    runs, train = [], BPTT.train
    monkeypatch.setattr(BPTT, "train", lambda *a: runs.append(train(*a)) or runs[-1])
    method = registered("method")(trainer=BPTT(epochs=2, smoothing=1, n_worlds=1), restarts=3)
    setup = Setup(Circle(n_drones=2, horizon=5), PointMass(), PointMass())
    trained = method.train(setup, key)
    assert trained.ledger.epochs == 6
    finals = [run.final_reward for run in runs]
    assert len(set(finals)) == 3
    assert trained.policy is runs[int(np.argmax(finals))].policy
    assert trained.notes["training_reward"] == max(finals)
    assert trained.curves["smooth_reward"][-1] == pytest.approx(max(finals))
    assert registered("method")().restarts == 2


def test_the_task_asks_for_the_line_and_can_be_flown(registered, key):
    task = registered("task")(n_drones=2, horizon=20)
    simulator = PointMass()
    pos, goal = task.reset(key)
    away = jnp.asarray([[3.0, 1.0, 0.5], [-2.0, -0.5, 2.0]])
    state = TaskState(simulator.flight(simulator.reset(away, key)), goal, jnp.asarray(0))
    np.testing.assert_allclose(task.target(state).offset, [[0, -1, 0.5], [0, 0.5, -1]])
    np.testing.assert_allclose(task.error(state), np.sqrt(1.25), rtol=1e-5)
    assert pos.shape == (2, 3)
    assert np.isfinite(episode(task, simulator, lambda _: jnp.zeros((2, 3)), key).reward)


@pytest.mark.parametrize("simulator", [PointMass(), Crazyflow()], ids=lambda s: s.name)
def test_the_effect_pulls_to_the_origin_and_is_nominal_without_stiffness(
    registered, simulator, key
):
    tether = registered("effect")
    pos = jnp.asarray([[2.0, 0.0, 5.0]])
    cmd = jnp.asarray([[0.0, 0.0, 0.0, simulator.spec.mass * GRAVITY]])

    def after(simulator):
        return simulator.flight(simulator.step_cmd(simulator.reset(pos, key), cmd, 0.02))

    nominal, neutral = after(simulator), after(with_effects(simulator, [tether()]))
    jax.tree.map(np.testing.assert_array_equal, nominal, neutral)
    pulled = after(with_effects(simulator, [tether(k=0.05)]))
    expected = -0.05 * 2.0 / simulator.spec.mass * 0.02
    assert float(pulled.vel[0, 0] - nominal.vel[0, 0]) == pytest.approx(expected, rel=0.05)


def test_the_residual_is_the_weighted_mean_within_its_bound(registered, key):
    target = jnp.asarray([[1.0, 0.0, -2.0], [4.0, 0.0, 900.0]])
    weight = jnp.asarray([3.0, 1.0])
    model = registered("residual")().fit(Transitions(jnp.zeros((2, 12)), target, weight), key)
    out = model(jnp.zeros((5, 12)))
    assert out.shape == (5, 3)
    mean = np.array([1.75, 0.0, 223.5])
    np.testing.assert_allclose(model.acc, mean, rtol=1e-5)
    np.testing.assert_allclose(out[0], 35.0 * np.tanh(mean / 35.0), rtol=1e-5)
