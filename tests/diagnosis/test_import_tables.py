"""Any table becomes a flight, where columns.toml says what its columns are."""

import numpy as np
import pandas as pd
import pytest
from import_logs_for_tests import VEHICLE, circle
from log_writers import aerospace
from scipy.spatial.transform import Rotation

from diagnosis.importing.convert import import_logs
from diagnosis.importing.report import import_report
from diagnosis.logs.flights import load_flights

COLUMNS = """
time = {column = "stamp", unit = "us"}
world = "NED"
body = "FRD"

[columns]
pos_x = {column = "north", unit = "mm"}
pos_y = {column = "east", unit = "mm"}
pos_z = {column = "height", unit = "mm", sign = -1}
vel_x = "vn"
vel_y = "ve"
vel_z = "vd"
quat_x = "q1"
quat_y = "q2"
quat_z = "q3"
quat_w = "q0"
cmd_roll = {column = "roll sp", unit = "deg"}
cmd_pitch = {column = "pitch sp", unit = "deg"}
cmd_yaw = {column = "heading sp", unit = "deg"}
cmd_thrust = {column = "thrust", unit = "gf"}
"""


def write(folder, log, columns=COLUMNS):
    """A table as a script might write it: aerospace frames, odd units, slow positions."""
    quat = aerospace(log.quat)
    asked = aerospace(Rotation.from_euler("xyz", log.cmd[:, :3]).as_quat())
    sp = np.degrees(Rotation.from_quat(asked[:, [1, 2, 3, 0]]).as_euler("xyz"))
    slow = np.arange(len(log.t)) % 5 != 0
    frame = pd.DataFrame({"stamp": np.round((log.t + 3.0) * 1e6)})
    frame["north"], frame["east"], frame["height"] = (log.pos[:, [1, 0, 2]] * 1e3).T
    frame["vn"], frame["ve"], frame["vd"] = (log.vel[:, [1, 0, 2]] * [1, 1, -1]).T
    frame.loc[slow, ["north", "east", "height", "vn", "ve", "vd"]] = np.nan
    frame[["q0", "q1", "q2", "q3"]] = quat
    frame[["roll sp", "pitch sp", "heading sp"]] = sp
    frame["thrust"] = log.cmd[:, 3] / 9.81e-3
    frame.to_csv(folder / "flight.csv", index=False)
    (folder / "columns.toml").write_text(columns)
    return folder / "flight.csv"


def test_units_and_frames_are_turned_into_ours(tmp_path):
    log = circle()
    found = import_logs([write(tmp_path, log)], tmp_path / "out", VEHICLE)
    ((drone,),) = (flight.drones for flight in load_flights(tmp_path / "out").flights)
    at = np.searchsorted(log.t, drone.t - 1e-6)
    np.testing.assert_allclose(drone.pos, log.pos[at], atol=1e-6)
    np.testing.assert_allclose(drone.vel, log.vel[at], atol=1e-6)
    held = np.stack([log.cmd[np.minimum(at + i, len(log.t) - 1)] for i in range(5)]).mean(axis=0)
    np.testing.assert_allclose(drone.cmd[:-1], held[:-1], atol=1e-6)
    turn = Rotation.from_quat(drone.quat).inv() * Rotation.from_quat(log.quat[at])
    assert turn.magnitude().max() < 1e-6
    changes = {t.field: t.change for t in next(iter(found.flights[0].drones.values())).taken}
    assert changes["pos"] == "mm to m, sign changed, NED to ENU"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"vn"', '"vnn"', "the table has no column 'vnn' for 'vel_x'. Did you mean 'vn'?"),
        ("world =", "wrold =", "unknown key 'wrold'. Did you mean 'world'?"),
        ('"NED"', '"NWU"', "world must be ENU or NED, got 'NWU'"),
        ("sign = -1", "sign = 2", "sign of 'pos_z' must be 1 or -1, got 2"),
        ('vel_z = "vd"\n', "", "'vel_z' is missing beside 'vel_x' in [columns]"),
        ('unit = "gf"', 'unit = "gff"', "'cmd_thrust' has the unit 'gff'; allowed: N, mN, gf,"),
        ('unit = "us"', 'units = "us"', "unknown key 'units'. Did you mean 'unit'?"),
        ('"vn"', "7", "'vel_x' must name a column of the table, got 7"),
        ('unit = "gf"', 'unit = ["gf"]', "unit of 'cmd_thrust' must be a text, got ['gf']"),
        ("[columns]", "[columns", "this is not TOML"),
        ("[columns]\n", '[columns]\nroll = "r"\n', "'quat_x' and 'roll' both give the attitude"),
        ('time = {column = "stamp", unit = "us"}', "", "key 'time' is missing"),
    ],
)
def test_a_mistake_in_columns_toml_is_named(tmp_path, old, new, message):
    assert old in COLUMNS
    file = write(tmp_path, circle(), COLUMNS.replace(old, new, 1))
    with pytest.raises(ValueError, match=r"columns\.toml: ") as caught:
        import_logs([file], tmp_path / "out", VEHICLE)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[: text.rindex(",")], "the last row has 14 of 15 cells"),
        (lambda text: text[: text.index("\n") + 1], "the table has no rows"),
    ],
)
def test_a_table_that_breaks_off_is_refused(tmp_path, change, message):
    file = write(tmp_path, circle())
    file.write_text(change(file.read_text()))
    with pytest.raises(ValueError, match=message):
        import_logs([file], tmp_path / "out", VEHICLE)


def test_a_quaternion_that_is_too_long_is_refused_in_any_frame(tmp_path):
    """Turning it into another frame does not hide it."""
    file = write(tmp_path, circle())
    frame = pd.read_csv(file)
    frame[["q0", "q1", "q2", "q3"]] *= 1.2
    frame.to_csv(file, index=False)
    with pytest.raises(ValueError, match=r"a quaternion has the norm 1\.2; 1 is expected"):
        import_logs([file], tmp_path / "out", VEHICLE)


def test_the_rows_before_a_broken_one_are_used_on_request(tmp_path):
    file = write(tmp_path, circle())
    file.write_text(file.read_text()[:-3].rpartition(",")[0])
    assert import_logs([file], tmp_path / "out", VEHICLE, truncated=True).flights


def test_a_mistake_in_what_flew_names_no_temporary_file(tmp_path):
    with pytest.raises(ValueError, match="mass") as caught:
        import_logs([write(tmp_path, circle())], tmp_path / "out", 'name = "x"\nmass = -1.0')
    assert str(caught.value).startswith("vehicle.toml: ")


def test_a_table_without_columns_toml_is_of_no_known_format(tmp_path):
    file = write(tmp_path, circle())
    (tmp_path / "columns.toml").rename(tmp_path / "elsewhere.toml")
    with pytest.raises(ValueError, match="of no known format"):
        import_logs([file], tmp_path / "out", VEHICLE)
    columns = tmp_path / "elsewhere.toml"
    assert import_logs([file], tmp_path / "out", VEHICLE, columns=columns).flights


def test_each_refused_table_is_named_with_its_own_reason(tmp_path):
    """The sources do not stand in order of the alphabet."""
    good = pd.read_csv(write(tmp_path, circle()))
    speeds = {name: 1e3 * good[name] for name in ("vn", "ve", "vd")}
    changes = {"b": speeds, "a": {"thrust": 1e3 * good["thrust"]}}
    for name, change in changes.items():
        good.assign(**change).to_csv(tmp_path / f"{name}.csv", index=False)
    with pytest.raises(ValueError, match="newtons") as caught:
        import_logs([tmp_path / f"{name}.csv" for name in changes], tmp_path / "out", VEHICLE)
    lines = sorted(str(caught.value).splitlines())
    assert [line[: line.index(":")] for line in lines] == ["a.csv", "b.csv"]
    assert lines[0].startswith("a.csv: column 'cmd_thrust': the median")
    assert lines[1].startswith("b.csv: columns vel_x to vel_z: velocities say")


def test_a_table_without_any_attitude_stops_no_other(tmp_path):
    good = write(tmp_path, circle())
    bad = tmp_path / "zeros.csv"
    zeros = dict.fromkeys(("q0", "q1", "q2", "q3"), 0.0)
    pd.read_csv(good).assign(**zeros).to_csv(bad, index=False)
    found = import_logs([bad, good], tmp_path / "out", VEHICLE)
    assert [flight.name for flight in found.flights] == ["flight"]
    (left,) = found.left_out
    assert "zeros.csv: no attitude was found" in left.reason


RATES = """
ang_vel_x = "gx"
ang_vel_y = "gy"
ang_vel_z = "gz"
"""


def test_the_report_says_what_an_empty_column_and_empty_cells_cost(tmp_path):
    """Positions stand in every fifth of 750 rows; eleven of these lack the north, two the time."""
    file = write(tmp_path, circle(), COLUMNS + RATES)
    frame = pd.read_csv(file).assign(gx=np.nan, gy=0.1, gz=0.1)
    frame.loc[100:150:5, "north"] = np.nan
    frame.loc[[201, 202], "stamp"] = np.nan
    frame.loc[301, "thrust"] = np.inf
    frame.to_csv(file, index=False)
    found = import_logs([file], tmp_path / "out", VEHICLE)
    (rows,) = found.flights[0].drones.values()
    dropped = {taken.field: taken.dropped for taken in rows.taken}
    assert dropped == {"pos": 611, "vel": 600, "quat": 2, "cmd_angles": 2, "cmd_thrust": 3}
    report = import_report(found)
    assert report == (tmp_path / "out" / "import.md").read_text()
    assert "cubic splines at 50 Hz, 611 empty or dropped |" in report
    assert "- ang_vel (gx, gy, gz) is left out, because 0 of its 750 rows are usable" in report


def test_a_required_column_without_numbers_is_named(tmp_path):
    file = write(tmp_path, circle())
    pd.read_csv(file).assign(north=np.nan).to_csv(file, index=False)
    with pytest.raises(ValueError, match="no position was found") as caught:
        import_logs([file], tmp_path / "out", VEHICLE)
    assert "pos (north, east, height) is left out, because 0 of its 750" in str(caught.value)


@pytest.mark.parametrize(("sep", "decimal"), [(";", ","), (";", "."), ("\t", ","), ("\t", ".")])
def test_other_separators_and_decimal_commas_are_read(tmp_path, sep, decimal):
    file = write(tmp_path, circle())
    import_logs([file], tmp_path / "plain", VEHICLE)
    pd.read_csv(file).to_csv(file, index=False, sep=sep, decimal=decimal)
    import_logs([file], tmp_path / "other", VEHICLE)
    plain, other = (
        load_flights(tmp_path / name).flights[0].drones[0] for name in ("plain", "other")
    )
    np.testing.assert_allclose(other.pos, plain.pos, atol=1e-9)
    file.write_text(file.read_text()[:-3].rpartition(sep)[0])
    with pytest.raises(ValueError, match="cells; is the file truncated"):
        import_logs([file], tmp_path / "cut", VEHICLE)
