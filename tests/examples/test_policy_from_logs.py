"""From logs of a drone to a policy for a team: both scripts, and the code of docs/policy.md."""

import json
import runpy
import sys
from pathlib import Path

import diagnoses_for_tests
import jax
import numpy as np
import pytest

from diagnosis.logs.flights import load_flights
from methods.training.policy import make_policy
from simulators.point_mass import PointMass
from simulators.vehicle import GRAVITY
from tasks.circle import Circle
from tests.docs.blocks import blocks

ROOT = Path(__file__).parents[2]


def script(name, monkeypatch, *arguments):
    """Runs a script of examples/ as its users do."""
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    return runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")


def test_simulated_logs_are_those_of_the_vehicle_that_was_asked_for(tmp_path, monkeypatch):
    asked = ("point_mass+mass(e=0.2)", str(tmp_path / "heavy"), "--flights", "2")
    script("simulated_flights.py", monkeypatch, *asked, "--seconds", "4")
    found = load_flights(tmp_path / "heavy")
    assert len(found.flights) == 2
    for flight in found.flights:
        log = flight.drones[0]
        assert len(log.t) == 200
        # Level and at rest on average, such a drone needs 1.2 times the believed weight.
        share = np.mean(log.cmd[50:, 3]) / (found.vehicle.mass * GRAVITY)
        assert share == pytest.approx(1.2, abs=0.05)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["point_mass+mas(e=0.2)"], "Did you mean 'mass'"),
        (["point_mass+mass"], "is no effect"),
        (["point_mass", "--flights", "0"], "must be at least 1"),
        (["point_mass", "--seconds", "0.01"], "must be at least 1"),
    ],
)
def test_flights_that_cannot_be_simulated_are_answered_in_a_line(
    asked, said, tmp_path, monkeypatch, capsys
):
    reality, *options = asked
    with pytest.raises(SystemExit):
        script("simulated_flights.py", monkeypatch, reality, str(tmp_path / "new"), *options)
    assert said in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_policy_is_trained_on_a_diagnosis_and_flown(tmp_path, monkeypatch, capsys):
    content = diagnoses_for_tests.effect()
    content["settings"]["simulator"] = "point_mass"
    (tmp_path / "diagnosis.json").write_text(json.dumps(content), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    asked = ("diagnosis.json", "--team-size", "2", "--epochs", "1")
    script("policy_from_logs.py", monkeypatch, *asked, "--reality", "point_mass")
    out = capsys.readouterr().out
    assert "Settled reward in the corrected point mass: -" in out
    assert "Settled reward in point_mass: -" in out
    with np.load("policy.npz", allow_pickle=False) as policy:
        assert policy["w2"].shape == (3, 128)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["nowhere.json"], "No such file"),
        (["diagnosis.json", "--epochs", "0"], "`epochs` must be at least 1"),
        (["diagnosis.json", "--team-size", "1"], "`n_drones` must be at least 2"),
        (["diagnosis.json", "--out", "nowhere/policy.npz"], "there is no folder"),
        (["unexplained.json"], "no effect is confirmed"),
    ],
)
def test_what_cannot_be_trained_is_answered_in_a_line(asked, said, tmp_path, monkeypatch, capsys):
    made = {
        "diagnosis": diagnoses_for_tests.effect(),
        "unexplained": diagnoses_for_tests.unexplained(),
    }
    for name, content in made.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        script("policy_from_logs.py", monkeypatch, *asked)
    assert said in capsys.readouterr().err


def test_the_code_of_the_page_commands_what_the_policy_does(tmp_path, monkeypatch, key):
    monkeypatch.setattr(sys, "argv", ["policy_from_logs.py"])
    names = runpy.run_path(str(ROOT / "examples" / "policy_from_logs.py"))
    simulator, task = PointMass(), Circle(n_drones=3)
    space = simulator.action_space
    policy = make_policy(task, simulator.spec, space, key)
    np.savez(tmp_path / "policy.npz", **names["weights"](policy), **names["scales"](simulator))
    monkeypatch.chdir(tmp_path)
    (code,) = blocks(ROOT / "docs" / "policy.md", "python")
    page: dict = {}
    exec(code, page)
    obs = jax.random.normal(key, (3, task.obs_size))
    own = [page["command"](row) for row in np.asarray(obs)]
    np.testing.assert_allclose(own, space.to_cmd(policy(obs)), atol=1e-5)
