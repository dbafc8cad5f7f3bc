"""Errors say what was received and what is allowed."""

import importlib.metadata
import os
import subprocess
import sys

import jax.numpy as jnp
import pytest
from flying import KEY, SIMULATORS, positions

from simulators import registry

CMD = jnp.asarray([[0.0, 0.0, 0.0, 0.4]])


def step(name, duration):
    simulator = SIMULATORS[name]()
    return simulator.step_cmd(simulator.reset(positions(1), KEY), CMD, duration)


@pytest.mark.parametrize(
    ("name", "duration", "allowed"),
    [
        *(("crazyflow", x, "a positive multiple of 0.002 s") for x in (0.003, 0.0, -0.02, 0.0005)),
        *(("point_mass", x, "above 0 s") for x in (0.0, -0.02)),
    ],
)
def test_a_duration_that_cannot_be_flown_is_refused(name, duration, allowed):
    with pytest.raises(ValueError, match=rf"`duration` must be {allowed}, got {duration}\."):
        step(name, duration)


@pytest.mark.parametrize("duration", [0.004, 0.02, 0.033])
def test_the_point_mass_steps_by_any_positive_duration(duration):
    assert float(step("point_mass", duration).t) == pytest.approx(duration)


def test_crazyflow_steps_by_any_multiple_of_its_physics_step():
    assert int(step("crazyflow", 0.006).steps) == 3


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        (
            "task",
            "sprad",
            r"No task is registered as 'sprad'\. Did you mean 'spread'\? Registered: ",
        ),
        (
            "simulator",
            "pointmass",
            r"Did you mean 'point_mass'\? Registered: crazyflow, point_mass",
        ),
        ("effect", "xyz", r"No effect is registered as 'xyz'\. Registered: attitude_gain, "),
    ],
)
def test_an_unknown_plugin_is_answered_with_the_nearest_name(kind, name, message):
    with pytest.raises(registry.UnknownPluginError, match=message):
        registry.load(kind, name)


@pytest.fixture
def broken_effect(monkeypatch):
    """An entry point beside the real ones whose module does not exist."""
    real = registry._entry_points("effect")
    broken = importlib.metadata.EntryPoint("ghost", "no_such_module:Ghost", "bench.effects")
    monkeypatch.setattr(registry, "_entry_points", lambda kind: {**real, "ghost": broken})
    registry.load.cache_clear()
    yield
    registry.load.cache_clear()


@pytest.mark.usefixtures("broken_effect")
def test_a_broken_plugin_says_which_one_and_why():
    message = (
        r"The effect 'ghost' of unknown cannot be imported: ModuleNotFoundError: "
        r"No module named 'no_such_module'"
    )
    with pytest.raises(registry.BrokenPluginError, match=message):
        registry.load("effect", "ghost")


@pytest.mark.usefixtures("broken_effect")
def test_a_broken_plugin_is_named_in_a_warning_and_stops_nobody_else():
    with pytest.warns(UserWarning, match="The effect 'ghost' .* cannot be imported"):
        found = registry.load_all("effect")
    assert "ghost" not in found
    assert {"drag", "mass", "wind"} <= set(found)


def test_a_plugin_that_ends_the_program_is_broken_and_ends_nobody(tmp_path, monkeypatch):
    (tmp_path / "leaving_plugin.py").write_text("import sys\n\nsys.exit('no licence')\n")
    monkeypatch.syspath_prepend(tmp_path)
    leaving = importlib.metadata.EntryPoint("leaving", "leaving_plugin:Effect", "bench.effects")
    monkeypatch.setattr(registry, "_entry_points", lambda kind: {"leaving": leaving})
    registry.load.cache_clear()
    with pytest.raises(registry.BrokenPluginError, match=r"'leaving' .* SystemExit: no licence"):
        registry.load("effect", "leaving")
    registry.load.cache_clear()


def test_built_in_plugins_come_from_this_package():
    assert registry.distribution("simulator", "crazyflow").startswith("fidelity-bench ")


def loaded_after(first):
    """What comes of loading crazyflow in a new process that has imported `first`."""
    load = "from simulators import registry; registry.load('simulator', 'crazyflow')"
    free = {name: value for name, value in os.environ.items() if name != "SCIPY_ARRAY_API"}
    command = [sys.executable, "-c", f"import {first}; {load}"]
    return subprocess.run(command, capture_output=True, text=True, env=free)


def test_crazyflow_after_scipy_is_refused_with_what_to_do():
    done = loaded_after("scipy")
    assert done.returncode != 0
    assert "set SCIPY_ARRAY_API" in done.stderr


def test_crazyflow_after_a_part_of_the_harness_that_imports_scipy_is_loaded():
    assert loaded_after("bench.stats.statistics").returncode == 0
