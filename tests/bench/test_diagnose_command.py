"""What `bench diagnose` asks of the engine, and what it refuses before any work."""

import importlib
import subprocess
import sys
import types

import diagnoses_for_tests
import numpy as np
import pytest

from bench.cli.app import main
from bench.cli.checks import check_flights
from bench.diagnosis_report.documents import NAMES
from diagnosis.logs.columns import LogError
from diagnosis.logs.flights import DroneLog, FlightLog, VehicleFile, load_flights, write_flights

VEHICLE = 'name = "x"\ndrone = "cf2x_L250"\nmass = 0.032\n'


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


BAD_FOLDERS = {
    "no vehicle.toml": (None, "t\n", "vehicle.toml: there is no such file"),
    "no TOML": ("name = 3 =", "t\n", "this is not TOML"),
    "a typo": (VEHICLE.replace("mass", "mas"), "t\n", "Did you mean 'mass'?"),
    "no flights": (VEHICLE, None, "flights: there is no such folder"),
    "another name": (VEHICLE, "t,posx\n", "There is a column 'posx': did you mean 'pos_x'?"),
}


def test_what_names_and_headers_tell_is_told_before_jax_is_imported(tmp_path):
    for name, (vehicle, header, _) in BAD_FOLDERS.items():
        (tmp_path / name).mkdir()
        if vehicle is not None:
            (tmp_path / name / "vehicle.toml").write_text(vehicle)
        if header is not None:
            (tmp_path / name / "flights").mkdir()
            (tmp_path / name / "flights" / "a.csv").write_text(header)
    (tmp_path / "log.csv").write_text("t\n")
    calls = [["diagnose", name] for name in BAD_FOLDERS]
    given = ["--vehicle", "a typo/vehicle.toml", "--out", "out"]
    script = (
        "import sys; from bench.cli.app import main\n"
        f"for arguments in {[*calls, ['import', 'log.csv', *given]]!r}:\n"
        "    assert main(arguments) == 2, arguments\n"
        "assert not {'jax', 'equinox', 'pandas'} & set(sys.modules)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    for *_, message in BAD_FOLDERS.values():
        assert message in ran.stderr
    assert ran.stderr.count("bench: vehicle.toml: unknown key 'mas'") == 1


def test_the_check_before_the_work_says_what_loading_says(tmp_path):
    folder = tmp_path / "set"
    (folder / "flights").mkdir(parents=True)
    (folder / "vehicle.toml").write_text(VEHICLE)
    for name, text in {"a.csv": "t,posx\n", "b.txt": "", "c.csv": ""}.items():
        (folder / "flights" / name).write_text(text)
    with pytest.raises(LogError) as loading:
        load_flights(folder)
    with pytest.raises(LogError) as checking:
        check_flights([folder])
    assert str(checking.value) == str(loading.value)
    assert len(str(checking.value).splitlines()) == 3
    (folder / "flights" / "d.parquet").write_bytes(b"only loading reads it")
    check_flights([folder])


def test_an_earlier_diagnosis_without_remedy_says_to_add_it(engine, tmp_path, capsys):
    (tmp_path / "diagnosis.json").write_text("{}")
    for given in (tmp_path, tmp_path / "diagnosis.json"):
        assert main(["diagnose", str(given)]) == 2
        assert "add --remedy crazyflow, crazyflie or px4" in capsys.readouterr().err
    assert engine == []
