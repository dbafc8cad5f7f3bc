"""`bench diagnose --deploy`: the reality as text, and what its table says."""

import json

import pytest
from rich.console import Console

from bench.cli.app import main
from bench.diagnosis_report import deploy as module
from bench.diagnosis_report.deploy import deploy, parse_reality
from bench.stats.statistics import Entry
from bench.text.errors import UsageError
from methods.lf_baseline import LFBaseline
from methods.training.bptt import BPTT
from simulators.registry import UnknownPluginError


def test_a_reality_is_a_simulator_with_effects():
    reality = parse_reality("crazyflow+mass(e=0.2)+wind(x=1, y=-0.5)")
    assert reality.name == "crazyflow"
    found = {type(e).__name__: e for e in reality.effects}
    assert float(found["Mass"].e) == pytest.approx(0.2)
    assert float(found["Wind"].y) == pytest.approx(-0.5)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("crazyflow+mass", "is no effect; write NAME"),
        ("crazyflow+mass(q=1)", "its parameters are e"),
        ("crazyflow+mass(e=lots)", "each with a number"),
        ("crazyflow+mass(e=nan)", "each with a number"),
        ("crazyflow+attitude_loop(damping=1)", "does not have"),
        ("crazyflow+mass(e=-1)", r"e of 'mass' must lie in \[-0.3, 0.6\], got -1"),
        ("crazyflow+delay(seconds=0.15)", r"must lie in \[0, 0.1\]"),
    ],
)
def test_a_reality_that_makes_no_sense_is_refused(text, match):
    with pytest.raises(UsageError, match=match):
        parse_reality(text)


def test_a_folder_that_cannot_be_written_to_is_refused_before_any_training(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_seed", pytest.fail)
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="file is not a folder"):
        deploy("circle", "crazyflow", 2, 1, tmp_path / "file", Console(quiet=True))


def test_a_seed_that_fails_leaves_the_others_results(tmp_path, monkeypatch):
    def fly(task, reality, seed, console):
        if seed == 1:
            raise ValueError("a drone never left the ground")
        row = {
            "settled_reward": -0.5,
            "reward": -1.0,
            "crashes": 0.0,
            "fleet_minutes": 0.0,
            "train_seconds": 1.0,
        }
        ways = [way.label for way in module.WAYS]
        return [row | {"way": w, "seed": 0, "status": "ok", "effects": ""} for w in ways]

    monkeypatch.setattr(module, "_seed", fly)
    with pytest.raises(ValueError, match="never left"):
        deploy("circle", "crazyflow", 2, 2, tmp_path, Console(quiet=True))
    assert len(json.loads((tmp_path / "deploy.json").read_text())["runs"]) == 4
    assert "Mean over 1 seed;" in (tmp_path / "deploy.md").read_text()


def test_an_unknown_effect_is_named():
    with pytest.raises(UnknownPluginError, match="Did you mean 'mass'"):
        parse_reality("crazyflow+mas(e=0.2)")


DEPLOY = ["diagnose", "--deploy", "circle", "--reality", "crazyflow"]


def test_the_command_line_says_what_is_deployed(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(module, "deploy", lambda *args: asked.append(args) or 0)
    out = tmp_path / "out"
    assert main([*DEPLOY, "--team-size", "4", "--seeds", "2", "--out", str(out)]) == 0
    ((*request, console),) = asked
    assert request == ["circle", "crazyflow", 4, 2, out]
    assert isinstance(console, Console)


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
    monkeypatch.setattr(module, "_seed", pytest.fail)
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert "bench:" in err
    assert message in err


@pytest.mark.parametrize("option", [("--simulator", "crazyflow"), ("--exclude", "drag")])
def test_options_of_a_diagnosis_are_refused_with_deploy(option, capsys):
    assert main(["diagnose", "--deploy", "circle", "--reality", "crazyflow", *option]) == 2
    assert f"Leave out {option[0]}: not used with --deploy" in capsys.readouterr().err


def test_what_diverged_counts_with_the_policy_that_it_left(tmp_path):
    def row(way, seed, reward, status="ok"):
        numbers = {"settled_reward": reward, "reward": -100.0, "crashes": 0.0}
        numbers |= {"fleet_minutes": 1.0, "train_seconds": 2.0}
        return {"way": way, "seed": seed, "status": status, "effects": "", **numbers}

    rows = [
        *(row("lf_baseline", seed, -80.0 - 10.0 * seed) for seed in range(3)),
        *(row("hf_hotstart", seed, -60.0 - 10.0 * seed, "budget") for seed in range(3)),
        *(row("grey_box", seed, -65.0 - 10.0 * seed) for seed in range(2)),
        row("grey_box", 2, -85.0, "diverged"),
        *(row("hybrid (mlp)", seed, None, "diverged") for seed in range(3)),
    ]
    ways = {line["way"]: line for line in module._summary(rows)}
    assert ways["grey_box"]["settled_reward"] == pytest.approx(-75.0)
    assert ways["grey_box"]["closed"] == pytest.approx(0.75)
    assert ways["grey_box"]["diverged"] == 1
    assert ways["hybrid (mlp)"]["settled_reward"] is ways["hybrid (mlp)"]["closed"] is None
    content = {"task": "circle", "team_size": 3, "reality": "crazyflow", "runs": rows}
    text = module._markdown(content | {"ways": list(ways.values())})
    assert "| grey_box, 1 diverged | -75.0 | 75 % | -100.0 |" in text
    assert "| hybrid (mlp), 3 diverged | - |" in text


def test_a_hot_start_that_is_no_better_leaves_no_gap_to_close():
    numbers = {"crashes": 0.0, "fleet_minutes": 1.0, "train_seconds": 2.0, "status": "ok"}
    numbers |= {"reward": -100.0}
    returns = {"lf_baseline": -70.0, "grey_box": -80.0, "hf_hotstart": -75.0}
    rows = [{"way": way, "seed": 0, "settled_reward": x, **numbers} for way, x in returns.items()]
    assert [line["closed"] for line in module._summary(rows)] == [None] * 3


def test_every_way_is_trained_and_its_share_of_the_gap_stated(tmp_path, monkeypatch):
    """With one method under two names, so that the table is what is tested."""
    short = LFBaseline(trainer=BPTT(epochs=2, n_worlds=2))
    monkeypatch.setattr(module, "WAYS", (Entry("lf_baseline"), Entry("hf_hotstart")))
    load = module.registry.load
    fake = lambda kind, name: (lambda: short) if kind == "method" else load(kind, name)  # noqa: E731
    monkeypatch.setattr(module.registry, "load", fake)
    assert deploy("spread", "point_mass+drag(c=1)", 2, 1, tmp_path, Console(quiet=True)) == 0
    content = json.loads((tmp_path / "deploy.json").read_text())
    assert [line["way"] for line in content["ways"]] == ["lf_baseline", "hf_hotstart"]
    assert content["reality"] == "point_mass+Drag(c=1)"
    for name in ("settled_reward", "reward"):
        rewards = [line[name] for line in content["ways"]]
        assert rewards[0] == rewards[1] < 0
    assert content["ways"][0]["reward"] < content["ways"][0]["settled_reward"]
    assert content["ways"][0]["closed"] is None
    assert "| lf_baseline |" in (tmp_path / "deploy.md").read_text()
