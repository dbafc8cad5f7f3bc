"""The folder of a remedy: parameters that can be loaded, flights that can be flown, kept texts.

`python tests/bench/test_remedy_files.py` writes the kept texts again.
"""

import dataclasses
import io
import json
import math
import sys
import tomllib
from pathlib import Path

import diagnoses_for_tests as made
import numpy as np
import pytest

from bench.cli.app import main
from bench.diagnosis_report.mending import writing
from bench.diagnosis_report.mending.flight_files import (
    mission,
    polynomial_csv,
    setpoint_csv,
    way_points,
)
from bench.diagnosis_report.mending.patch import patch_text
from bench.diagnosis_report.mending.px4_params import read_params
from bench.diagnosis_report.mending.remedy_text import TARGETS, remedy_text
from bench.diagnosis_report.mending.writing import FILES
from diagnosis.remedies.trajectory import Geofence, plan
from diagnosis.result import Effect, Parameter
from simulators import registry
from simulators.effects.card import load_cards
from simulators.vehicle import VEHICLES

KEPT = Path(__file__).parent / "kept" / "remedies.md"
FIRMWARE = [target for target in TARGETS if target != "crazyflow"]
PARAMS = """# Onboard parameters for Vehicle 1
# Vehicle-Id Component-Id Name Value Type
1\t1\tMC_BAT_SCALE_EN\t0\t6
1\t1\tMPC_THR_HOVER\t0.500000000000000000\t9
"""


def named(name, aliases=(), use="measured", **sizes):
    """A diagnosis that names one effect; its sizes are given with intervals of 10 %."""
    parameters = tuple(
        Parameter(
            name=key,
            value=value,
            low=min(0.9 * value, 1.1 * value),
            high=max(0.9 * value, 1.1 * value),
            unit="-",
            at_bound="no",
            use=use,
        )
        for key, value in sizes.items()
    )
    effect = Effect(
        name=name, blamed=True, probability=0.99, aliases=aliases, parameters=parameters
    )
    return dataclasses.replace(made.load(made.effect()), effects=(effect,))


@pytest.fixture
def place(tmp_path):
    """A folder with the diagnosis of a heavier drone."""
    (tmp_path / "diagnosis.json").write_text(json.dumps(made.effect()), encoding="utf-8")
    return tmp_path


def run(place, *options):
    return main(["diagnose", str(place / "diagnosis.json"), *options])


def loaded(path):
    """As crazyswarm2 loads a trajectory: 33 columns after one line of names."""
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(33), ndmin=2)


@pytest.mark.parametrize("target", TARGETS)
def test_a_remedy_is_written_beside_an_earlier_diagnosis(place, target, capsys):
    assert run(place, "--remedy", target) == 0
    folder = place / f"remedy-{target}"
    assert str(folder / "remedy.md") in capsys.readouterr().out
    files = {path.name for path in folder.iterdir()}
    assert files <= set(FILES)
    flight = "next_flight_setpoints.csv" if target == "px4" else "next_flight.csv"
    assert {"remedy.md", flight} <= files
    text = (folder / "remedy.md").read_text(encoding="utf-8")
    assert text.startswith("# What to change in ")
    assert "(3 x 3 x 2 m, with the origin on the floor, in its middle)" in text
    assert "times the thrust of hover" in text


@pytest.mark.parametrize("target", TARGETS)
def test_where_the_logs_come_first_no_flight_is_written(tmp_path, target):
    flip = {"part": "heading", "readings": ["turned"], "advice": "Check.", "evidence": []}
    found = made.unexplained() | {"interface": [flip]}
    (tmp_path / "diagnosis.json").write_text(json.dumps(found), encoding="utf-8")
    assert run(tmp_path, "--remedy", target) == 0
    folder = tmp_path / f"remedy-{target}"
    assert not [path for path in folder.iterdir() if "flight" in path.name]
    assert "mend the logs first" in (folder / "remedy.md").read_text(encoding="utf-8")


def test_the_folder_of_a_diagnosis_stands_for_it(place, capsys):
    assert main(["diagnose", str(place), "--remedy", "crazyflie"]) == 0
    assert (place / "remedy-crazyflie" / "remedy.md").is_file()
    assert str(place / "remedy-crazyflie" / "remedy.md") in capsys.readouterr().out


def test_a_remedy_goes_where_out_says(place, tmp_path):
    assert run(place, "--remedy", "px4", "--out", str(tmp_path / "there")) == 0
    assert (tmp_path / "there" / "remedy-px4" / "remedy.md").is_file()


def test_new_values_of_px4_are_written_with_those_that_it_has_now(place):
    (place / "now.params").write_text(PARAMS)
    assert run(place, "--remedy", "px4", "--parameters", str(place / "now.params")) == 0
    e = made.load(made.effect()).effects[0].parameter("e").value
    new = read_params(place / "remedy-px4" / "changed.params")
    assert new == pytest.approx({"MPC_THR_HOVER": 0.5 * (1 + e)})
    assert run(place, "--remedy", "px4") == 0
    assert not (place / "remedy-px4" / "changed.params").exists(), "an earlier one is taken away"


def test_a_plan_of_qgroundcontrol_lies_within_its_own_geofence(place):
    options = ("--remedy", "px4", "--home", "47.4,8.5", "--geofence", "8x6x3")
    assert run(place, *options) == 0
    content = json.loads((place / "remedy-px4" / "next_flight.plan").read_text())
    items = content["mission"]["items"]
    assert [items[0]["command"], items[-1]["command"]] == [22, 21]
    assert all(item["command"] == 16 for item in items[1:-1])
    (fence,) = content["geoFence"]["polygons"]
    corners = np.asarray(fence["polygon"])
    points = np.asarray([item["params"][4:6] for item in items])
    assert (points >= corners.min(axis=0)).all()
    assert (points <= corners.max(axis=0)).all()
    north, east = np.ptp(corners, axis=0) * 2 * np.pi * 6378137.0 / 360.0
    assert (north, east * math.cos(math.radians(47.4))) == pytest.approx((6.0, 8.0), rel=1e-3)


@pytest.mark.parametrize(
    ("path", "moves"),
    [("fast_lines", True), ("tumbling", True), ("hover", False), ("turning", False)],
)
def test_a_path_within_a_metre_has_no_way_points_for_a_mission(path, moves):
    assert (len(way_points(plan(path))) > 1) == moves


def test_the_remedy_says_why_there_is_no_mission(place, monkeypatch):
    monkeypatch.setattr(writing, "GENERAL", "hover")
    assert run(place, "--remedy", "px4", "--home", "47.4,8.5") == 0
    folder = place / "remedy-px4"
    assert not (folder / "next_flight.plan").exists()
    assert (
        "No mission is written: the path stays within a metre" in (folder / "remedy.md").read_text()
    )


def test_polynomials_and_setpoints_are_the_same_flight_in_two_frames(tmp_path):
    flight = plan("turning")
    t, values = flight.sampled(0.02)
    rows = loaded(io.StringIO(polynomial_csv(flight)))
    assert len(rows) <= 31
    assert rows[:, 0].sum() == pytest.approx(t[-1])
    middle = rows[10]
    assert np.polynomial.Polynomial(middle[17:25])(0.0) == pytest.approx(
        np.interp(rows[:10, 0].sum(), t, values[:, 2]), abs=1e-4
    )
    ned = np.loadtxt(io.StringIO(setpoint_csv(flight)), delimiter=",", skiprows=1)
    np.testing.assert_allclose(ned[:, 1:4], values[:, [1, 0, 2]] * [1, 1, -1], atol=1e-5)
    # A drone that looks to the east (x) has a heading of 90 degrees from the north.
    assert ned[0, 4] == pytest.approx(np.pi / 2, abs=1e-5)
    assert mission(flight, Geofence(), (0.0, 0.0)) == mission(flight, Geofence(), (0.0, 0.0))


def test_a_patch_holds_the_numbers_of_crazyflows_own_file():
    patch = tomllib.loads(patch_text(named("mass", e=0.1)))
    flown = made.load(made.effect()).flights
    assert patch == {flown.drone: {"mass": pytest.approx(1.1 * flown.mass)}}
    spec = VEHICLES[flown.drone]
    weaker = tomllib.loads(patch_text(named("thrust_gain", e=-0.1)))[flown.drone]
    assert weaker["rpm2thrust"]
    # crazyflow turns these into the range of its rotors' speeds, which stays as it was.
    assert weaker["thrust_max"] == pytest.approx(0.9 * spec.thrust_max / 4.0)
    assert weaker["thrust_min"] == pytest.approx(0.9 * spec.thrust_min / 4.0)


def test_an_effect_that_crazyflow_lacks_stands_beside_its_file():
    patch = tomllib.loads(patch_text(named("wind", x=0.5, y=0.0, z=0.0)))
    assert patch["effects"] == {"wind": {"x": 0.5, "y": 0.0, "z": 0.0}}
    fading = tomllib.loads(patch_text(named("battery", rate=0.004)))
    assert fading["effects"] == {"battery": {"rate": 0.004}}
    off = tomllib.loads(patch_text(named("center_of_mass", x=0.004, y=0.0)))
    assert off["effects"]["center_of_mass"]["x"] == 0.004


def test_a_change_that_waits_is_no_change():
    text = remedy_text(named("mass", aliases=("thrust_gain",), e=0.1), "crazyflie", {}, [])
    now, wait = text.split("## Do not change yet")
    assert "posCtlPid.thrustBase" in now
    assert "ctrlMel.mass" not in now
    assert "ctrlMel.mass" in wait
    assert "fast straight lines" in wait


@pytest.mark.parametrize("target", TARGETS)
def test_every_remedy_says_the_test_that_decides_between_what_looks_alike(target):
    text = remedy_text(named("thrust_gain", aliases=("mass",), e=-0.2), target, {}, [])
    first = (
        "irst look at the propellers, the battery, and how commands become newtons in these logs"
    )
    assert f"{first}. Also weigh the vehicle with its battery (if" in text


def test_a_remedy_does_not_ask_for_the_command_that_wrote_it(place):
    assert run(place, "--remedy", "crazyflow", "--geofence", "1x1x1.3") == 0
    text = (place / "remedy-crazyflow" / "remedy.md").read_text(encoding="utf-8")
    assert "--remedy" not in text
    assert "With more room, give it as --geofence." in text
    assert "\\" not in text


@pytest.mark.parametrize("kind", [made.partly, made.unexplained])
def test_numbers_that_may_be_biased_are_said_to_be(kind):
    found = made.load(kind())
    for target in FIRMWARE:
        text = remedy_text(found, target, {}, [])
        assert "## Change\n" not in text
        assert "Descriptive" in text or "|" not in text
    assert "# Descriptive" in patch_text(found)


def test_where_nothing_was_found_nothing_is_changed():
    text = remedy_text(made.load(made.none()), "px4", {}, [])
    assert "Nothing: these flights show no change beyond noise." in text
    assert "|" not in text


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--geofence", "3x3"], "must be numbers such as 3x3x2, got 3x3"),
        (["--geofence", "0.5x3x2"], "at least 1 m"),
        (["--home", "100,8"], "latitude"),
        (["--home", "47.4"], "must be numbers such as 47.397742,8.545594"),
        (["--parameters", "missing.params"], "missing.params"),
        (["--simulator", "crazyflow"], "with a diagnosis.json"),
    ],
)
def test_a_wrong_request_gets_one_line_and_writes_nothing(place, options, said, capsys):
    assert run(place, "--remedy", "px4", *options) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.splitlines()) == 1
    assert [path.name for path in place.iterdir()] == ["diagnosis.json"]


def test_what_is_no_diagnosis_gets_one_line(tmp_path, capsys):
    (tmp_path / "diagnosis.json").write_text("[]")
    assert run(tmp_path, "--remedy", "crazyflow") == 2
    assert "is no diagnosis" in capsys.readouterr().err
    unweighed = made.effect()
    unweighed["flights"]["mass"] = None
    (tmp_path / "diagnosis.json").write_text(json.dumps(unweighed))
    assert run(tmp_path, "--remedy", "crazyflow") == 2
    assert "does not say the vehicle's mass" in capsys.readouterr().err
    assert not (tmp_path / "remedy-crazyflow").exists()


def test_options_of_a_remedy_are_refused_without_one(place, capsys):
    assert main(["diagnose", str(place), "--home", "1,2"]) == 2
    assert "without --remedy" in capsys.readouterr().err
    assert run(place, "--remedy", "crazyflie", "--home", "1,2") == 2
    assert "without --remedy px4" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("MPC_THR_HOVER=0.5\n", "now.params, line 1"),
        ("1\t1\tMPC_THR_HOVER\tnan\t9\n", "now.params, line 1"),
        ("# nothing\n", "holds no parameter"),
    ],
)
def test_a_file_that_is_none_of_qgroundcontrols_is_refused(place, capsys, text, said):
    (place / "now.params").write_text(text)
    assert run(place, "--remedy", "px4", "--parameters", str(place / "now.params")) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("line", ["MPC_THR_HOVER\t0.95", "MPC_THR_HOVER\t0", "MPC_XY_P\t0.95"])
def test_a_share_beyond_one_or_a_missing_parameter_is_not_written(place, line):
    (place / "now.params").write_text(f"1\t1\t{line}\t9\n")
    assert run(place, "--remedy", "px4", "--parameters", str(place / "now.params")) == 0
    assert not (place / "remedy-px4" / "changed.params").exists()
    text = (place / "remedy-px4" / "remedy.md").read_text("utf-8")
    assert "No changed.params is written" in text


def texts():
    """What is said of every effect, at a tenth of the way to the upper end of its range."""
    parts = []
    for name, kind in registry.load_all("effect").items():
        if kind.card is None or not kind.__module__.startswith("simulators."):
            continue
        sizes = {key: _size(info) for key, info in kind.parameters.items()}
        for target in FIRMWARE:
            whole = remedy_text(named(name, **sizes), target, {}, []).split("## Fly next")[0]
            parts.append(f"# {name}, {target}\n\n" + whole.split("\n\n", 2)[2])
    return "\n".join(parts)


def _size(info):
    low = min(info.neutral, 100.0)
    return round(low + 0.1 * (info.high - low), 4) or 0.01


def test_every_effects_remedy_is_the_kept_one():
    assert texts() == KEPT.read_text(encoding="utf-8")
    assert len(load_cards()) > 20


if __name__ == "__main__":
    KEPT.write_text(texts(), encoding="utf-8")
    sys.stdout.write(f"{KEPT}\n")
