"""CONTRIBUTING.md: the code of its recipes is run, and its walks lead where they say."""

import ast
import importlib.util
import re
import sys
import tomllib
from pathlib import Path

import pytest

from bench.conformance.command import findings
from simulators import registry
from simulators.point_mass import PointMass

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
def registered(tmp_path, monkeypatch):
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
        monkeypatch.setitem(sys.modules, spec.name, module)
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
        # The page's title is written by the module to which the walk leads.
        title = (HOUSE / first_code(sought)).read_text(encoding="utf-8").split("\n", 1)[0]
        assert title.removeprefix("# ") in (HOUSE / place).read_text(encoding="utf-8")


def classes_and_functions(place):
    tree = ast.parse((HOUSE / place).read_text(encoding="utf-8"))
    return {n.name for n in tree.body if isinstance(n, ast.ClassDef | ast.FunctionDef)}


def test_every_recipe_is_tested():
    assert len(CODE) == 4


@pytest.mark.parametrize("kind", ["method", "task", "effect", "residual"])
def test_a_recipe_keeps_the_contract_of_its_kind(registered, kind):
    found = findings(kind, registered(kind), {"point_mass": PointMass}, {})
    assert [finding for finding in found if finding.problem] == []
