"""Logs: what is written is read back, good files beside bad ones are used, folders checked."""

import dataclasses
import os

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_tables import changed, examples, folder, put, table

from diagnosis.logs.columns import GROUPS, KNOWN
from diagnosis.logs.flights import (
    DroneLog,
    FlightLog,
    LogError,
    VehicleFile,
    load_flights,
    write_flights,
)

VEHICLE = VehicleFile('A "plain" Crazyflie \\ ö', "cf2x_L250", 0.032)
MANY = examples(25)


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_good_log_has_every_field_in_the_order_of_the_format(tmp_path, ending):
    frame = table()
    loaded = load_flights(folder(tmp_path, f"flight.{ending}", frame))
    assert [flight.name for flight in loaded.flights] == ["flight", "good"]
    assert loaded.left_out == ()
    flight = loaded.flights[0]
    assert flight.seconds == pytest.approx(3.99)
    (log,) = flight.drones
    np.testing.assert_array_equal(log.battery, frame["battery"])
    for field, names in GROUPS.items():
        np.testing.assert_allclose(getattr(log, field), frame[list(names)], atol=1e-15)


def test_what_is_not_logged_is_none_and_other_columns_are_ignored(tmp_path):
    names = [name for name in KNOWN if name not in ("drone", *GROUPS["acc"], *GROUPS["cmd"])]
    frame = table()[names].drop(columns=list(GROUPS["pwm"])).assign(remark="windy", acc_w=np.nan)
    log = load_flights(folder(tmp_path, "a.csv", frame)).flights[0].drones[0]
    assert log.acc is None
    assert log.cmd is None
    assert log.pwm is None
    assert log.rotor_vel is not None


def test_integers_and_float32_are_read_as_float64(tmp_path):
    frame = table().astype("float32")
    frame["cmd_yaw"] = np.zeros(len(frame), int)
    log = load_flights(folder(tmp_path, "a.parquet", frame)).flights[0].drones[0]
    assert {values.dtype for values in (log.t, log.pos, log.cmd)} == {np.dtype("float64")}


def test_several_drones_may_be_interleaved_and_come_out_by_number(tmp_path):
    one, two = table().assign(drone=7), table(rows=300).assign(drone=2, pos_z=2.0)
    both = pd.concat([one, two]).sort_values("t", kind="stable")
    (flight, _) = load_flights(folder(tmp_path, "a.csv", both)).flights
    assert [len(log.t) for log in flight.drones] == [300, 400]
    assert (flight.drones[0].pos[:, 2] == 2.0).all()
    np.testing.assert_array_equal(flight.drones[1].t, one["t"])


def test_quaternions_come_out_normed_and_without_jumps_of_sign(tmp_path):
    frame = table()
    quat = frame[list(GROUPS["quat"])].to_numpy()
    signs = np.where(np.arange(len(frame)) % 7 < 3, -1.004, 1.0)[:, None]
    frame[list(GROUPS["quat"])] = quat * signs
    log = load_flights(folder(tmp_path, "a.parquet", frame)).flights[0].drones[0]
    np.testing.assert_allclose(log.quat, -quat, atol=1e-12)


def test_yaw_through_pi_gaps_and_jitter_are_fine(tmp_path):
    frame = table(rows=1000, yaw=np.linspace(2.0, 5.0, 1000))
    frame["cmd_yaw"] = np.angle(np.exp(1j * frame["cmd_yaw"]))
    frame["t"] += np.random.default_rng(0).uniform(0.0, 0.009, 1000)
    frame = frame[(frame["t"] < 3.0) | (frame["t"] > 4.5)]
    loaded = load_flights(folder(tmp_path, "a.parquet", frame))
    assert loaded.left_out == ()
    assert (
        np.einsum("ij,ij->i", *(loaded.flights[0].drones[0].quat[k:][:700] for k in (0, 1))).min()
        > 0
    )


@MANY
@given(
    name=st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
    drones=st.integers(1, 3),
    fields=st.sets(st.sampled_from(["ang_vel", "acc", "rotor_vel", "pwm", "battery"])),
    seed=st.integers(0, 2**32 - 1),
)
def test_what_is_written_is_read_back_exactly(tmp_path_factory, name, drones, fields, seed):
    rng = np.random.default_rng(seed)
    logs = []
    for _ in range(drones):
        frame = table(rows=int(rng.integers(150, 300)))
        frame["t"] = np.sort(frame["t"] + rng.uniform(0, 0.009, len(frame)))
        stacked = {field: frame[list(GROUPS[field])].to_numpy(copy=True) for field in GROUPS}
        stacked["pos"] += rng.normal(0, 1e-3, stacked["pos"].shape)
        stacked = {k: v for k, v in stacked.items() if k in fields | {"pos", "vel", "quat", "cmd"}}
        battery = frame["battery"].to_numpy() if "battery" in fields else None
        logs.append(DroneLog(t=frame["t"].to_numpy(), battery=battery, **stacked))
    vehicle = VehicleFile(name, "cf21B_500", float(rng.uniform(0.03, 0.06)))
    other = dataclasses.replace(logs[0], pos=logs[0].pos + 1e-3)
    flights = (FlightLog("a-1", tuple(logs)), FlightLog("b.2", (other,)))
    path = tmp_path_factory.mktemp("set") / "flights"
    write_flights(path, vehicle, flights)
    loaded = load_flights(path)
    assert loaded.vehicle == vehicle
    assert loaded.left_out == ()
    assert [flight.name for flight in loaded.flights] == ["a-1", "b.2"]
    for flight, written in zip(loaded.flights, flights, strict=True):
        for log, expected in zip(flight.drones, written.drones, strict=True):
            for field in dataclasses.fields(DroneLog):
                value, wanted = getattr(log, field.name), getattr(expected, field.name)
                if field.name == "quat":  # normed again
                    np.testing.assert_allclose(value, wanted, rtol=0, atol=1e-15)
                else:
                    np.testing.assert_array_equal(value, wanted)


def test_writing_refuses_to_mix_and_names_that_name_no_file(tmp_path):
    flight = load_flights(folder(tmp_path / "set")).flights[0]
    write_flights(tmp_path / "new", VEHICLE, [flight])
    assert load_flights(tmp_path / "new").vehicle == VEHICLE
    with pytest.raises(FileExistsError, match="must be empty"):
        write_flights(tmp_path / "new", VEHICLE, [flight])
    with pytest.raises(ValueError, match=r"got '\.\./x'"):
        write_flights(tmp_path / "b", VEHICLE, [dataclasses.replace(flight, name="../x")])
    with pytest.raises(ValueError, match="there once"):
        write_flights(tmp_path / "b", VEHICLE, [flight, flight])
    less = dataclasses.replace(flight.drones[0], acc=None)
    mixed = dataclasses.replace(flight, drones=(flight.drones[0], less))
    with pytest.raises(ValueError, match="'good' must log the same columns"):
        write_flights(tmp_path / "b", VEHICLE, [mixed])


def test_a_byte_order_mark_and_blanks_are_fine(tmp_path):
    text = table().to_csv(index=False).replace(",", ", ")
    put(tmp_path, "a.csv", b"\xef\xbb\xbf" + text.encode())
    assert load_flights(tmp_path).left_out == ()


def test_a_vehicle_file_may_begin_with_a_byte_order_mark(tmp_path):
    path = folder(tmp_path)
    text = (path / "vehicle.toml").read_bytes()
    (path / "vehicle.toml").write_bytes(b"\xef\xbb\xbf" + text)
    assert load_flights(path).vehicle == load_flights(folder(tmp_path / "plain")).vehicle


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_a_name_that_is_no_text_is_a_name(tmp_path, ending):
    path = folder(tmp_path, f"a.{ending}", table())
    file = path / "flights" / f"a.{ending}"
    try:
        file.rename(os.fsdecode(os.fsencode(file.parent) + b"/\xfcbung." + ending.encode()))
    except OSError:
        pytest.skip("This file system takes UTF-8 names only.")
    loaded = load_flights(path)
    assert loaded.left_out == ()
    assert len(loaded.flights) == 2


def test_a_clock_that_jumps_is_named(tmp_path):
    frame = table()
    frame.loc[10:, "t"] += 1.7e9
    (left,) = load_flights(folder(tmp_path, "a.parquet", frame)).left_out
    assert "column 't', row 11: 1.7e+09 s without a row; at most 600 s" in left.reason
    assert left.reason.endswith("Did the clock jump?")
    frame = table()
    frame["t"] *= 1000.0
    frame.loc[10:, "t"] += 2000.0
    (left,) = load_flights(folder(tmp_path, "a.parquet", frame)).left_out
    assert left.reason.endswith("Is it in milliseconds?")


def test_every_bad_file_has_a_line_and_good_ones_are_used(tmp_path):
    path = folder(tmp_path, "a.csv", changed(vel_z={3: np.nan}), **{"b.parquet": table(rows=5)})
    put(path, "notes.txt", b"windy")
    put(path, "good.csv", b"t\n")
    put(path, ".hidden", b"")
    (path / "flights" / "more").mkdir()
    loaded = load_flights(path)
    reasons = {left.name: left.reason for left in loaded.left_out}
    assert set(reasons) == {"a.csv", "b.parquet", "notes.txt", "good.csv", "more"}
    assert "column 'vel_z', row 3: NaN" in reasons["a.csv"]
    assert "only 5 rows" in reasons["b.parquet"]
    assert "neither .parquet nor .csv" in reasons["notes.txt"]
    assert "is not a file" in reasons["more"]


def test_a_table_of_several_drones_without_rows_is_a_bad_file(tmp_path):
    found = load_flights(folder(tmp_path, "empty.parquet", table().assign(drone=0).iloc[:0]))
    assert [f.name for f in found.flights] == ["good"]
    assert "only 0 rows" in found.left_out[0].reason


def test_two_files_of_one_name_cannot_both_be_used(tmp_path):
    loaded = load_flights(folder(tmp_path, "good.csv", table()))
    assert len(loaded.flights) == 1
    assert "another file of this folder is called good" in loaded.left_out[0].reason


def test_nothing_usable_is_an_error_with_a_line_for_each_file(tmp_path):
    path = folder(tmp_path, "a.csv", table(rows=3), **{"b.csv": changed(t={9: np.nan})})
    (path / "flights" / "good.parquet").unlink()
    with pytest.raises(LogError) as caught:
        load_flights(path)
    first, second = str(caught.value).splitlines()
    assert first.startswith(f"{path}/flights/a.csv: only 3 rows")
    assert second.startswith(f"{path}/flights/b.csv: column 't', row 9: NaN")


def test_folders_that_are_missing_or_empty_are_named(tmp_path):
    with pytest.raises(LogError, match=r"nowhere: does not exist; a folder with vehicle\.toml"):
        load_flights(tmp_path / "nowhere")
    with pytest.raises(LogError, match=r"vehicle\.toml: there is no such file"):
        load_flights(tmp_path)
    path = folder(tmp_path)
    with pytest.raises(LogError, match="is a file; a folder"):
        load_flights(path / "vehicle.toml")
    with pytest.raises(LogError, match=rf"Did you mean {path}\?"):
        load_flights(path / "flights")
    (path / "flights" / "good.parquet").unlink()
    with pytest.raises(LogError, match=r"the folder is empty; NAME\.parquet or NAME\.csv"):
        load_flights(path)
    (path / "flights").rmdir()
    with pytest.raises(LogError, match="flights: there is no such folder"):
        load_flights(path)


VEHICLES = {
    "": ["key 'name' is missing", "key 'drone' is missing", "key 'mass' is missing"],
    'name = "x"\ndrone = "cf2x_L250"\nmass = 32.0': [
        "key 'mass': got 32; 0.011 to 0.098 kg is plausible. Is it in grams?"
    ],
    'name = "x"\ndrone = "cf2x_L250"\nmass = 0.0': ["key 'mass': got 0; 0.011 to 0.098 kg is pla"],
    'name = "x"\ndrone = "cf2x_L250"\nmass = nan': ["key 'mass': got nan; the mass in kg"],
    'name = "x"\ndrone = "cf2x_L250"\nmass = true': ["key 'mass': got True; the mass in kg"],
    'name = "x"\ndrone = "cf2x_L250"\nmass = "0.03"': ["key 'mass': got '0.03'; the mass in kg"],
    'name = "x"\ndrone = "cf2x_L25"\nmass = 0.03': [
        "key 'drone': got 'cf2x_L25'. Did you mean 'cf2x_L250'? an airframe"
    ],
    "name = 3\ndrone = []\nmass = 0.03": ["key 'name': got 3; a text", "key 'drone': got []; an"],
    'name = "x"\ndrone = "cf2x_L250"\nmas = 0.03': [
        "unknown key 'mas'. Did you mean 'mass'? Allowed: name, drone, mass, airframe.",
        "key 'mass' is missing; the mass in kg is expected.",
    ],
    'name = "x': ["this is not TOML: "],
}


@pytest.mark.parametrize(("text", "lines"), VEHICLES.items())
def test_a_bad_vehicle_file_gives_one_line_for_each_fault(tmp_path, text, lines):
    path = folder(tmp_path)
    (path / "vehicle.toml").write_text(text)
    with pytest.raises(LogError) as caught:
        load_flights(path)
    got = str(caught.value).splitlines()
    assert len(got) == len(lines)
    for line, expected in zip(got, lines, strict=True):
        assert line.startswith(f"{path}/vehicle.toml: {expected}")


@pytest.mark.exhaustive  # 1.8 million rows, through the lines that every other table goes
def test_an_hour_at_500_hz_loads(tmp_path):
    path = folder(tmp_path, "long.parquet", table(rows=1_800_000, freq=500.0))
    loaded = load_flights(path)
    assert loaded.left_out == ()
    assert loaded.flights[1].seconds == pytest.approx(3600.0, abs=0.01)


def test_a_flight_that_is_there_twice_counts_once(tmp_path):
    loaded = load_flights(folder(tmp_path, "a.parquet", table(), **{"b.csv": table()}))
    assert [flight.name for flight in loaded.flights] == ["a", "good"]
    (left,) = loaded.left_out
    assert left.reason == "flights/b.csv: this is the flight a again: all positions are equal."
