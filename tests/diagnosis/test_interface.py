"""Interface faults: none in clean flights, and each that is written into them named."""

import dataclasses

import numpy as np
import pytest
from diagnoses_for_tests import load, none
from flights_for_tests import flight_set, real
from scipy.spatial.transform import Rotation

from bench.diagnosis_report.documents import diagnosis_text
from bench.diagnosis_report.page import diagnosis_page
from bench.diagnosis_report.sentences import remarks
from blind.draw.faults import ALL
from blind.fly.log_faults import shifted
from diagnosis.interface import faults, scales
from diagnosis.interface.fault import MOTOR_CLOCK, PARTS, of_reference
from diagnosis.interface.faults import interface_faults as found
from diagnosis.interface.mended import in_time, mended
from diagnosis.interface.motors import MOMENTS, motor_order, turning_lag
from diagnosis.interface.motors import turning as turnings
from diagnosis.interface.readings import Reading, choose, signed_orders
from diagnosis.logs.flights import DroneLog, FlightLog
from diagnosis.result import Diagnosis


def with_fault(flights, name, **parameters):
    return ALL[name].apply(flights, parameters)


def test_nothing_is_wrong_with_clean_flights(clean):
    assert found(clean) == ()


NAMED = {
    "body_velocity": ("velocity", "the velocity in the body frame"),
    "swapped_tilt": ("attitude command", "roll and pitch exchanged"),
    "flipped_pitch": ("attitude command", "pitch with the opposite sign"),
    "flipped_axis": ("attitude", "a path whose y axis points the other way"),
    "swapped_axes": ("attitude", "a path with x and y exchanged"),
    "inverse_attitude": ("attitude", "the attitude from world to body"),
    "scalar_first": ("attitude", "quaternions with the scalar first"),
}
"""Faults of order and sign with the part that is blamed and its first reading."""


@pytest.mark.parametrize("name", NAMED)
def test_a_fault_of_order_or_sign_is_named_alone(clean, name):
    (fault,) = found(with_fault(clean, name))
    assert (fault.part, fault.readings[0]) == NAMED[name]
    assert fault.part in PARTS
    asked, explained = fault.evidence
    assert asked.value < explained.value > 0.5
    assert "\n" not in fault.advice


@pytest.mark.parametrize(
    ("name", "parameters", "part", "value"),
    [
        ("path_turned_in_yaw", {"angle": 0.26}, "frame of the path", 15.0),
        ("path_turned_in_yaw", {"angle": 0.785}, "frame of the path", 45.0),
        ("path_turned_in_yaw", {"angle": -1.2}, "frame of the path", -68.8),
        ("path_turned_in_yaw", {"angle": 2.2}, "frame of the path", 126.1),
        ("tilt_turned_in_yaw", {"angle": -0.26}, "frame of the commands", -15.0),
        ("tilt_turned_in_yaw", {"angle": 0.7}, "frame of the commands", 40.1),
        ("tilt_turned_in_yaw", {"angle": -1.0}, "attitude command", -57.3),
        ("tilt_turned_in_yaw", {"angle": 2.0}, "attitude command", 114.6),
        ("thrust_gain", {"e": 1.0}, "thrust", 0.5),
        ("thrust_gain", {"e": -0.5}, "thrust", 2.0),
    ],
)
def test_a_fault_of_size_is_measured(clean, name, parameters, part, value):
    (fault,) = found(with_fault(clean, name, **parameters))
    (evidence,) = fault.evidence
    assert fault.part == part
    assert evidence.low < value < evidence.high
    assert evidence.value == pytest.approx(value, rel=0.15)


@pytest.mark.parametrize(("seconds", "word"), [(-0.3, "late"), (0.35, "early")])
def test_a_clock_that_is_off_is_named(clean, seconds, word):
    shifted = with_fault(clean, "delay", seconds=seconds)
    faults = {fault.part: fault for fault in found(shifted)}
    assert faults["command clock"].readings == (f"commands stamped {word}",)


def test_a_mass_in_pounds_is_told_from_a_wrong_thrust(clean):
    pounds = dataclasses.replace(clean.vehicle, mass=2.2046 * clean.vehicle.mass)
    (fault,) = found(dataclasses.replace(clean, vehicle=pounds))
    assert fault.readings == ("a mass in pounds",)
    assert "is the mass in pounds?" in fault.advice


def test_changes_of_the_vehicle_are_left_to_physics(clean):
    for name, parameters in (
        ("thrust_gain", {"e": -0.2}),
        ("believed_mass", {"e": 0.25}),
        ("attitude_gain", {"g": -0.2}),
        ("trim", {"roll": 0.05, "pitch": -0.05}),
        ("delay", {"seconds": 0.06}),
        ("yaw_misalignment", {"angle": 0.25}),
    ):
        assert found(with_fault(clean, name, **parameters)) == (), name


def test_beside_a_reference_a_small_turn_of_the_path_is_named(clean):
    turned = with_fault(clean, "path_turned_in_yaw", angle=0.087)
    assert found(turned) == ()  # by itself it is within what markers are set by
    (fault,) = found(turned, clean)
    assert fault.part == "frame of the path since the reference"
    assert fault.readings == ("turned by 5 degrees in yaw",)
    (evidence,) = fault.evidence
    assert evidence.low < 5.0 < evidence.high
    assert found(with_fault(clean, "path_turned_in_yaw", angle=0.035), clean) == ()
    assert found(turned, turned) == ()


def test_beside_a_reference_what_both_have_is_no_change(clean):
    for name, parameters in (
        ("path_turned_in_yaw", {"angle": 0.26}),
        ("tilt_turned_in_yaw", {"angle": -0.26}),
        ("thrust_gain", {"e": -0.5}),
        ("delay", {"seconds": -0.3}),
    ):
        off = with_fault(clean, name, **parameters)
        (fault,) = found(off)
        assert found(off, off) == (), name
        since = " since the reference" if fault.part == "frame of the path" else ""
        assert [one.part for one in found(off, clean)] == [fault.part + since], name


def test_a_path_that_is_turned_since_the_reference_is_turned_back(clean):
    turned = with_fault(clean, "path_turned_in_yaw", angle=0.17)
    back = mended(turned, found(turned, clean))
    assert found(back, clean) == ()
    for one, was in zip(back.flights, clean.flights, strict=True):
        np.testing.assert_allclose(one.drones[0].pos, was.drones[0].pos, atol=0.05)
        np.testing.assert_array_equal(one.drones[0].quat, was.drones[0].quat)
    assert mended(clean, found(clean, clean)) is clean


def test_an_order_is_wrong_beside_a_reference_that_has_it_too(clean):
    flipped = with_fault(clean, "flipped_pitch")
    parts = ["attitude command", "attitude command of the reference"]
    assert [fault.part for fault in found(flipped, flipped)] == parts


@pytest.mark.parametrize("fault", ["flipped_axis", "inverse_attitude"])
def test_no_turn_is_read_from_a_reference_whose_attitude_is_wrong(clean, fault):
    turned = with_fault(clean, "path_turned_in_yaw", angle=0.087)
    (told,) = found(turned, with_fault(clean, fault))
    assert told.part == "attitude of the reference"
    assert told.advice.startswith("In the reference flights: the attitude looks like ")


def test_a_path_that_was_turned_nearly_as_much_before_is_no_fault(clean):
    """One is within what markers are set by, the other is not; what both share falls out."""
    less, more = (with_fault(clean, "path_turned_in_yaw", angle=a) for a in (0.08, 0.11))
    assert [fault.part for fault in found(more)] == ["frame of the path"]
    assert found(more, less) == ()


@pytest.mark.parametrize("n", [1, 6])
def test_a_reversed_heading_is_named_from_one_flight_too(clean, n):
    drones = [flight.drones[0] for flight in clean.flights[:n]]
    rng = np.random.default_rng(0)
    made = []
    for drone in drones:
        cmd = drone.cmd.copy()
        cmd[:, 2] = faults.measured(drone)[:, 8] + np.pi + 0.03 * rng.normal()
        made.append(dataclasses.replace(drone, cmd=cmd))
    fault = faults._heading(made)
    assert fault is not None
    assert abs(fault.evidence[0].value) == pytest.approx(180.0, abs=3.0)
    assert faults._heading(drones) is None


def test_a_heading_that_is_off_by_much_more_than_before_is_a_fault(clean):
    def off(angle):
        made = []
        for flight in clean.flights:
            (drone,) = flight.drones
            cmd = drone.cmd.copy()
            cmd[:, 2] = faults.measured(drone)[:, 8] - angle
            made.append(dataclasses.replace(flight, drones=(dataclasses.replace(drone, cmd=cmd),)))
        return dataclasses.replace(clean, flights=tuple(made))

    once, twice, more = off(0.7), off(0.75), off(2.2)
    assert "heading" in {fault.part for fault in found(once)}
    assert "heading" not in {fault.part for fault in found(twice, once)}
    assert "heading" in {fault.part for fault in found(more, once)}
    assert "heading" in {fault.part for fault in found(off(-2.9), once)}


def test_beside_a_reference_the_turn_since_then_counts_where_both_are_off(clean):
    left, right = (with_fault(clean, "path_turned_in_yaw", angle=a) for a in (0.26, -0.26))
    (fault,) = found(left, right)
    assert fault.part == "frame of the path since the reference"
    assert fault.evidence[0].value == pytest.approx(29.8, abs=2.0)


def turning(order=(0, 1, 2, 3), n=6, gyro="body"):
    """Logs of a drone that is turned by its motors, which stand in columns by `order`."""
    rng, flights, dt = np.random.default_rng(4), [], 0.01
    for _ in range(n):
        rows = 1000
        t = dt * np.arange(rows)
        k, phase = rng.uniform(2, 9, (2, 4)), rng.uniform(0, 6, (2, 4))
        wave = np.sum(np.cos(k[..., None] * t + phase[..., None]), axis=1)
        yaw = 0.8 * np.sin(0.7 * t + rng.uniform(0, 6))
        rpy = np.stack([*(0.05 * wave), yaw], axis=1)
        turns = Rotation.from_euler("xyz", rpy)
        w = np.gradient(np.unwrap(rpy, axis=0), dt, axis=0)
        body = (turns[:-1].inv() * turns[1:]).as_rotvec() / dt
        body = np.concatenate([body, body[-1:]])
        moment = np.gradient(w[:, :2], dt, axis=0)
        motors = np.sqrt(0.4 + 0.0005 * moment @ MOMENTS)
        acc = turns.as_matrix()[:, :, 2] * 9.81
        vel = np.cumsum(acc - [0, 0, 9.81], axis=0) * dt
        ang_vel = turns.apply(body) if gyro == "world" else body
        path = np.cumsum(vel, axis=0) * dt
        path[:, 2] += 1.0 - path[:, 2].min()
        flights.append(
            DroneLog(
                t=t,
                pos=path + rng.normal(0, 1e-3, (rows, 3)),
                vel=vel,
                quat=turns.as_quat(),
                ang_vel=ang_vel + rng.normal(0, 0.05, (rows, 3)),
                acc=np.tile([0.0, 0.0, 9.81], (rows, 1)) + rng.normal(0, 0.1, (rows, 3)),
                pwm=motors[:, list(order)],
                battery=np.full(rows, 3.8),
            )
        )
    return flights


def ordered(logs):
    return motor_order([piece for log in logs for piece in turnings(log)])


@pytest.mark.parametrize("order", [(3, 2, 1, 0), (1, 0, 2, 3), (2, 3, 0, 1)])
def test_motors_in_another_order_are_named(order):
    chosen = ordered(turning(order, n=12))
    assert chosen is not None
    numbers = ", ".join(str(i + 1) for i in order)
    assert chosen.names == (f"motors {numbers} in columns 1 to 4",)


def test_motors_in_order_and_motors_that_tell_nothing_are_no_fault():
    assert ordered(turning(n=12)) is None
    rng = np.random.default_rng(0)
    logs = [
        dataclasses.replace(log, pwm=rng.uniform(0.4, 0.6, (len(log.t), 4))) for log in turning()
    ]
    assert ordered(logs) is None
    assert turning_lag([turnings(log) for log in logs]) is None


def flown(logs):
    return flight_set([FlightLog(f"f{i}", (log,)) for i, log in enumerate(logs)])


def drones(flights):
    return [flight.drones[0] for flight in flights.flights]


def parts(logs, reference=None):
    faults = found(flown(logs), reference)
    return {fault.part: fault.readings for fault in faults if fault.part != "thrust"}


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (0.02, ("motor commands stamped early", "slower motors")),
        (-0.04, ("motor commands stamped late", "faster motors")),
        (0.0, None),
    ],
)
def test_beside_a_reference_motors_that_act_later_are_named(seconds, expected):
    logs = turning(n=16)
    since = parts([shifted(log, seconds) for log in logs[:8]], flown(logs[8:]))
    assert since == ({"motor clock since the reference": expected} if expected else {})


def test_the_time_that_motors_take_is_measured():
    lags = [turning_lag([turnings(shifted(log, s)) for log in turning(n=8)]) for s in (0.0, 0.03)]
    for lag, true in zip(lags, (0.0, 0.03), strict=True):
        assert lag is not None
        assert lag.value == pytest.approx(true, abs=0.006)  # inputs are held for a row of 0.01 s


@pytest.mark.parametrize("rate", [0.005, -0.02])
def test_a_motor_clock_that_drifts_is_measured_and_put_right(rate):
    logs = turning(n=8)
    wrong = flown([shifted(log, 0.0, rate) for log in logs])
    faults = found(wrong, flown(turning(n=8)))
    (fault,) = (fault for fault in faults if fault.part != "thrust")
    assert fault.part == "motor clock"
    (evidence,) = fault.evidence
    assert evidence.low < 1e3 * rate / (1.0 + rate) < evidence.high
    assert evidence.value == pytest.approx(1e3 * rate, rel=0.15)
    right = mended(wrong, faults)
    assert MOTOR_CLOCK not in {fault.part for fault in found(right)}
    for log, then, now in zip(logs, drones(wrong), drones(right), strict=True):
        off = [
            np.abs(one.pwm - log.pwm[np.isin(log.t, one.t)])[-100:].mean() for one in (then, now)
        ]
        assert off[1] < 0.6 * off[0]  # inputs are held for a row of 0.01 s


def test_a_drifting_clock_of_the_reference_is_said_of_it_and_put_right():
    wrong = flown([shifted(log, 0.0, 0.01) for log in turning(n=8)])
    faults = found(flown(turning(n=8)), wrong)
    assert {fault.part for fault in faults} - {"thrust"} == {of_reference(MOTOR_CLOCK)}
    right = in_time(wrong, faults, of_reference(MOTOR_CLOCK))
    assert MOTOR_CLOCK not in {fault.part for fault in found(right)}


def test_gyroscope_and_accelerometer_are_checked_against_attitude_and_path():
    assert parts(turning()) == {}
    world = parts(turning(gyro="world"))
    assert world == {"angular velocity": ("the angular velocity in the world frame",)}
    flip = [
        dataclasses.replace(log, ang_vel=log.ang_vel * np.asarray([1.0, -1.0, 1.0]))
        for log in turning()
    ]
    assert parts(flip) == {"angular velocity": ("y with the opposite sign",)}


def test_the_test_of_readings_keeps_its_level():
    """Two readings with the same errors: the one asked for falls as rarely as it is said to."""
    rng, alarms = np.random.default_rng(1), 0
    for _ in range(2000):
        errors = np.sum(rng.normal(size=(2, 40)) ** 2, axis=1)
        chosen = choose([Reading("", errors[0]), Reading("x", errors[1], 1)], 1e3, 40)
        assert chosen is not None
        alarms += bool(chosen.names)
    assert alarms <= 6  # 0.0005 of 2000 is 1; the chance of more than 6 is below 1e-4


def test_readings_that_explain_nothing_say_nothing():
    assert choose([Reading("", 100.0), Reading("x", 60.0, 1)], 100.0, 50) is None
    assert choose([Reading("", 100.0), Reading("x", 1.0, 1)], 100.0, 4) is None


def test_orders_are_all_there_once():
    orders = signed_orders(3)
    assert len(orders) == 48
    assert len({words for words, _, _ in orders}) == 48
    np.testing.assert_array_equal(orders[0][2], np.eye(3))


def test_a_fault_stands_in_the_documents_before_physics(clean):
    (fault,) = found(with_fault(clean, "thrust_gain", e=-0.5))
    answer = dataclasses.replace(load(none()), interface=(fault,))
    assert Diagnosis.of_json(answer.to_json()) == answer
    text, page = diagnosis_text(answer), diagnosis_page(answer)
    for document in (text, page):
        assert "The simulator makes about 2 times the thrust that these flights show" in document
        assert document.index("What the logs say wrongly") < document.index("What explains it")
        assert "0.625 to 1.6" in document
    assert remarks(answer)[0] == fault.advice
    assert "What the logs say wrongly" not in diagnosis_text(load(none()))


def test_the_jackknife_of_a_mean_is_students_interval():
    x = np.asarray([1.0, 2.0, 4.0, 7.0])
    size = scales.jackknife(4, lambda some: float(x[list(some)].mean()))
    assert size is not None
    reach = 12.924 * x.std(ddof=1) / 2.0  # Student's t of 3 at 0.0005
    assert size.high - size.value == pytest.approx(reach, rel=1e-3)


@pytest.mark.parametrize("name", ["crazyflie_plain", "nanobench"])
def test_halves_of_real_flights_differ_by_no_fault(name):
    flights = real(name)
    halves = (dataclasses.replace(flights, flights=flights.flights[i::2]) for i in (0, 1))
    assert found(*halves) == ()


@pytest.mark.parametrize(
    ("name", "count", "expected"),
    [
        ("crazyflie_plain", 18, []),
        ("crazyflie_changed", 4, []),
        ("nanobench", 25, ["thrust"]),
    ],
)
def test_real_flights_load_as_they_are_and_have_the_faults_that_they_have(name, count, expected):
    """The map from duty to thrust is that of other motors: thrust comes out twice too large."""
    flights = real(name)
    assert flights.left_out == ()
    assert len(flights.flights) == count
    faults = found(dataclasses.replace(flights, flights=flights.flights[:8]))
    assert [fault.part for fault in faults] == expected
    for fault in faults:
        assert "times the thrust that these flights show" in fault.advice
