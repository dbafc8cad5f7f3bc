"""Every way in which a log can be wrong is named in one line, beside a good one that is used."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_tables import changed, examples, folder, put, save, scaled, table, why_left_out

from diagnosis.logs.columns import GROUPS, KNOWN
from diagnosis.logs.flights import load_flights
from simulators.vehicle import GRAVITY

MANY = examples(25)


@MANY
@given(
    column=st.sampled_from([name for name in KNOWN if name != "drone"]),
    row=st.integers(1, 400),
    value=st.sampled_from([np.nan, np.inf, -np.inf, "oops"]),
    ending=st.sampled_from(["parquet", "csv"]),
)
def test_a_cell_without_a_number_is_named(tmp_path_factory, column, row, value, ending):
    frame = changed(**{column: {row: value}})
    got = why_left_out(tmp_path_factory.mktemp("set"), frame, f"bad.{ending}")
    what = {"nan": "NaN or empty", "oops": "the text 'oops'"}.get(str(value), "infinite")
    assert f"column '{column}', row {row}: {what}; a" in got
    assert "number is expected" in got


@MANY
@given(row=st.integers(2, 400), back=st.sampled_from([0.0, 0.004, 100.0]), drones=st.booleans())
def test_time_that_does_not_increase_is_named(tmp_path_factory, row, back, drones):
    frame = table()
    frame.loc[row - 1, "t"] = frame.loc[row - 2, "t"] - back
    who = ""
    if drones:
        frame = pd.concat([table().assign(drone=0), frame.assign(drone=1)])
        row, who = row + 400, " of drone 1"
    what = "goes backwards" if back else "is repeated"
    got = why_left_out(tmp_path_factory.mktemp("set"), frame)
    assert f"column 't', row {row}: time{who} {what}" in got
    assert "must increase from row to row" in got


@MANY
@given(
    group=st.sampled_from(
        ["cmd_roll", "cmd_pitch", "cmd_thrust", "ang_vel_x", "vel_y", "rotor_vel_3", "pwm_2"]
    ),
    row=st.integers(1, 400),
)
def test_one_value_that_cannot_be_is_named(tmp_path_factory, group, row):
    value = {"cmd_roll": -4.0, "cmd_pitch": 35.0, "ang_vel_x": 61.0, "vel_y": -51.0}
    value |= {"rotor_vel_3": 21000.0, "pwm_2": 1.2, "cmd_thrust": -5.0 if row % 2 else 500.0}
    got = why_left_out(tmp_path_factory.mktemp("set"), changed(**{group: {row: value[group]}}))
    assert f"column '{group}', row {row}: {value[group]:g}; " in got
    assert "is expected" in got


BAD_TABLES = {
    "missing": (table().drop(columns="pos_x"), "column 'pos_x' is missing. Required: t, pos_x"),
    "missing two": (
        table().drop(columns=["t", "quat_w"]),
        "columns 't', 'quat_w' are missing. Required: t,",
    ),
    "near miss": (
        table().rename(columns={"pos_x": "posx"}),
        "column 'pos_x' is missing. There is a column 'posx': did you mean 'pos_x'?",
    ),
    "near miss in a group": (
        table().rename(columns={"cmd_roll": "cmd_rol"}),
        "column 'cmd_roll' is missing. There is a column 'cmd_rol': did you mean 'cmd_roll'? With "
        "cmd_pitch, cmd_yaw,",
    ),
    "part of a group": (table().drop(columns="acc_y"), "column 'acc_y' is missing. With acc_x"),
    "no input": (
        table().drop(columns=[*GROUPS["cmd"], *GROUPS["pwm"], *GROUPS["rotor_vel"]]),
        "no input is there: cmd_roll, cmd_pitch, cmd_yaw and cmd_thrust are expected, or cmd_th",
    ),
    "misspelt angles": (
        table().rename(columns={f"cmd_{x}": f"command_{x}" for x in ("roll", "pitch", "yaw")}),
        "columns 'cmd_roll', 'cmd_pitch', 'cmd_yaw' are missing. There is a column 'command_roll': "
        "did you mean 'cmd_roll'?",
    ),
    "pwm without battery": (
        table().drop(columns=[*GROUPS["cmd"], *GROUPS["rotor_vel"], "battery"]),
        "column 'battery' is missing. pwm_* is an input only with it.",
    ),
    "time as a date": (
        table().assign(t=pd.date_range("2024-01-01", periods=400, freq="10ms")),
        "column 't' holds values of type timestamp",
    ),
    "milliseconds": (
        changed(t=lambda t: 1000 * t),
        "column 't': the median time between rows is 10; at most 0.2 s is expected. Is it in mill",
    ),
    "few rows": (table(rows=49, freq=20.0), "only 49 rows; at least 50 are expected"),
    "few seconds": (table(rows=60), "only 0.59 s of flight; at least 1.0 s are expected"),
    "no rows": (table(rows=1)[:0], "only 0 rows; at least 50"),
    "few rows of one drone": (
        pd.concat([table().assign(drone=0), table(rows=20).assign(drone=1)]),
        "only 20 rows of drone 1",
    ),
    "drone 1.5": (
        table().assign(drone=[0.0] * 9 + [1.5] * 391),
        "column 'drone', row 10: 1.5; an integer is expected",
    ),
    "quaternion norm": (
        changed(quat_w={77: 0.9}),
        "columns quat_x to quat_w, row 77: the quaternion's norm is 0.9",
    ),
    "scalar first": (
        table().rename(
            columns={"quat_w": "quat_x", "quat_x": "quat_y", "quat_y": "quat_z", "quat_z": "quat_w"}
        ),
        "with the scalar last (quat_w) and from body to world, z up. It looks as if quat_x held",
    ),
    "upside down": (
        table().assign(quat_x=0.0, quat_y=1.0, quat_z=0.0, quat_w=0.0),
        "the median tilt is 180 degrees; less than 60 is expected",
    ),
    "frozen": (
        table().assign(**{name: table()[name][7] for g in ("pos", "quat") for name in GROUPS[g]}),
        "columns pos_x to quat_w: position and attitude never change; a flight is expected.",
    ),
    "millimetres": (
        scaled("pos", 1000.0),
        "columns pos_x to pos_z: positions move 1000 times as far as the velocities say; m and "
        "m/s are expected. Are positions in millimetres?",
    ),
    "mm/s": (scaled("vel", 1000.0), "columns vel_x to vel_z: velocities say 1000 times what the"),
    "velocities of a drone that stands": (
        table().assign(pos_x=0.0, pos_y=0.0),
        "columns vel_x to vel_z: velocities say more than 10000 times what the positions move; "
        "m/s and m are expected.",
    ),
    "both millimetres": (
        scaled("pos", 1000.0).assign(**1000.0 * table()[list(GROUPS["vel"])]),
        "column 'vel_x', row 4: -59.964; -50 to 50 m/s is expected. Is it in mm/s?",
    ),
    "deg/s, slowly turning": (
        scaled("ang_vel", 57.3),
        "columns ang_vel_x to ang_vel_z: they say 57.3 times what the attitude turns; rad/s is",
    ),
    "acc in g": (
        scaled("acc", 1 / GRAVITY),
        "columns acc_x to acc_z: the median specific force is 1; about 9.81 m/s^2 is expected, "
        "gravity's share included. Is it in g?",
    ),
    "acc without gravity": (scaled("acc", 1e-3), "Was gravity taken out?"),
    "acc in mm/s^2": (scaled("acc", 1000.0), "Is it in mm/s^2?"),
    "acc downwards": (
        scaled("acc", -1.0),
        "column 'acc_z': its median is -9.81 m/s^2; about +9.81",
    ),
    "degrees, hardly tilted": (
        changed(cmd_pitch=lambda angle: 3.1 * angle / 0.1, quat_y=lambda y: 0.02 * y)
        .assign(quat_w=1.0)
        .drop(columns=list(GROUPS["ang_vel"])),
        "rad is expected. Are they in degrees?",
    ),
    "yaw in degrees": (
        table(yaw=2.0).assign(cmd_yaw=np.degrees(2.0)),
        "column 'cmd_yaw', row 1: 114.6; rad is expected, and only taken as degrees",
    ),
    "thrust in PWM": (
        table().assign(cmd_thrust=38000),
        "column 'cmd_thrust': the median of what is commanded is 3.8e+04; newtons are expected, "
        "about 0.314 N to hover with 0.032 kg. Is it in PWM (0 to 65535)?",
    ),
    "thrust in grams": (table().assign(cmd_thrust=31.5), "Is it in grams?"),
    "thrust in kg": (table().assign(cmd_thrust=0.031), "Is it in kilograms?"),
    "thrust per rotor": (table().assign(cmd_thrust=0.078), "Is it in newtons per rotor?"),
    "thrust in percent": (table().assign(cmd_thrust=60), "Is it in percent?"),
    "thrust normalised": (
        table().assign(cmd_thrust=0.65),
        "Is it in a share of full thrust (0 to 1)?",
    ),
    "no thrust": (table().assign(cmd_thrust=0.0), "the median of what is commanded is 0; newtons"),
    "rpm": (
        table().assign(rotor_vel_2=17000.0),
        "column 'rotor_vel_2', row 1: 17000; 0 to 4862.3 rad/s is expected. Is it in rpm?",
    ),
    "rev/s": (
        table().assign(rotor_vel_1=280.0),
        "column 'rotor_vel_1': 90 % of the rotor speeds are below 280; this airframe hovers with "
        "1989 rad/s by its thrust curve. Is it in revolutions per second?",
    ),
    "pwm 65535": (
        scaled("pwm", 65535.0),
        "column 'pwm_1', row 1: 39321; 0 to 1 (share of full duty) is expected. Is it 0 to 65535?",
    ),
    "pwm 255": (scaled("pwm", 255.0), "Is it 0 to 255?"),
    "pwm percent": (scaled("pwm", 100.0), "Is it 0 to 100?"),
    "pwm off": (scaled("pwm", 0.0), "column 'pwm_1': it is never above 0"),
    "millivolts": (
        table().assign(battery=3700).drop(columns=[*GROUPS["pwm"]]),
        "column 'battery', row 1: 3700; 2 to 60 V is expected. Is it in millivolts?",
    ),
    "duty of several cells": (
        table().assign(battery=16.0).drop(columns=[*GROUPS["cmd"], *GROUPS["rotor_vel"]]),
        "column 'battery', row 1: 16; 2 to 5 V is expected. How duty becomes thrust is known of "
        "one cell alone.",
    ),
}


# `make test` has every table as Parquet, and one for each way to read CSV.
AS_CSV = ("missing", "time as a date", "no rows")
CASES = [
    *(("parquet", name) for name in BAD_TABLES),
    *(
        pytest.param("csv", name, marks=[] if name in AS_CSV else [pytest.mark.exhaustive])
        for name in BAD_TABLES
    ),
]


@pytest.mark.parametrize(("ending", "name"), CASES)
def test_a_bad_table_gives_one_line(tmp_path, ending, name):
    frame, message = BAD_TABLES[name]
    got = why_left_out(tmp_path, frame, f"bad.{ending}")
    if (ending, name) == ("csv", "time as a date"):
        message = "column 't', row 1: the text '2024-01-01"
    assert message in got
    assert got.endswith((".", "?"))


def test_degrees_of_an_ordinary_flight_are_named_with_their_row(tmp_path):
    frame = table().assign(cmd_pitch=lambda x: np.degrees(x["cmd_pitch"]))
    row = int(np.argmax(np.abs(frame["cmd_pitch"]) > np.pi)) + 1
    got = why_left_out(tmp_path, frame)
    assert f"column 'cmd_pitch', row {row}: " in got
    assert "-3.14 to 3.14 rad is expected. Are they in degrees?" in got


def bytes_of(path, frame, ending):
    save(frame, path / f"whole.{ending}")
    return (path / f"whole.{ending}").read_bytes()


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_an_empty_file_is_named(tmp_path, ending):
    put(tmp_path, f"bad.{ending}", b"")
    assert "the file is empty (0 bytes)" in why_left_out(tmp_path, name=f"bad.{ending}")


def test_a_csv_file_with_a_header_only_is_named(tmp_path):
    header = ",".join(table().columns).encode()
    for content in (header, header + b"\n"):
        put(tmp_path, "bad.csv", content)
        assert "no row" in (got := why_left_out(tmp_path, name="bad.csv")) or "only 0 rows" in got


@MANY
@given(share=st.floats(0.001, 0.999))
def test_a_truncated_parquet_file_is_named(tmp_path_factory, share):
    path = tmp_path_factory.mktemp("set")
    whole = bytes_of(path, table(), "parquet")
    put(path, "bad.parquet", whole[: max(4, int(share * len(whole)))])
    got = why_left_out(path, name="bad.parquet")
    assert "the Parquet file is truncated: its end is missing; copy it again." in got


@MANY
@given(row=st.integers(1, 400), cells=st.integers(1, 30), digits=st.integers(1, 3))
def test_a_truncated_csv_file_is_named(tmp_path_factory, row, cells, digits):
    path = tmp_path_factory.mktemp("set")
    lines = bytes_of(path, table() + 0.125, "csv").splitlines()
    last = lines[row].split(b",")[:cells]
    last[-1] = last[-1][:digits]
    put(path, "bad.csv", b"\n".join([*lines[:row], b",".join(last)]))
    got = why_left_out(path, name="bad.csv")
    assert f"row {row} has {cells} cells and the header 31; is the file truncated there?" in got


@MANY
@given(junk=st.binary(min_size=1, max_size=200))
def test_junk_under_the_name_of_a_log_is_named(tmp_path_factory, junk):
    path = tmp_path_factory.mktemp("set")
    put(path, "bad.parquet", b"<" + junk)
    assert "not a Parquet file" in why_left_out(path, name="bad.parquet")
    path = tmp_path_factory.mktemp("set")
    put(path, "bad.csv", junk)
    assert why_left_out(path, name="bad.csv")


@MANY
@given(data=st.data())
def test_a_damaged_parquet_file_stops_nobody(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("set")
    content = bytearray(bytes_of(path, table(), "parquet"))
    at = data.draw(st.integers(len(content) - 3000, len(content) - 9))
    content[at : at + 8] = data.draw(st.binary(min_size=8, max_size=8))
    put(path, "bad.parquet", bytes(content))
    loaded = load_flights(path)
    assert "good" in [flight.name for flight in loaded.flights]


def test_a_row_of_another_length_is_named(tmp_path):
    lines = table().to_csv(index=False).splitlines()
    lines[120] += ",7"
    put(tmp_path, "bad.csv", "\n".join(lines).encode())
    width = lines[0].count(",") + 1
    assert f"row 120 has {width + 1} cells and the header {width}" in why_left_out(
        tmp_path, name="bad.csv"
    )


def test_semicolons_are_named(tmp_path):
    put(tmp_path, "bad.csv", table().to_csv(index=False, sep=";").encode())
    got = why_left_out(tmp_path, name="bad.csv")
    assert got.endswith("The columns must be separated by commas, not semicolons.")


def test_decimal_commas_are_named(tmp_path):
    frame = table() + 0.125
    put(tmp_path, "bad.csv", frame.to_csv(index=False, sep=";", decimal=",").encode())
    got = why_left_out(tmp_path, name="bad.csv")
    assert "by commas, not semicolons. Numbers need decimal points, such as 1.5." in got
    put(tmp_path, "bad.csv", frame.to_csv(index=False, decimal=",").encode())
    got = why_left_out(tmp_path, name="bad.csv")
    assert "the text '0,125'; a number is expected. Use a decimal point." in got


def test_an_outdoor_flight_over_more_than_a_hundred_metres_is_used(tmp_path):
    frame = table().assign(pos_z=np.linspace(0, 150, 400), vel_z=37.5)
    assert load_flights(folder(tmp_path, "a.parquet", frame)).left_out == ()


@pytest.mark.parametrize("n_cells", [3, 4, 6, 12])
def test_the_voltage_of_several_cells_becomes_that_of_one(tmp_path, n_cells):
    volts = 4.1 - 0.1 * table()["t"]
    frame = table().assign(battery=n_cells * volts).drop(columns=[*GROUPS["pwm"]])
    path = folder(tmp_path, "a.parquet", frame)
    (path / "flights" / "good.parquet").unlink()
    (flight,) = load_flights(path).flights
    np.testing.assert_allclose(flight.drones[0].battery, volts)


def test_a_column_that_is_there_twice_is_named(tmp_path):
    frame = table()
    twice = pd.concat([frame, frame["vel_x"]], axis=1)
    assert "column 'vel_x' is there twice" in why_left_out(tmp_path, twice, "bad.csv")


def test_a_still_drone_with_noise_is_not_taken_for_wrong_units(tmp_path):
    rng = np.random.default_rng(0)
    frame = table(amplitude=0.0)
    frame[list(GROUPS["pos"])] += rng.normal(0.0, 1e-3, (400, 3)).round(3)
    frame[list(GROUPS["vel"])] = rng.normal(0.0, 1e-5, (400, 3))
    frame[list(GROUPS["ang_vel"])] += rng.normal(0.0, 0.3, (400, 3))
    frame[["quat_x", "quat_y"]] = rng.normal(0.0, 1e-3, (400, 2))
    frame["quat_w"] = 1.0
    assert load_flights(folder(tmp_path, "a.parquet", frame)).left_out == ()


@pytest.mark.parametrize("group", ["pos", "vel", "ang_vel", "acc", "rotor_vel", "pwm"])
@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_effects_of_ordinary_size_are_not_taken_for_wrong_units(tmp_path, group, factor):
    assert load_flights(folder(tmp_path, "a.parquet", scaled(group, factor))).left_out == ()
