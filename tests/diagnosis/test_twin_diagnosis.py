"""What a twin says of changed flights, as a typed diagnosis; and when a twin is asked."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from flights_for_tests import all_but
from test_twin import EVERY, LIBRARY, column, flight, long_flight, plain_twin

from diagnosis.decide.prepared import Question
from diagnosis.logs.flights import DroneLog, FlightLog, FlightSet, VehicleFile
from diagnosis.logs.inputs import Inputs, choose_inputs
from diagnosis.replay.library import make_library
from diagnosis.result import Diagnosis
from diagnosis.twin import flown as flown_channels
from diagnosis.twin.answer import ChangedParameter
from diagnosis.twin.as_diagnosis import _parameters as as_parameters
from diagnosis.twin.as_diagnosis import alone, as_diagnosis, weighed_anew
from diagnosis.twin.diagnose_change import ChangeStudy, answer_change
from diagnosis.twin.flown import reference_channels, twin_replay
from diagnosis.twin.twin import make_twin
from simulators.crazyflow import Crazyflow

T = np.arange(0.0, 6.0, 0.01)


def log(name, drones=1):
    zero = np.zeros((len(T), 3))
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1))
    cmd = np.concatenate([zero, np.full((len(T), 1), 0.31)], axis=1)
    one = DroneLog(t=T, pos=zero + 1.0, vel=zero, quat=quat, cmd=cmd)
    return FlightLog(name, (one,) * drones)


def flown(names, mass=0.032, drones=1):
    vehicle = VehicleFile(name="a drone", drone="cf2x_L250", mass=mass)
    return FlightSet(Path("flights"), vehicle, tuple(log(name, drones) for name in names), ())


def study(change=(), n=8, odd=False):
    """The question and the study of flights whose channels are made, not flown."""
    targets = [flight(100 + i, change) for i in range(n)]
    if odd:
        targets[0] = dataclasses.replace(targets[0], measured=targets[0].measured * 2.0)
    return study_of(plain_twin(), targets)


def study_of(twin, targets):
    """The question and the study of some flights beside a twin."""
    answer, scored = answer_change(twin, targets)
    sets = flown([f.name for f in targets]), flown([score.name for score in twin.scores])
    driven = [Inputs(one.flights, False, "commands", ()) for one in sets]
    question = Question(sets[0], reference=sets[1])
    aside = tuple(f for f in targets if f.name in answer.set_aside)
    return question, ChangeStudy(driven[0], driven[1], twin, answer, scored, aside, ())


def beside_one(change=()):
    """A flight beside a single reference flight."""
    return study_of(make_twin([long_flight(1)], LIBRARY, EVERY), [long_flight(2, change)])


def diagnosis_of(*args, **settings):
    found = as_diagnosis(*study(*args, **settings))
    assert Diagnosis.of_json(found.to_json()) == found  # a file holds all of it
    return found


def test_a_change_becomes_an_effect_with_its_size_and_a_smaller_drift():
    found = diagnosis_of([(column("attitude_gain", "g"), 0.06)])
    assert found.verdict in ("effect", "partly")
    (effect,) = found.blamed
    assert effect.name == "attitude_gain"
    size = effect.parameter("g")
    assert size.low is not None
    assert size.high is not None
    assert 0.0 < size.low < 0.06 < size.high
    assert found.probability == effect.probability
    assert 0.5 < effect.probability < 1.0
    assert found.shrink.percent is not None
    assert found.shrink.percent > 50.0
    assert found.support[0].confirmed
    assert sum(c.share for c in found.where) == pytest.approx(1.0)
    assert found.remainder.share < 0.5


def test_a_size_is_what_a_simulator_of_the_reference_needs():
    """A change of a factor stands on the neutral 1: rotors 1.4 times as slow as before."""
    changed = ChangedParameter("motor_lag", "scale", "-", 0.4, 0.3, 0.5, 0.1, "no", True)
    library = make_library(Crazyflow(), referenced=True, twin=True)
    (scale,) = as_parameters((changed,), "motor_lag", "effect", library)
    assert (scale.value, scale.low, scale.high) == pytest.approx((1.4, 1.3, 1.5))


def test_each_of_two_effects_has_a_probability_of_its_own():
    large = [(column("attitude_gain", "g"), 0.2), (column("trim", "roll"), 0.02)]
    found = diagnosis_of(large)
    assert {e.name for e in found.blamed} == {"attitude_gain", "trim"}
    assert len({e.probability for e in found.blamed}) == 2
    assert found.probability == min(e.probability for e in found.blamed)


def test_intervals_of_gaps_hold_them():
    found = diagnosis_of([(column("attitude_gain", "g"), 0.06)])
    assert all(gap.low < gap.gap_rms < gap.high for gap in found.where)


def test_no_change_says_none_and_how_small_a_change_would_have_been_seen():
    found = diagnosis_of()
    assert (found.verdict, found.probability, found.effects) == ("none", None, ())
    assert found.remainder.share == 0.0
    assert found.shrink.reason == "no effect was found"
    sizes = {(x.effect, x.parameter): x.smallest for x in found.details.limits}
    smallest = sizes["attitude_gain", "g"]
    assert smallest is not None
    assert 0.0 < smallest < 0.06
    assert len(found.details.followed) == 6


def test_silence_of_three_flights_is_not_none():
    found = diagnosis_of(n=3)
    assert found.verdict == "too_few"
    assert found.next_flight.startswith("Fly at least 5 flights of 5 to 10 s like the reference")


def test_few_flights_that_look_changed_say_what_it_looks_like_and_blame_nothing():
    found = as_diagnosis(*beside_one([(column("attitude_gain", "g"), 0.06)]))
    assert Diagnosis.of_json(found.to_json()) == found
    (likeliest,) = found.effects
    assert (found.verdict, likeliest.name, likeliest.blamed) == ("too_few", "attitude_gain", False)
    # Of a single reference flight nobody knows how flights differ.
    assert all(p.low is None and p.high is None for p in likeliest.parameters)
    assert found.details.limits == ()
    assert "at least 5 reference flights" in found.next_flight
    assert as_diagnosis(*beside_one()).effects == ()


def test_a_flight_that_nothing_explains_is_left_out_with_the_reason():
    found = diagnosis_of(odd=True)
    (left,) = found.flights.left_out
    assert left.name == "flight 100"
    number = r"[0-9.]+ (degrees|m/s\^2)"
    said = rf"misses the other flights: [a-z ]+ off by {number} \(other flights: {number}\)$"
    assert re.search(said, left.reason)
    assert "flight 100" not in [x.name for x in found.flights.used]


def test_masses_that_were_weighed_anew_go_to_the_twin_and_are_each_their_own():
    light, heavy = flown(["one"]), flown(["two"], mass=0.042)
    assert weighed_anew(Question(heavy, reference=light))
    assert not weighed_anew(Question(light, reference=light))
    assert not weighed_anew(Question(light))
    # Only flights of one drone: several are compared by the simulator itself.
    assert not weighed_anew(Question(flown(["two"], mass=0.042, drones=2), reference=light))
    assert not alone(Question(light, reference=flown(["two"], drones=2)))


def test_reference_flights_are_flown_once_whatever_they_are_called(tmp_path, monkeypatch):
    times = []

    def channels(replay, logs, segments, vector, along):
        times.append(len(logs))
        return tuple(dataclasses.replace(flight(1), name=log.name) for log in logs[1:])

    monkeypatch.setattr(flown_channels, "make_channels", channels)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    few = all_but("wind", "mass", "drag")

    def asked(names, mass=0.032):
        flights = flown(names, mass)
        replay = twin_replay(flights, choose_inputs(flights), "point_mass", few)
        return reference_channels(replay, flights.flights)

    first, again = asked(["a", "b", "c"]), asked(["x", "y", "z"])
    assert [one.name for one in first] == ["b", "c"]  # a flight may be too short to count
    assert [one.name for one in again] == ["y", "z"]
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.slopes, other.slopes)
        np.testing.assert_array_equal(one.valid, other.valid)
    assert times == [3]
    asked(["a", "b", "c"], mass=0.034)
    asked(["a", "b"])
    assert times == [3, 3, 2]


def test_commands_that_act_before_their_row_are_given_earlier():
    """A log whose commands stand two rows late is flown as the other is, 20 ms early."""
    ((drone,),) = (one.drones for one in flown(["a"]).flights)
    cmd = drone.cmd.copy()
    cmd[:, 0] = 0.2 * np.sin(3.0 * drone.t) * (drone.t > 1.0)

    def simulated(cmd, effect, change):
        """Roll [rad] every 20 ms, with a change of the only parameter of an effect."""
        moved = dataclasses.replace(drone, cmd=cmd)
        flights = dataclasses.replace(flown(["a"]), flights=(FlightLog("a", (moved,)),))
        inputs = choose_inputs(flights)
        replay = twin_replay(flights, inputs, "crazyflow", all_but("delay", "clock_drift"))
        at, vector = replay.library.indices[effect], replay.library.neutral.copy()
        vector[at] = change
        (one,) = flown_channels.flight_of(replay, inputs.flights)(vector, at)
        return one.simulated[:-2, 0]

    late = np.concatenate([cmd[:2], cmd[:-2]])
    plain = simulated(cmd, "delay", 0.0)
    assert np.abs(plain).max() > 0.1
    np.testing.assert_allclose(simulated(late, "delay", -0.02), plain, atol=1e-4)
    # With 1 % a second, commands are 20 ms early after two seconds, and more later.
    gap = np.abs(simulated(late, "clock_drift", -0.01) - plain)
    assert gap[90:110].max() < 0.25 * min(gap[:70].max(), gap[200:].max())


def test_slopes_along_few_parameters_are_those_along_all():
    """With a drag of 1 1/s, where the slope by the drag differs from that without drag."""
    flights = flown(["a"])
    inputs = choose_inputs(flights)
    replay = twin_replay(flights, inputs, "point_mass", all_but("drag", "mass"))
    fly, library = flown_channels.flight_of(replay, inputs.flights), replay.library
    at = [library.indices["drag"][0]]
    vector = library.neutral.copy()
    vector[at] = 1.0
    (plain,), (whole,), (part,) = fly(library.neutral, None), fly(vector, None), fly(vector, at)
    np.testing.assert_allclose(part.simulated, whole.simulated, atol=1e-5)
    np.testing.assert_allclose(part.slopes, whole.slopes[at], atol=1e-5)
    merged = part.with_slopes_of(plain, at)
    np.testing.assert_array_equal(merged.slopes[at], part.slopes)
    others = [i for i in range(len(library.slots)) if i not in at]
    np.testing.assert_array_equal(merged.slopes[others], plain.slopes[others])
    assert np.abs(whole.slopes[at] - plain.slopes[at]).max() > 1e-3


def swaying(t):
    """A drone that sways, its commands changing from row to row."""
    at = np.stack([np.sin(2.0 * t), np.cos(3.0 * t), 1.0 + 0.1 * np.sin(t)], axis=1)
    vel = np.stack([2.0 * np.cos(2.0 * t), -3.0 * np.sin(3.0 * t), 0.1 * np.cos(t)], axis=1)
    turned = np.stack([0.1 * np.sin(2.0 * t), 0.0 * t, 0.0 * t, np.ones_like(t)], axis=1)
    quat = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    cmd = np.stack([np.sin(t), np.cos(t), 0.0 * t, 0.3 + 0.01 * np.sin(t)], axis=1)
    return DroneLog(t=t, pos=at, vel=vel, quat=quat, cmd=cmd, battery=4.0 - 0.1 * t)


@pytest.mark.parametrize("rate", [25.0, 33.0, 40.0])
def test_rows_of_a_slow_log_are_filled_up_but_its_holes_stay(rate):
    t = np.arange(0.0, 6.0, 1.0 / rate)
    t = t[(t < 2.0) | (t > 3.0)]
    slow = dataclasses.replace(swaying(t), interpolated=np.arange(len(t)) % 2 == 0)
    full = flown_channels.filled_up(slow, measured=2)
    true = swaying(full.t)
    assert set(t) <= set(full.t)
    steps = np.diff(full.t)
    assert np.sort(steps)[-2] <= 0.022
    assert steps.max() > 0.95
    assert full.interpolated is None
    for name in ("pos", "vel", "quat"):
        np.testing.assert_allclose(getattr(full, name), getattr(true, name), atol=1e-3)
    np.testing.assert_allclose(full.cmd[:, :2], true.cmd[:, :2], atol=1e-3)  # measured
    before = np.searchsorted(t, full.t + 1e-9) - 1
    np.testing.assert_array_equal(full.cmd[:, 2:], slow.cmd[before, 2:])  # held
    np.testing.assert_allclose(full.battery, true.battery, atol=1e-9)
    again = flown_channels.filled_up(full, measured=2)
    assert again.t is full.t


def test_a_twin_takes_slow_logs_and_rows_between_positions():
    """Rows at 25 Hz, or at 50 Hz with positions at 10 Hz; fast ones are taken as they are."""
    few = all_but("mass")

    def counted(every, interpolated=None):
        t = T[::every]
        one = dataclasses.replace(swaying(t), battery=None)
        if interpolated:
            one = dataclasses.replace(one, interpolated=np.arange(len(t)) % interpolated > 0)
        flights = dataclasses.replace(flown(["a"]), flights=(FlightLog("a", (one,)),))
        inputs = choose_inputs(flights)
        replay = twin_replay(flights, inputs, "point_mass", few)
        (made,) = flown_channels.flight_of(replay, inputs.flights)(replay.library.neutral, None)
        return made

    fast, slow, between = counted(1), counted(4), counted(2, 5)
    for made in (slow, between):
        assert made.valid.sum() >= 0.95 * fast.valid.sum()
        n = min(len(made.measured), len(fast.measured)) - 2
        np.testing.assert_allclose(made.measured[:n], fast.measured[:n], atol=0.05)
