"""What `bench diagnose` asks of the engine, and what it refuses before any work."""

import importlib
import sys
import types

import diagnoses_for_tests
import numpy as np
import pytest

from bench.cli.app import main
from bench.diagnosis_report.documents import NAMES
from diagnosis.logs.flights import DroneLog, FlightLog, VehicleFile, write_flights


@pytest.fixture
def engine(monkeypatch):
    """Stands in for the engine, remembers what it was asked, and answers with one effect."""
    asked = []

    def diagnose(flights, **options):
        asked.append((flights, options))
        options["progress"]("fitting", 0.5)
        return diagnoses_for_tests.load(diagnoses_for_tests.effect())

    fake = types.ModuleType("diagnosis.engine")
    fake.diagnose = diagnose
    monkeypatch.setitem(sys.modules, "diagnosis.engine", fake)
    monkeypatch.delitem(sys.modules, "bench.diagnosis_report.command", raising=False)
    importlib.import_module("bench.diagnosis_report.command")
    yield asked
    sys.modules.pop("bench.diagnosis_report.command", None)


@pytest.fixture
def flights(tmp_path):
    """A folder with one flight that hovers, a micrometre to and fro."""
    t = 0.02 * np.arange(200)
    zero = np.zeros((200, 3))
    pos = np.stack([1e-6 * np.sin(t), zero[:, 0], zero[:, 0] + 1.0], axis=1)
    up = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    cmd = np.tile([0.0, 0.0, 0.0, 0.425], (200, 1))
    log = DroneLog(t=t, pos=pos, vel=zero, quat=up, cmd=cmd)
    vehicle = VehicleFile("mine", "cf21B_500", 0.0434)
    folder = tmp_path / "hover"
    write_flights(folder, vehicle, [FlightLog("one", (log,))])
    return folder


def test_diagnose_writes_to_the_reports_by_default(engine, flights, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["diagnose", "hover", "--reference", "hover", "--exclude", "drag"]) == 0
    place = tmp_path / "reports" / "diagnosis" / "hover"
    assert sorted(p.name for p in place.iterdir()) == sorted(NAMES)
    ((loaded, options),) = engine
    assert [flight.name for flight in loaded.flights] == ["one"]
    assert options["simulator"] is None  # the airframe decides
    assert options["exclude"] == ("drag",)
    assert options["reference"].path == loaded.path
    out, err = capsys.readouterr()
    assert "mass" in out
    assert "fitting" in err


def test_diagnose_writes_to_the_folder_that_was_asked_for(engine, flights, tmp_path):
    out = tmp_path / "a" / "b"
    assert main(["diagnose", str(flights), "--simulator", "point_mass", "--out", str(out)]) == 0
    assert (out / "diagnosis.html").is_file()
    assert engine[0][1]["simulator"] == "point_mass"
    assert engine[0][1]["reference"] is None


def test_a_diagnosis_that_is_replaced_is_named(engine, flights, tmp_path, capsys):
    out = tmp_path / "out"
    for expected in (0, 1):
        assert main(["diagnose", str(flights), "--out", str(out)]) == 0
        assert capsys.readouterr().err.count("The diagnosis that was there is replaced") == expected


def test_bad_logs_get_a_line_each_and_nothing_is_written(engine, flights, tmp_path, capsys):
    (flights / "flights" / "one.parquet").write_text("no parquet")
    (flights / "flights" / "two.csv").write_text("t,pos_x\n0,0\n")
    before = sorted(tmp_path.rglob("*"))
    assert main(["diagnose", str(flights), "--out", str(tmp_path / "out")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "flights/one.parquet: " in lines[0]
    assert "flights/two.csv: " in lines[1]
    assert sorted(tmp_path.rglob("*")) == before
    assert engine == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--simulator", "crazyflw"], "Did you mean 'crazyflow'?"),
        (["--exclude", "drg"], "Did you mean 'drag'?"),
        (["--out", "hover/vehicle.toml"], "is not a folder"),
        (["--out", "hover/vehicle.toml/deeper"], "is not a folder"),
        (["--refrence", "hover"], "Did you mean --reference?"),
        (["--seeds", "3"], "Leave out --seeds: not used without --deploy"),
    ],
)
def test_a_wrong_request_gets_one_line_before_any_work(
    engine, flights, tmp_path, monkeypatch, capsys, arguments, message
):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert main(["diagnose", "hover", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before
    assert engine == []
