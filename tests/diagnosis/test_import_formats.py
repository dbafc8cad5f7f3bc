"""A simulated flight written in every format and read back has the same columns."""

import dataclasses
import functools
from types import SimpleNamespace as Namespace

import numpy as np
import pandas as pd
import pytest
from flights_for_tests import fly
from import_logs_for_tests import FLOWN, FORMATS, write_log
from log_writers import RATES, variables, write_bag, write_usd
from scipy.spatial.transform import Rotation

from diagnosis.importing.bags import _TWIST as TWIST
from diagnosis.importing.bags import _odometry, _recording
from diagnosis.importing.convert import import_logs
from diagnosis.importing.crazyflie import (
    LOGGED,
    MOST_LOGGED,
    RECIPE,
    crazyflie_streams,
    unpacked,
)
from diagnosis.importing.reader import Request
from diagnosis.importing.report import import_report
from diagnosis.importing.resample import make_rows
from diagnosis.logs.columns import LogError
from diagnosis.logs.flights import load_flights
from simulators.point_mass import PointMass
from simulators.vehicle import GRAVITY, VEHICLES

SPEC = VEHICLES["cf21B_500"]
HOVER_THRUST = 0.0434 * GRAVITY
FULL = 2.0 * HOVER_THRUST
"""What a bag's thrust of 1 means [N]: `log_writers.HOVER` is a half."""


@pytest.fixture(scope="module")
def log():
    """One flight, 250 rows a second, a new command every fifth row; turned in yaw."""
    (flight,) = fly(PointMass(dt=0.004), n_flights=1, seconds=3.0, noise=0.0, rows=5)
    (drone,) = flight.drones
    turn = Rotation.from_euler("z", 0.8)
    return dataclasses.replace(
        drone,
        pos=turn.apply(drone.pos),
        vel=turn.apply(drone.vel),
        quat=(turn * Rotation.from_quat(drone.quat)).as_quat(),
        cmd=drone.cmd + np.asarray([0.0, 0.0, 0.8, 0.0]),
    )


@pytest.fixture(scope="module")
def written(log, tmp_path_factory):
    """What writes the log in a format, once; skips where its package is missing."""

    @functools.cache
    def write(kind):
        return write_log(kind, tmp_path_factory.mktemp("log"), log, HOVER_THRUST, SPEC.thrust_max)

    return write


def imported(source, folder, **options):
    """The drones of the one flight that a source holds, and the report."""
    full = FULL if source.suffix in (".bag", ".mcap") or source.is_dir() else None
    full = SPEC.thrust_max if source.name == "session" else full
    found = import_logs([source], folder, FLOWN, **{"full_thrust": full, **options})
    (flight,) = load_flights(folder).flights
    return flight.drones, found


@pytest.mark.parametrize("kind", FORMATS)
def test_columns_are_the_same_to_resolution(log, written, tmp_path, kind):
    ((drone,), found) = imported(written(kind), tmp_path / "out")
    at = np.searchsorted(log.t, drone.t - 1e-6)
    np.testing.assert_allclose(drone.t, log.t[at], atol=1e-9)  # counted from the first message
    assert len(at) >= len(log.t) // max(RATES.values())
    np.testing.assert_allclose(drone.pos, log.pos[at], atol=2e-6)
    np.testing.assert_allclose(drone.vel, log.vel[at], atol=2e-6)
    turn = Rotation.from_quat(drone.quat).inv() * Rotation.from_quat(log.quat[at])
    assert turn.magnitude().max() < 2e-6
    np.testing.assert_allclose(drone.cmd, log.cmd[at], atol=2e-6)
    assert (drone.battery is not None) == (kind not in ("ros1", "ros2", "mcap", "cflib"))
    if kind in ("ulog", "ardupilot"):
        np.testing.assert_allclose(drone.acc, np.tile([0.1, -0.2, 9.81], (len(at), 1)), rtol=1e-6)
    assert "taken from" in import_report(found)
    assert found.left_out == ()


@pytest.mark.parametrize("kind", ["ulog", "ros1", "ros2", "mcap", "usd"])
def test_rows_without_an_attitude_are_dropped_and_counted(log, tmp_path, kind):
    """PX4 logs NaN before its first attitude setpoint, an estimator zeros before its start."""
    quat, cmd = log.quat.copy(), log.cmd.copy()
    quat[[0, 300]], cmd[0, :3] = 0.0, np.nan
    changed = dataclasses.replace(log, quat=quat, cmd=cmd)
    source = write_log(kind, tmp_path, changed, HOVER_THRUST, SPEC.thrust_max)
    (drone,), found = imported(source, tmp_path / "out")
    (rows,) = found.flights[0].drones.values()
    dropped = {taken.field: taken.dropped for taken in rows.taken}
    assert (dropped["quat"], dropped["cmd_angles"], dropped["pos"]) == (2, 1, 0)
    at = np.searchsorted(log.t, drone.t - 1e-6)
    turn = Rotation.from_quat(drone.quat).inv() * Rotation.from_quat(log.quat[at])
    assert turn.magnitude().max() < 1e-3


@pytest.mark.parametrize("kind", ["ulog", "ardupilot"])
def test_the_thrust_is_what_the_logged_hover_share_says(written, tmp_path, kind):
    source = written(kind)
    (believed,), _ = imported(source, tmp_path / "a")
    (known,), _ = imported(source, tmp_path / "b", full_thrust=1.3 * FULL)
    np.testing.assert_allclose(known.cmd[:, 3], 1.3 * believed.cmd[:, 3])


@pytest.mark.parametrize(
    ("kind", "volts", "n_cells"), [("ulog", 16.0, 4), ("ulog", 24.0, 6), ("ardupilot", 16.0, 4)]
)
def test_a_battery_of_several_cells_is_imported(log, tmp_path, kind, volts, n_cells):
    flown = dataclasses.replace(log, battery=volts - 0.1 * log.t)
    source = write_log(kind, tmp_path, flown, HOVER_THRUST, SPEC.thrust_max)
    (drone,), found = imported(source, tmp_path / "out")
    at = np.searchsorted(log.t, drone.t - 1e-6)
    np.testing.assert_allclose(drone.battery, flown.battery[at] / n_cells, rtol=1e-5)
    assert f"taken for that of {n_cells} cells in series" in import_report(found)


@pytest.mark.parametrize("kind", ["ulog", "ardupilot"])
def test_a_voltage_that_was_not_measured_is_left_out(log, tmp_path, kind):
    flown = dataclasses.replace(log, battery=np.zeros(len(log.t)))
    source = write_log(kind, tmp_path, flown, HOVER_THRUST, SPEC.thrust_max)
    (drone,), found = imported(source, tmp_path / "out")
    assert drone.battery is None
    assert "is left out, because 0 of its" in import_report(found)


def test_two_drones_of_one_bag_stay_two(log, tmp_path):
    source = write_bag(tmp_path / "a.bag", log, FULL, "ros1", drones=("/cf1", "/cf2"))
    drones, found = imported(source, tmp_path / "out")
    assert list(found.flights[0].drones) == ["cf1", "cf2"]
    np.testing.assert_array_equal(drones[0].pos, drones[1].pos)


def test_a_bag_without_a_thrust_scale_says_what_to_give(written, tmp_path):
    with pytest.raises(ValueError, match=r"a\.bag: thrust is logged as a share.*--full-thrust N"):
        imported(written("ros1"), tmp_path / "out", full_thrust=None)
    assert not (tmp_path / "out").exists()


def test_a_topic_that_is_not_there_is_named(written, tmp_path):
    with pytest.raises(ValueError, match=r"--topic vel=/speed: there is no such topic; found: /tw"):
        imported(written("ros1"), tmp_path / "out", topics={"vel": ("/speed",)})


@pytest.mark.parametrize("first", [0, 5])
def test_mellingers_axis_of_thrust_becomes_roll_and_pitch(log, first):
    """Also where the estimator logs zeros before it starts."""
    yaw = Rotation.from_quat(log.quat).as_euler("xyz")[:, 2]
    asked = Rotation.from_euler("xyz", np.column_stack([log.cmd[:, :2], yaw]))
    axis = asked.apply([0.0, 0.0, 1.0])
    values = dict(zip(("zdx", "zdy", "zdz"), axis.T, strict=True))
    named = {f"ctrlMel.{n}": pd.Series(v, log.t) for n, v in values.items()}
    measured = np.where(np.arange(len(log.t))[:, None] < first, 0.0, log.quat)
    quat = dict(zip(("qx", "qy", "qz", "qw"), measured.T, strict=True))
    named |= {f"stateEstimate.{n}": pd.Series(v, log.t) for n, v in quat.items()}
    streams, _ = crazyflie_streams(named, Request(mass=0.0434, thrust_max=0.8))
    (angles,) = [stream for stream in streams if stream.field == "cmd_angles"]
    assert np.isfinite(angles.values).all()
    np.testing.assert_allclose(angles.values[first:, :2], log.cmd[first:, :2], atol=1e-9)


def test_a_velocity_in_the_body_frame_is_turned_where_the_attitude_is_known():
    """Of three messages of nav_msgs/Odometry the second has a quaternion of zeros."""
    quats = np.stack(
        [Rotation.from_euler("z", angle).as_quat() for angle in (0.0, 0.1, 0.5 * np.pi)]
    )
    quats[1] = 0.0
    forward = Namespace(x=1.0, y=0.0, z=0.0)
    twist = Namespace(twist=Namespace(linear=forward, angular=forward))
    messages = [
        Namespace(
            pose=Namespace(pose=Namespace(position=forward, orientation=quat)),
            twist=twist,
            header=Namespace(frame_id="map"),
            child_frame_id="base_link",
        )
        for quat in (Namespace(**dict(zip("xyzw", quat, strict=True))) for quat in quats)
    ]
    request = Request(mass=0.0434, thrust_max=0.8)
    vel = {s.field: s.values for s in _odometry("/odom", np.arange(3.0), messages, request)}["vel"]
    np.testing.assert_allclose(vel, [[1, 0, 0], [np.nan] * 3, [0, 1, 0]], atol=1e-12)


def test_a_packed_quaternion_is_unpacked():
    """By the firmware's recipe: the largest part's place, then sign and 9 bits of the others."""
    quats = Rotation.random(50, random_state=1).as_quat()
    packed = []
    for quat in quats:
        largest = int(np.argmax(np.abs(quat)))
        word = largest
        for i in range(4):
            if i != largest:
                negative = (quat[i] < 0) != (quat[largest] < 0)
                size = int(511 * abs(quat[i]) / np.sqrt(0.5) + 0.5)
                word = word << 10 | negative << 9 | size
        packed.append(float(word))
    turn = Rotation.from_quat(unpacked(np.asarray(packed))).inv() * Rotation.from_quat(quats)
    assert turn.magnitude().max() < 5e-3


def test_the_recipe_logs_no_more_than_the_deck_takes_and_enough_to_diagnose(log):
    """The deck leaves out the variables after the twentieth without a word."""
    assert len(LOGGED) <= MOST_LOGGED == 20
    assert [line.split()[0] for line in RECIPE.splitlines()[-len(LOGGED) :]] == [*LOGGED]
    flown = {n: pd.Series(v, log.t) for n, v in variables(log, SPEC.thrust_max).items()}
    logged = {name: flown[name] for name in LOGGED if name in flown}
    streams, _ = crazyflie_streams(logged, Request(mass=0.0434, thrust_max=SPEC.thrust_max))
    rows = make_rows(streams, 0.0)
    assert {"cmd_roll", "cmd_thrust", "battery", "vel_x"} <= set(rows.columns)


def test_a_motor_speed_that_was_not_measured_is_empty(log):
    speeds = {f"rpm.m{i}": pd.Series(np.full(len(log.t), 20000.0), log.t) for i in (1, 2, 3, 4)}
    speeds["rpm.m2"].iloc[0] = 65535.0
    streams, _ = crazyflie_streams(speeds, Request(mass=0.0434, thrust_max=0.8))
    (rotors,) = streams
    assert np.isnan(rotors.values[0, 1])
    assert np.isfinite(rotors.values[1:]).all()


def test_variables_of_a_uSD_log_may_be_called_as_the_header_of_an_event(log, tmp_path):  # noqa: N802
    file = tmp_path / "log00"
    named = {**variables(log, SPEC.thrust_max), "id": 0.0 * log.t, "t": log.t}
    write_usd(file, log, SPEC.thrust_max, named=named)
    (drone,), _ = imported(file, tmp_path / "out")
    np.testing.assert_allclose(drone.pos, log.pos, atol=1e-4)


def test_a_crazyflie_block_without_position_is_no_flight_by_itself(log, tmp_path):
    """Thrust may stand in the block of the quaternion."""
    folder, named = tmp_path / "session", variables(log, SPEC.thrust_max)
    folder.mkdir()
    for block in ("pos", "rest"):
        chosen = [n for n in named if (n[-2:] in (".x", ".y", ".z")) == (block == "pos")]
        frame = pd.DataFrame({"Timestamp": 1e3 * log.t, **{n: named[n] for n in chosen}})
        frame.to_csv(folder / f"{block}.csv", index=False)
    (drone,), _ = imported(folder, tmp_path / "out")
    np.testing.assert_allclose(drone.pos, log.pos, atol=1e-9)


def test_an_empty_cell_and_a_comma_at_the_end_of_every_row_cost_one_row(log, tmp_path):
    file = tmp_path / "log.csv"
    frame = pd.DataFrame({"Timestamp": 1e3 * log.t, **variables(log, SPEC.thrust_max)})
    frame.loc[100, "stateEstimate.x"] = np.nan
    frame.loc[200, "pm.vbat"] = 0.0
    header, *rows = frame.to_csv(index=False).splitlines()
    file.write_text("\n".join([header, *(f"{row}," for row in rows)]) + "\n")
    (drone,), _ = imported(file, tmp_path / "out")
    assert len(drone.t) > 0.9 * len(log.t)
    np.testing.assert_allclose(
        np.interp(drone.t, log.t - log.t[0], log.pos[:, 0]), drone.pos[:, 0], atol=1e-3
    )
    assert drone.battery.min() > 3.0


def posed(**frame):
    """Two hundred messages of motion capture."""
    point = Namespace(x=0.0, y=0.0, z=1.0)
    turn = Namespace(x=0.0, y=0.0, z=0.0, w=1.0)
    pose = Namespace(position=point, orientation=turn)
    return [(i / 50, Namespace(pose=pose, header=Namespace(**frame))) for i in range(200)]


def asked(mask=0):
    turn = Namespace(x=0.0, y=0.0, z=0.0, w=1.0)
    one = Namespace(orientation=turn, thrust=0.5, type_mask=mask)
    return [(i / 50, one) for i in range(200)]


def moving(frame):
    linear = Namespace(x=0.0, y=0.0, z=0.0)
    one = Namespace(twist=Namespace(linear=linear), header=Namespace(frame_id=frame))
    return [(i / 50, one) for i in range(200)]


POSE, TARGET = "geometry_msgs/PoseStamped", "mavros_msgs/AttitudeTarget"


def recorded(rows, **topics):
    request = Request(mass=1.0, thrust_max=20.0, full_thrust=20.0, topics=topics)
    return _recording(rows, [], [], request)


def test_poses_of_motion_capture_are_those_of_the_drone_that_is_commanded():
    rows = {
        ("/mavros/setpoint_raw/attitude", TARGET): asked(),
        ("/mavros/local_position/pose", POSE): posed(),
        ("/vrpn/cf1/pose", POSE): posed(),
        ("/mavros/setpoint_position/local", POSE): posed(),
    }
    with pytest.raises(LogError, match=r"several topics could be pos: .*--topic pos=TOPIC"):
        recorded(rows)
    chosen = ("/vrpn/cf1/pose",)
    found = recorded(rows, pos=chosen, quat=chosen)
    (streams,) = found.drones.values()
    sources = {stream.field: stream.source for stream in streams}
    assert sources["pos"] == sources["quat"] == "/vrpn/cf1/pose"
    assert sources["cmd_thrust"] == "/mavros/setpoint_raw/attitude"
    assert any("setpoint_position/local is left out" in note for note in found.notes)


def test_each_of_two_drones_has_a_topic_of_its_own():
    rows = {}
    for drone in ("cf1", "cf2"):
        rows[f"/{drone}/target", TARGET] = asked()
        rows |= {(f"/{drone}/{name}", POSE): posed() for name in ("pose", "camera")}
    chosen = ("/cf1/pose", "/cf2/camera")
    drones = recorded(rows, pos=chosen, quat=chosen).drones
    sources = {name: {s.field: s.source for s in streams} for name, streams in drones.items()}
    assert [sources[name]["pos"] for name in ("cf1", "cf2")] == [*chosen]


def test_a_velocity_of_a_body_frame_is_left_out():
    rows = {
        ("/mavros/setpoint_raw/attitude", TARGET): asked(),
        ("/mavros/local_position/pose", POSE): posed(),
        ("/mavros/local_position/velocity_body", TWIST): moving("base_link"),
    }
    found = recorded(rows)
    assert "vel" not in {stream.field for stream in found.drones[""]}
    assert any("velocity_body is left out" in note for note in found.notes)
    rows["/mavros/local_position/velocity_local", TWIST] = moving("map")
    assert "vel" in {stream.field for stream in recorded(rows).drones[""]}


@pytest.mark.parametrize(("mask", "field"), [(128, "cmd_angles"), (64, "cmd_thrust")])
def test_what_a_set_point_masks_is_empty(mask, field):
    rows = {("/mavros/setpoint_raw/attitude", TARGET): asked(mask)}
    streams = {s.field: s.values for s in recorded(rows).drones[""]}
    assert {name for name, values in streams.items() if np.isnan(values).all()} == {field}


def setpoints(thrust):
    down = np.asarray([0.0, 0.0, -thrust])
    quat = np.asarray([1.0, 0.0, 0.0, 0.0])
    times = (20_000 * i for i in range(200))
    return [(t / 1e6, Namespace(timestamp=t, q_d=quat, thrust_body=down)) for t in times]


def test_two_topics_of_one_px4_message_are_chosen_by_name():
    kind = "px4_msgs/VehicleAttitudeSetpoint"
    topics = [f"/fmu/{way}/vehicle_attitude_setpoint" for way in ("in", "out")]
    rows = {(topic, kind): setpoints(0.5) for topic in topics}
    with pytest.raises(LogError, match=f"several topics could be cmd_angles: {', '.join(topics)};"):
        recorded(rows)
    chosen = (topics[1],)
    (streams,) = recorded(rows, cmd_angles=chosen, cmd_thrust=chosen).drones.values()
    assert {stream.source.split()[0] for stream in streams} == {*chosen}
