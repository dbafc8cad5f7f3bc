"""What `bench import` takes, prints and refuses."""

import numpy as np
import pandas as pd
import pytest
from import_logs_for_tests import circle
from log_writers import write_usd

from bench.cli.app import main
from diagnosis.importing.crazyflie import LOGGED, crazyflie_streams
from diagnosis.importing.reader import FIELDS, Request
from diagnosis.importing.ulog import TOPICS
from diagnosis.logs.flights import load_flights

VEHICLE = ["--drone", "cf2x_L250", "--mass", "0.032"]


@pytest.fixture
def log(tmp_path):
    return write_usd(tmp_path / "log00", circle(), 0.48)


def test_a_log_becomes_a_folder_that_diagnose_reads(log, tmp_path, capsys):
    out = tmp_path / "deep" / "flown"
    assert main(["import", str(log), "--out", str(out), *VEHICLE]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["flights", "import.md", "vehicle.toml"]
    loaded = load_flights(out)
    assert (loaded.vehicle.name, loaded.vehicle.drone, loaded.vehicle.mass) == (
        "flown",
        "cf2x_L250",
        0.032,
    )
    printed = capsys.readouterr().out
    assert "log00: Crazyflie uSD log, 3.0 s, 750 rows, driven by cmd_angles and cmd_th" in printed
    assert f"Next: bench diagnose {out}" in printed
    report = (out / "import.md").read_text()
    assert (
        "| cmd_angles | controller.roll pitch yaw | degrees, pitch's sign changed | 250" in report
    )
    assert "motor.m1 to m4 was not logged" in report


def test_vehicle_toml_is_copied_as_it_is(log, tmp_path):
    text = '# weighed today\nname = "a"\ndrone = "cf2x_L250"\nmass = 0.033\n'
    (tmp_path / "mine.toml").write_text(text)
    arguments = ["--out", str(tmp_path / "o"), "--vehicle", str(tmp_path / "mine.toml")]
    assert main(["import", str(log), *arguments]) == 0
    assert (tmp_path / "o" / "vehicle.toml").read_text() == text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["LOG"], "Give at least one log, and the folder to write with --out."),
        (["--out", "OUT", *VEHICLE], "Give at least one log"),
        (["LOG", "--out", "OUT"], "Give either --vehicle FILE, or --drone and --mass."),
        (["LOG", "--out", "OUT", "--mass", "0.03"], "Give --drone and --mass together"),
        (["LOG", "--out", "OUT", "--drone", "cf9", "--mass", "0.03"], "key 'drone': got 'cf9'."),
        (["LOG", "--out", "OUT", *VEHICLE, "--format", "ulg"], "Did you mean 'ulog'?"),
        (["LOG", "--out", "OUT", *VEHICLE, "--full-thrust", "-1"], "must be above 0 N, got -1"),
        (["LOG", "--out", "OUT", *VEHICLE, "--above", "-1"], "must be at least 0 m, got -1"),
        (
            ["LOG", "--out", "OUT", *VEHICLE, "--above", "9"],
            "leaves nothing: the log's heights",
        ),
        (["LOG", "--out", "OUT", *VEHICLE, "--topic", "speed=/a"], "must be FIELD=/TOPIC with one"),
        (["MISSING", "--out", "OUT", *VEHICLE], "there is no such file or folder"),
        (["LOG", "--recipe", "px4"], "Leave out the sources"),
        (["--recipe", "px5"], "`--recipe` must be crazyflie or px4, got 'px5'"),
    ],
)
def test_a_wrong_request_gets_one_line(log, tmp_path, capsys, arguments, message):
    places = {"LOG": log, "OUT": tmp_path / "out", "MISSING": tmp_path / "nothing"}
    assert main(["import", *(str(places.get(a, a)) for a in arguments)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["log00"]


def test_what_the_crazyflies_recipe_logs_is_all_that_is_read(capsys):
    assert main(["import", "--recipe", "crazyflie"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("#")[0].strip() for line in lines[:7]] == [
        *("1", "512", "log", "0", "on:fixedFrequency", "250", "1"),
    ]
    logged = tuple(line.split("#")[0].strip() for line in lines[7:])
    assert logged == LOGGED
    t = np.arange(100.0)
    named = {name: pd.Series(0.5, t) for name in logged}
    streams, missing = crazyflie_streams(named, Request(mass=0.03, thrust_max=0.5))
    assert missing == []
    assert {stream.field for stream in streams} == set(FIELDS) - {"rotor_vel", "ang_vel", "acc"}


def test_what_px4s_recipe_logs_is_what_is_read(capsys):
    assert main(["import", "--recipe", "px4"]) == 0
    lines = [x for x in capsys.readouterr().out.splitlines() if not x.startswith("#")]
    assert {line.split()[0]: int(line.split()[1]) for line in lines} == TOPICS
