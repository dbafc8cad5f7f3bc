"""`bench diagnose --deploy`: what is asked for, and what its page says."""

import at_once
import pytest

from bench.cli.app import main
from bench.diagnosis_report import deploy as module
from bench.diagnosis_report.deploy import WAYS, closed, deploy
from bench.store.tables import Tables

DEPLOY = ["diagnose", "--deploy", "circle", "--reality", "crazyflow"]


def test_the_command_line_says_what_is_deployed(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(module, "deploy", lambda *args: asked.append(args) or 0)
    out = tmp_path / "out"
    assert main([*DEPLOY, "--team-size", "4", "--seeds", "2", "--out", str(out)]) == 0
    assert asked == [("circle", "crazyflow", 4, 2, out)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["diagnose"], "Give either a folder"),
        (["diagnose", "--deploy", "circle"], "Give either a folder"),
        (["diagnose", "--reality", "crazyflow"], "Give either a folder"),
        (["diagnose", "flights", *DEPLOY[1:]], "Give either a folder"),
        ([*DEPLOY, "--seeds", "0"], "`--seeds` must be 1 or more and `--team-size` 2 or more"),
        ([*DEPLOY, "--team-size", "0"], "`--team-size` 2 or more, got 1 and 0"),
    ],
)
def test_flights_and_deploy_exclude_each_other(monkeypatch, arguments, message, capsys):
    monkeypatch.setattr(module, "sweep", pytest.fail)
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert "bench:" in err
    assert message in err


@pytest.mark.parametrize("option", [("--simulator", "crazyflow"), ("--exclude", "drag")])
def test_options_of_a_diagnosis_are_refused_with_deploy(option, capsys):
    assert main(["diagnose", "--deploy", "circle", "--reality", "crazyflow", *option]) == 2
    assert f"Leave out {option[0]}: not used with --deploy" in capsys.readouterr().err


@pytest.mark.parametrize("world", ["crazyflow", "crazyflow+mass(e=0.2)"])
def test_all_ways_are_flown_in_the_reality(tmp_path, monkeypatch, world):
    at_once.install(monkeypatch, documents=False)
    assert deploy("spread", world, 2, 2, tmp_path) == 0
    text = (tmp_path / "deploy.md").read_text()
    lines = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")][2:]
    assert [line[0] for line in lines] == [f"| {way.label}" for way in WAYS]
    assert all(line[-1].startswith("2 budget") for line in lines)
    assert ("its training is not billed" in text) == ("+" in world)
    assert [lines[i][2] for i in (0, -1)] in ([["0 %", "100 %"], ["-", "-"]])
    named = {text for text in Tables.load(tmp_path).runs["variant"] if text}
    kinds = {"deployed_in", "reality"} if "+" in world else set()
    assert named == {f"{kind}=crazyflow+Mass(e=0.2)" for kind in kinds}


def test_a_gap_is_closed_over_the_seeds_that_all_have():
    low, way, other, high = WAYS
    returns = {
        low: {0: -80.0, 1: -90.0, 2: -100.0},
        way: {0: -65.0, 1: -75.0},
        other: {},
        high: {0: -60.0, 1: -70.0, 2: -80.0},
    }
    assert closed(returns) == {low: 0.0, way: pytest.approx(0.75), high: 1.0}
    assert closed(returns | {high: {0: -80.0, 1: -90.0}}) == {}  # a hot start that is no better
