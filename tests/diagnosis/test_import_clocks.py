"""Streams with clocks of their own become rows on one clock."""

import dataclasses

import numpy as np
import pytest
from import_logs_for_tests import circle, streams, without

from diagnosis.importing.reader import Request, Stream
from diagnosis.importing.resample import make_rows
from diagnosis.importing.ulog import px4_streams


def column(rows, *names):
    return np.stack([rows.columns[name] for name in names], axis=1)


def test_rows_on_one_clock_stay_as_they_are():
    log = circle()
    rows = make_rows(streams(log), 0.0)
    np.testing.assert_array_equal(rows.columns["t"], log.t)
    np.testing.assert_array_equal(column(rows, "pos_x", "pos_y", "pos_z"), log.pos)
    assert {taken.resampling for taken in rows.taken} == {"rows as logged"}


def test_rows_are_as_fast_as_the_slowest_measurement():
    """So that no measurement counts twice; 62.5 Hz here."""
    rows = make_rows(streams(circle(), {"pos": 4, "vel": 4, "quat": 2}), 0.0)
    assert np.median(np.diff(rows.columns["t"])) == pytest.approx(0.016)
    assert rows.notes == ()


def test_slow_positions_are_interpolated_and_the_report_says_so():
    """Position at 10 Hz and attitude at 50 Hz; a circle of 0.5 m with 2 rad/s."""
    log = circle()
    rows = make_rows(streams(log, {"pos": 25, "vel": 25, "quat": 5}), 0.0)
    t = rows.columns["t"]
    assert np.median(np.diff(t)) == pytest.approx(0.02)
    pos, vel = column(rows, "pos_x", "pos_y"), column(rows, "vel_x", "vel_y")
    np.testing.assert_allclose(pos, np.stack([np.cos(2 * t), np.sin(2 * t)], 1) / 2, atol=1e-4)
    np.testing.assert_allclose(vel, np.stack([-np.sin(2 * t), np.cos(2 * t)], 1), atol=2e-4)
    measured = t[rows.columns["interpolated"] == 0.0]
    np.testing.assert_allclose(measured, np.arange(len(measured)) / 10.0, atol=1e-9)
    (note,) = rows.notes
    assert "Slower than the rows (50 Hz): pos (10 Hz), vel (10 Hz)" in note


def test_a_command_is_neither_delayed_nor_lost():
    """A single step of the commands between two rows keeps its place in time, for any phase."""
    log = circle()
    plain = [s for s in streams(log, {"pos": 5, "vel": 5, "quat": 5}) if "cmd" not in s.field]
    for shift in (0.0, 0.007, 0.013, 0.019):
        t = np.arange(0.0, 2.99, 0.01) + shift
        step = np.where(t[:, None] > 1.5, 0.5, 0.3)
        rows = make_rows(
            [
                *plain,
                Stream("cmd_angles", t, np.zeros((len(t), 3)), "angles"),
                Stream("cmd_thrust", t, step, "thrust"),
            ],
            0.0,
        )
        at, thrust = rows.columns["t"], rows.columns["cmd_thrust"]
        # The time of the step, from the area under what the rows hold until the next one.
        high = np.sum((thrust[:-1] - 0.3) / 0.2 * np.diff(at))
        first = t[np.argmax(t > 1.5)]
        assert at[-1] - high == pytest.approx(first, abs=1e-6)


def test_a_hole_stays_a_hole():
    log = circle()
    parts = streams(log, {"pos": 5, "vel": 5})
    parts[2] = without(parts[2], 1.0, 1.2)
    t = make_rows(parts, 0.0).columns["t"]
    assert not ((t > 1.001) & (t < 1.199)).any()
    assert np.diff(t).max() == pytest.approx(0.22, abs=0.021)


def test_one_lost_message_is_bridged():
    parts = streams(circle(), {"pos": 5, "vel": 5})
    parts[0] = without(parts[0], 0.99, 1.01)
    assert np.diff(make_rows(parts, 0.0).columns["t"]).max() < 0.0201


def test_a_velocity_that_was_not_logged_is_derived():
    log = circle()
    parts = [s for s in streams(log, {"quat": 2}) if s.field != "vel"]
    rows = make_rows(parts, 0.0)
    t = rows.columns["t"]
    inner = (t > 0.1) & (t < t[-1] - 0.1)
    vel = column(rows, "vel_x", "vel_y")[inner]
    truth = np.stack([-np.sin(2 * t), np.cos(2 * t)], 1)[inner]
    np.testing.assert_allclose(vel, truth, atol=3e-3)  # a cubic's share within 0.06 s
    assert any("derived from positions" in note for note in rows.notes)


def test_rows_out_of_order_and_twice_are_put_right():
    log = circle()
    parts = streams(log)
    order = np.arange(len(log.t))
    order[[100, 101]] = order[[101, 100]]
    order = np.insert(order, 50, 50)
    parts[0] = Stream("pos", log.t[order], log.pos[order], "pos")
    rows = make_rows(parts, 0.0)
    np.testing.assert_array_equal(column(rows, "pos_x", "pos_y", "pos_z"), log.pos)
    assert [taken.dropped for taken in rows.taken if taken.field == "pos"] == [1]


def test_positions_that_px4_calls_invalid_are_dropped_and_counted():
    log = circle()
    columns = np.concatenate([log.pos, log.vel], axis=1).T[[1, 0, 2, 4, 3, 5]]
    table = dict(zip(("x", "y", "z", "vx", "vy", "vz"), columns, strict=True))
    table |= {"timestamp": 1e6 * log.t, "xy_valid": np.arange(len(log.t)) >= 7}
    request = Request(mass=0.032, thrust_max=0.6)
    parts, _, _ = px4_streams({"vehicle_local_position": table}, request, None)
    rows = make_rows([*parts, *streams(log)[2:]], 0.0)
    assert [taken.dropped for taken in rows.taken[:2]] == [7, 0]
    assert rows.columns["t"][0] == pytest.approx(log.t[7])


def test_a_field_with_too_few_rows_is_left_out_and_the_report_says_so():
    log = circle()
    acc = Stream("acc", log.t[:3], np.zeros((3, 3)), "imu")
    rows = make_rows([*streams(log), acc], 0.0)
    assert "acc_x" not in rows.columns
    assert rows.notes == (
        "acc (imu) is left out, because 3 of its 3 rows are usable and 4 are needed.",
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s[1:], "no position was found; found: vel"),
        (lambda s: s[:2] + s[3:], "no attitude was found; found: pos"),
        (lambda s: s[:3], "no input was found: commanded attitude and thrust"),
        (lambda s: [shifted(s[0], 1e4), *s[1:]], "do not overlap in time: pos 10000.000 to"),
        (lambda s: [doubled(s[0]), *s[1:]], "time goes backwards .* two logs in one file"),
        (lambda s: [appended(s[0]), *s[1:]], "time goes backwards 1 times; are there two logs"),
        (lambda s: [*s[:2], scaled(s[2], 1.2), *s[3:]], "a quaternion has the norm 1.2; 1 is"),
        (lambda s: [scaled(s[0], 1e9), *s[1:]], "a number is beyond 100000; the log is damaged"),
    ],
)
def test_what_cannot_be_a_flight_is_named(change, message):
    with pytest.raises(ValueError, match=message):
        make_rows(change(streams(circle())), 0.0)


def shifted(stream, seconds):
    return dataclasses.replace(stream, t=stream.t + seconds)


def scaled(stream, factor):
    return dataclasses.replace(stream, values=stream.values * factor)


def appended(stream):
    """One log behind another in the same file."""
    twice = {
        name: np.concatenate([x, x]) for name, x in (("t", stream.t), ("values", stream.values))
    }
    return dataclasses.replace(stream, **twice)


def doubled(stream):
    values = np.tile(stream.values, (30, 1))
    return dataclasses.replace(
        stream, t=np.tile(stream.t[:25], 90)[: len(values)], values=values[:2250]
    )


@pytest.mark.parametrize("vel", [5, 12, 25])
def test_a_velocity_slower_than_rows_and_positions_is_derived_anew(vel):
    """Interpolated rows of it would count as measured, with far less noise than it has."""
    rows = make_rows(streams(circle(), {"pos": 2, "vel": vel, "quat": 2}), 0.0)
    derived = any("velocity is slower than the position" in note for note in rows.notes)
    assert derived == (vel > 5)  # of 250 rows a second
    assert "interpolated" not in rows.columns


def test_rows_between_slow_attitudes_are_marked():
    rows = make_rows(streams(circle(), {"pos": 2, "vel": 2, "quat": 12}), 0.0)
    measured = rows.columns["t"][rows.columns["interpolated"] == 0.0]
    assert np.median(np.diff(measured)) == pytest.approx(0.048, abs=0.02)


def test_thrust_alone_drives_a_replay_and_attitudes_alone_do_not():
    every = streams(circle())
    rows = make_rows([s for s in every if s.field != "cmd_angles"], 0.0)
    assert "cmd_thrust" in rows.columns
    assert "cmd_roll" not in rows.columns
    pwm = Stream("pwm", every[0].t, np.full((len(every[0].t), 4), 0.5), "motors")
    volts = Stream("battery", every[0].t, np.full((len(every[0].t), 1), 4.0), "battery")
    rows = make_rows([*(s for s in every if s.field != "cmd_thrust"), pwm, volts], 0.0)
    assert "pwm_1" in rows.columns
    assert "cmd_roll" not in rows.columns
    assert any("commanded attitude is left out" in note for note in rows.notes)


def test_messages_that_come_in_pairs_hold_no_holes():
    """2 ms and 18 ms apart, as a radio's batches are."""
    log = circle()
    kept = np.sort(np.concatenate([np.arange(0, 745, 5), np.arange(0, 745, 5) + 1]))
    pairs = [dataclasses.replace(s, t=s.t[kept], values=s.values[kept]) for s in streams(log)]
    later = [dataclasses.replace(s, t=s.t + 1e-3 * (i % 2)) for i, s in enumerate(pairs)]
    rows = make_rows(later, 0.0)
    assert np.diff(rows.columns["t"]).max() < 0.03
