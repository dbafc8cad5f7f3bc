"""`bench doctor`: each known-bad combination is named with its remedy, and a whole one passes."""

import dataclasses

import pytest

from bench.cli.app import main
from bench.conformance import doctor
from bench.conformance.doctor import Facts, problems
from simulators import registry

GOOD = Facts(
    versions={
        "jax": "0.10.1",
        "jaxlib": "0.10.1",
        "crazyflow": "0.4.0",
        "mujoco": "3.17.0",
        "mujoco-mjx": "3.17.0",
        "pandas": "3.1.1",
    },
    requirements={
        "fidelity-bench": ("jax!=0.10.2", "pandas>=2.2", 'ray; extra == "ray"'),
        "crazyflow": ("jax!=0.10.2,>=0.7.0",),
        "jax": ("jaxlib<=0.10.1,>=0.10.1",),
        "mujoco-mjx": ("mujoco>=3.17.0.dev0",),
    },
    variables={},
    modules=frozenset({"sys"}),
)


def with_versions(**versions):
    named = {name.replace("_", "-"): version for name, version in versions.items()}
    return dataclasses.replace(GOOD, versions={**GOOD.versions, **named})


def test_a_sound_installation_has_no_problem():
    assert problems(GOOD) == []
    assert problems(dataclasses.replace(GOOD, variables={"SCIPY_ARRAY_API": "1"})) == []
    named = {"fidelity-bench": ("typing_extensions", "typing.extensions>=4")}
    facts = with_versions(typing_extensions="4.9")
    assert problems(dataclasses.replace(facts, requirements=named)) == []


def test_each_package_comes_with_an_extra_or_always_and_those_of_developers_are_left_out():
    texts = ("jax", 'ray; extra == "ray"', 'tensorboardX>=2; extra == "tensorboard"')
    texts += ('pytest; extra == "dev"', 'mkdocs; extra == "docs"')
    facts = dataclasses.replace(GOOD, requirements={"fidelity-bench": texts})
    assert doctor.brought(facts) == {"jax": "", "ray": "ray", "tensorboardx": "tensorboard"}


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        (with_versions(jax="0.10.2"), "fidelity-bench needs jax!=0.10.2, but 0.10.2 is installed"),
        (with_versions(jax="0.10.2"), "crazyflow needs jax!=0.10.2,>=0.7.0, but 0.10.2"),
        (with_versions(mujoco="3.16.0"), "mujoco-mjx needs mujoco>=3.17.0.dev0, but 3.16.0"),
        (with_versions(jaxlib="0.11.0"), "pip install 'jaxlib<=0.10.1,>=0.10.1'"),
        (with_versions(pandas="2.1.0"), "fidelity-bench needs pandas>=2.2, but 2.1.0"),
        (dataclasses.replace(GOOD, versions={"jax": "0.10.1"}), "pandas>=2.2, which is not inst"),
        (
            dataclasses.replace(GOOD, modules=frozenset({"scipy"})),
            "SciPy was imported before crazyflow",
        ),
        (dataclasses.replace(GOOD, variables={"SCIPY_ARRAY_API": "0"}), "Set SCIPY_ARRAY_API=1"),
    ],
)
def test_a_known_bad_combination_is_named_with_its_remedy(facts, said):
    assert any(said in line for line in problems(facts)), problems(facts)


def test_the_order_of_imports_does_not_matter_once_the_variable_is_set():
    facts = dataclasses.replace(
        GOOD, modules=frozenset({"scipy"}), variables={"SCIPY_ARRAY_API": "1"}
    )
    assert problems(facts) == []


@pytest.fixture
def quick(monkeypatch):
    """No plug-ins are tried."""
    commands = registry.names("command")
    monkeypatch.setattr(registry, "names", lambda kind: commands if kind == "command" else [])
    monkeypatch.setenv("COLUMNS", "200")


def test_the_doctor_shows_versions_and_devices(quick, monkeypatch, capsys):
    monkeypatch.setattr(doctor, "gather", lambda: GOOD)
    assert main(["doctor"]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "jax 0.10.1" in lines
    assert "cpu 0 cpu" in lines
    assert "No problem found." in lines


def test_a_problem_is_the_exit_status(quick, monkeypatch, capsys):
    monkeypatch.setattr(doctor, "gather", lambda: with_versions(jax="0.10.2"))
    assert main(["doctor"]) == 1
    assert "Problem: crazyflow needs jax!=0.10.2" in capsys.readouterr().out


def test_the_facts_are_those_of_this_process(monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    facts = doctor.gather()
    assert facts.versions["crazyflow"] == "0.4.0"
    assert facts.variables["JAX_PLATFORMS"] == "cpu"
    assert any(text.startswith("jax") for text in facts.requirements["crazyflow"])


def test_a_broken_plugin_is_a_problem(plugins):
    found = []
    lines = dict(doctor.plugin_lines(found))
    assert "1 broken" in lines["methods"]
    assert any("'shattered'" in line and "cannot be imported" in line for line in found)
