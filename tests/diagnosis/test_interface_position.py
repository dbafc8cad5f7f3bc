"""Position columns that are upside down, exchanged or mirrored, and checks that want motion."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import edited, flight_set, real

from bench.diagnosis_report.sentences import not_checked
from blind.draw.faults import ALL
from diagnosis.interface.fault import Untold
from diagnosis.interface.faults import checks
from diagnosis.interface.faults import interface_faults as found
from diagnosis.interface.mended import lifted, lowest
from diagnosis.interface.position import rise
from diagnosis.interface.readings import Reading, choose, choose_signs, remainder
from diagnosis.interface.untold import untold
from diagnosis.logs.flights import DroneLog, FlightLog

FLIPPED = {"x": np.diag([-1.0, 1.0, 1.0]), "z": np.diag([1.0, 1.0, -1.0])}
EXCHANGED = np.asarray([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def changed(flights, matrix, *columns):
    """The flights with these columns in other axes."""
    return edited(flights, lambda log: {name: getattr(log, name) @ matrix.T for name in columns})


def said(flights, reference=None):
    """Part and advice of every fault but the thrust's."""
    faults = found(flights, reference)
    return [(fault.part, fault.advice) for fault in faults if fault.part != "thrust"]


DOWN = (
    "position",
    "The position looks like a path whose z axis points down: check pos_z and vel_z.",
)


@pytest.mark.parametrize(
    ("name", "n"), [("crazyflie_plain", 18), ("crazyflie_changed", 4), ("nanobench", 8)]
)
def test_real_flights_that_are_upside_down_are_named(name, n):
    flights = real(name, n)
    down = changed(flights, FLIPPED["z"], "pos", "vel")
    assert said(flights) == []
    assert said(down) == [DOWN]
    assert said(down, flights) == [DOWN]
    fault = next(fault for fault in found(down) if fault.part == "position")
    (evidence,) = fault.evidence
    assert evidence.low < evidence.value < evidence.high < 0.0


@pytest.mark.parametrize(("name", "n"), [("crazyflie_plain", 18), ("nanobench", 8)])
def test_one_column_of_height_is_told_from_the_other(name, n):
    flights = real(name, n)
    position, velocity = (said(changed(flights, FLIPPED["z"], c)) for c in ("pos", "vel"))
    assert position == [("position", "z of the position has the opposite sign: check pos_z.")]
    assert velocity == [
        (
            "velocity",
            "The velocity looks like z with the opposite sign: check columns vel_x to vel_z.",
        )
    ]


@pytest.mark.parametrize("n", [1, 5, 18])
def test_exchanged_position_columns_are_accused_themselves(n):
    flights = real("crazyflie_plain", n)
    exchanged = changed(flights, EXCHANGED, "pos")
    advice = "x and y of the position are exchanged: check pos_x and pos_y."
    assert said(exchanged) == [("position", advice)]
    assert said(exchanged, real("crazyflie_plain")) == [("position", advice)]


def test_a_mirrored_position_column_is_accused_itself():
    flights = real("nanobench", 5)
    advice = "x of the position has the opposite sign: check pos_x."
    assert said(changed(flights, FLIPPED["x"], "pos")) == [("position", advice)]


def test_an_axis_that_moves_little_is_named_beside_one_that_moves_much():
    """These vehicles fly along y: all axes together explain 97 % whatever the sign of pitch."""
    flights = real("crazyflie_plain", 5)
    flipped = ALL["flipped_pitch"].apply(flights, {})
    (fault,) = found(flipped)
    assert fault.readings == ("pitch with the opposite sign",)
    (fault,) = found(changed(real("crazyflie_plain"), FLIPPED["x"], "vel"))
    assert (fault.part, fault.readings) == ("velocity", ("x with the opposite sign",))


def test_exchanged_commands_of_one_short_flight_are_named():
    flights = real("crazyflie_plain", 1)
    assert found(flights) == ()
    (fault,) = found(ALL["swapped_tilt"].apply(flights, {}))
    assert fault.readings[0] == "roll and pitch exchanged"


def test_what_one_flight_along_y_does_not_tell_is_listed():
    flights = real("crazyflie_plain", 1)
    assert found(ALL["flipped_pitch"].apply(flights, {})) == ()
    parts = untold(flights, checks(flights))
    assert Untold(part="attitude command", what="sign of commanded pitch", fly=("x",)) in parts
    assert Untold(part="attitude", what="sign of the path's x axis", fly=("x",)) in parts
    assert {one.part for one in parts} >= {"position", "velocity"}
    (line,) = not_checked(parts)
    assert line.startswith("Not checked for want of motion: ")
    assert "fly steps in x" in line


def test_flights_that_tell_everything_leave_nothing_unchecked():
    flights = real("nanobench", 5)
    assert untold(flights, checks(flights)) == ()
    assert not_checked(()) == []


def test_simulated_flights_rise_with_their_thrust_until_they_are_upside_down(clean):
    upright = checks(clean).rise
    assert upright is not None
    assert upright.low > 0.0
    assert said(changed(clean, FLIPPED["z"], "pos", "vel")) == [DOWN]


def below(flights, height):
    """The flights with an origin so far above the floor."""
    return edited(flights, lambda log: {"pos": log.pos - [0.0, 0.0, height]})


def test_heights_below_the_floor_are_said_and_the_flights_raised(clean):
    assert lifted(clean) is clean
    sunk = below(clean, 3.0)
    (fault,) = found(sunk)
    low = lowest(sunk)
    assert fault.part == "height"
    assert f"raised by {-low:.2f} m" in fault.advice
    assert lowest(lifted(sunk)) == pytest.approx(0.0, abs=1e-9)
    assert found(sunk, sunk) == ()  # the reference has the same origin


@pytest.mark.parametrize("seconds", [-0.3, 0.35])
def test_a_wrong_clock_is_not_taken_for_a_path_that_points_down(clean, seconds):
    late = ALL["delay"].apply(clean, {"seconds": seconds})
    assert [fault.part for fault in found(late)] == ["command clock"]


def hovering(rng, rows=1000):
    """The log of a drone that hovers; its thrust is noise that its path does not show."""
    t = 0.01 * np.arange(rows)
    cmd = np.zeros((rows, 4))
    cmd[:, 3] = 0.3 * (1.0 + 0.01 * rng.normal(size=rows))
    return DroneLog(
        t=t,
        pos=np.asarray([0.0, 0.0, 1.0]) + rng.normal(0, 1e-3, (rows, 3)) * np.sign(t)[:, None],
        vel=rng.normal(0, 1e-2, (rows, 3)),
        quat=np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1)),
        cmd=cmd,
    )


def test_a_hover_says_nothing_of_up_and_down():
    rng = np.random.default_rng(3)
    for _ in range(3):
        logs = [hovering(rng) for _ in range(8)]
        for log in logs:
            log.pos[0, 2] -= 1.0
        flights = flight_set([FlightLog(f"f{i}", (log,)) for i, log in enumerate(logs)])
        assert [fault for fault in found(flights) if fault.part == "position"] == []
        parts = {one.part for one in untold(flights, checks(flights))}
        assert {"position", "velocity", "attitude"} <= parts


def test_no_rise_is_read_from_constant_inputs(clean):
    windows = checks(clean).windows
    assert windows is not None
    assert windows.lift is not None
    constant = dataclasses.replace(windows, lift=np.ones_like(windows.lift))
    level = dataclasses.replace(constant, rotation=np.tile(np.eye(3), (len(windows), 1, 1)))
    assert rise(level) is None
    assert rise(dataclasses.replace(windows, lift=None)) is None


def test_the_test_of_one_sign_keeps_its_level():
    rng, alarms, untold_axes = np.random.default_rng(1), 0, 0
    for _ in range(500):
        y, u, leak = rng.normal(size=(3, 60))
        free = np.column_stack([leak, np.ones(60)])
        errors = [remainder(y, free, sign * u) for sign in (1.0, -1.0)]
        readings = [Reading("", errors[0]), Reading("x", errors[1], 1)]
        clean = choose([Reading("", 0.1)], 1.0, 60)
        chosen = choose_signs(clean, {"x": (readings, remainder(y, free), 60)})
        assert chosen is not None
        alarms += bool(chosen.names)
        untold_axes += chosen.untold == ("x",)
    assert alarms == 0  # noise explains half of nothing
    assert untold_axes == 500


def test_a_command_in_proportion_to_the_other_tells_no_sign():
    """A turned frame and a controller that makes up for most of it: pitch opposes its command."""
    mixed = np.eye(4)
    mixed[1, :2] = -0.2, 0.0
    flights = changed(real("crazyflie_changed", 1), mixed, "cmd")
    made = checks(flights).compared["attitude command"]
    assert made is None or "pitch with the opposite sign" not in made.names


FOOT = 0.3048


def in_other_units(flights, pos=1.0, vel=1.0):
    """The flights with numbers that are so many times as large."""
    return flights.each(lambda log: dataclasses.replace(log, pos=pos * log.pos, vel=vel * log.vel))


@pytest.mark.parametrize(
    ("pos", "vel", "part", "asked"),
    [
        (1.0, 1 / FOOT, "velocity", "Is it in feet per second"),
        (1.0, 1.944, "velocity", "Is it in knots"),
        (1 / FOOT, 1.0, "position", "Is it in feet?"),
        (1 / FOOT, 1 / FOOT, "position", "Is it in feet?"),
    ],
)
@pytest.mark.parametrize("n", [6, 1])
def test_positions_and_velocities_in_other_units_are_named_alone(clean, pos, vel, part, asked, n):
    some = dataclasses.replace(clean, flights=clean.flights[:n])
    flights = in_other_units(some, pos, vel)
    made = checks(flights)
    (fault,) = found(flights, made=made)
    assert fault.part == part
    assert asked in fault.advice
    assert ("vel_x to vel_z" in fault.advice) == (vel != 1.0)
    assert untold(flights, made) == untold(some, checks(some))


def test_a_velocity_that_an_estimator_makes_too_small_by_a_fifth_is_no_fault(clean):
    assert found(in_other_units(clean, vel=0.8)) == ()
    assert found(in_other_units(clean, pos=0.8, vel=0.8)) == ()


@pytest.mark.parametrize("name", ["crazyflie_changed", "crazyflie_plain", "nanobench"])
def test_feet_are_told_in_real_flights(name):
    flights = real(name, 8)
    assert checks(flights).units is None
    for pos, vel, part in ((1.0, 1 / FOOT, "velocity"), (1 / FOOT, 1 / FOOT, "position")):
        fault = checks(in_other_units(flights, pos, vel)).units
        assert fault is not None
        assert fault.part == part
        shown = [one.value for one in fault.evidence]
        assert shown[part == "position"] == pytest.approx(pos / vel if pos == 1.0 else pos, rel=0.2)
