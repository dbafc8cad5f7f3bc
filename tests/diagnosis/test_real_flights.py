"""What is said of real flights: undisturbed halves, faults put into one of them, a changed drone.

The sets stand beside the repository (`reports/real_flights.md`). Each case is answered beside the
twin of the other flights, and no answer may contradict itself (`consistent`).
"""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import real, some_rows
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from scipy.stats import spearmanr

from blind.draw.faults import ALL
from blind.power.splits import random_splits
from diagnosis.decide.prepared import Question
from diagnosis.interface.fault import MOTOR_CLOCK
from diagnosis.interface.faults import interface_faults
from diagnosis.logs.flights import DroneLog, FlightSet
from diagnosis.result import Diagnosis
from diagnosis.twin.as_diagnosis import beside_twin
from simulators.vehicle import GRAVITY


def halves(name: str) -> tuple[FlightSet, FlightSet]:
    flights = real(name)
    even, odd = (dataclasses.replace(flights, flights=flights.flights[i::2]) for i in (0, 1))
    return even, odd


def some(flights: FlightSet, n: int) -> FlightSet:
    return dataclasses.replace(flights, flights=flights.flights[:n])


def consistent(found: Diagnosis) -> Diagnosis:
    """No answer stands that is likelier wrong than right, may be of no size, or makes it worse."""
    for effect in found.blamed:
        assert effect.probability is not None
        assert effect.probability >= 0.5
        assert any(p.low > 0.0 or p.high < 0.0 for p in effect.parameters)
    if found.blamed:
        assert found.details.misfit.after < found.details.misfit.before
        assert found.shrink.high is None or found.shrink.high > 0.0
    return found


def changed(flights: FlightSet, reference: FlightSet) -> Diagnosis:
    return consistent(beside_twin(Question(flights, "crazyflow", reference)))


def class_of(found: Diagnosis) -> set[str]:
    """The first effect that is blamed and what looks like it."""
    return {found.blamed[0].name, *found.blamed[0].aliases} if found.blamed else set()


def test_undisturbed_halves_differ_by_nothing():
    """Two flights (log163, log169) have a hole of a second at their start."""
    even, odd = halves("crazyflie_plain")
    found = changed(even, odd)
    assert (found.verdict, found.effects) == ("none", ())
    worst = {line.channel: line.gap_rms for line in found.where}
    assert worst["acceleration up"] < 0.2


def thrust_that_carries_a_newton() -> dict[str, float]:
    """Commanded thrust for the weight that it carried, in undisturbed flights by name."""
    carried = {}
    for flight in real("crazyflie_plain").flights:
        (log,) = flight.drones
        start, end = np.flatnonzero(log.cmd[:, 3] > 0.1)[[0, -1]]
        upright = Rotation.from_quat(log.quat[start:end]).as_matrix()[:, 2, 2]
        seconds = log.t[end] - log.t[start]
        push = np.sum(log.cmd[start:end, 3] * upright * np.diff(log.t[start : end + 1])) / seconds
        carried[flight.name] = push / (GRAVITY + (log.vel[end, 2] - log.vel[start, 2]) / seconds)
    usual = np.median([*carried.values()])
    return {name: value / usual for name, value in carried.items()}


def test_undisturbed_halves_that_are_called_changed_differ_in_thrust():
    """The four alarms of docs/twin.md (seed 2) are among the seven whose halves differ most."""
    carried = thrust_that_carries_a_newton()
    series = np.asarray([carried[name] for name in sorted(carried)])
    assert np.mean(series[:5]) == pytest.approx(0.988, abs=0.002)
    assert np.mean(series[11:14]) == pytest.approx(1.009, abs=0.002)
    assert spearmanr(np.arange(len(series)), series).statistic == pytest.approx(0.61, abs=0.05)
    apart = [
        abs(np.mean([carried[x] for x in before]) - np.mean([carried[x] for x in after]))
        for seed in (1, 2)
        for before, after in random_splits([*carried], 100, (9, 9), seed, "splitting")
    ]
    order = [int(i) for i in np.argsort(apart)[::-1]]
    assert [order.index(100 + split) + 1 for split in (13, 22, 57, 51)] == [1, 2, 3, 7]
    assert apart[113] > 4.0 * np.median(apart)


# The exhaustive ones run the lines of the lost thrust.
@pytest.mark.parametrize(
    ("fault", "given", "named", "parameter"),
    [
        ("thrust_gain", {"e": 0.07}, "thrust_gain", "e"),
        *(
            pytest.param(*case, marks=pytest.mark.exhaustive)
            for case in (
                ("delay", {"seconds": 0.03}, "delay", "seconds"),
                ("delay", {"seconds": -0.03}, "delay", "seconds"),
                ("clock_drift", {"rate": 0.01}, "clock_drift", "rate"),
                ("trim", {"roll": 0.0, "pitch": np.radians(3.0)}, "trim", "pitch"),
                ("tilt_turned_in_yaw", {"angle": np.radians(10.0)}, "frame_misalignment", "angle"),
            )
        ),
    ],
)
def test_a_fault_that_is_put_into_the_commands_is_named_in_its_size(fault, given, named, parameter):
    even, odd = halves("crazyflie_plain")
    found = changed(ALL[fault].apply(even, given), odd)
    assert named in class_of(found)
    if found.blamed[0].name == named:
        size = found.blamed[0].parameter(parameter)
        assert size.low < given[parameter] < size.high


@pytest.mark.exhaustive
def test_of_two_faults_neither_hides_the_other():
    even, odd = halves("crazyflie_plain")
    late = ALL["delay"].apply(even, {"seconds": 0.04})
    found = changed(ALL["thrust_gain"].apply(late, {"e": -0.1}), odd)
    classes = [{one.name, *one.aliases} for one in found.blamed]
    assert len(classes) == 2
    assert all(any(name in each for each in classes) for name in ("delay", "thrust_gain"))


@pytest.mark.exhaustive
def test_a_start_that_is_cut_off_hides_no_delay():
    even, odd = halves("crazyflie_plain")
    late = ALL["delay"].apply(even, {"seconds": 0.03})
    cut = late.each(lambda log: some_rows(log, log.t >= log.t[0] + 0.7))
    assert "delay" in class_of(changed(cut, odd))


def with_slow_positions(flights: FlightSet) -> FlightSet:
    """Rows at 50 Hz, with positions at 10 Hz and splines between them, as an import makes them."""

    def slow(log: DroneLog) -> DroneLog:
        rows = some_rows(log, slice(None, None, 5))
        seen = slice(None, None, 5)
        pos, vel = (CubicSpline(rows.t[seen], x[seen])(rows.t) for x in (rows.pos, rows.vel))
        between = np.arange(len(rows.t)) % 5 > 0
        return dataclasses.replace(rows, pos=pos, vel=vel, interpolated=between)

    return flights.each(slow)


@pytest.mark.exhaustive
def test_positions_at_10_hz_tell_a_weaker_thrust_from_a_battery_that_fades():
    even, odd = (with_slow_positions(half) for half in halves("crazyflie_plain"))
    found = changed(ALL["thrust_gain"].apply(even, {"e": -0.07}), odd)
    assert found.blamed[0].name == "thrust_gain"
    size = found.blamed[0].parameter("e")
    assert size.low < -0.07 < size.high
    assert found.shrink.percent > 75.0


@pytest.mark.exhaustive
def test_a_flight_that_another_program_flew_is_set_aside_by_name():
    """Its commands are those of the next flight, half a second late."""
    even, odd = halves("crazyflie_plain")
    (one,), (other,) = even.flights[4].drones, even.flights[5].drones
    rows = np.clip(
        np.searchsorted(other.t - other.t[0], one.t - one.t[0] - 0.5), 0, len(other.t) - 1
    )
    mixed = dataclasses.replace(
        even.flights[4], drones=(dataclasses.replace(one, cmd=other.cmd[rows]),)
    )
    flights = (*even.flights[:4], mixed, *even.flights[5:])
    found = changed(dataclasses.replace(even, flights=flights), odd)
    assert found.verdict == "none"
    assert [x.name for x in found.flights.left_out] == [mixed.name]


@pytest.mark.exhaustive
def test_thrust_without_commanded_angles_tells_a_weaker_thrust():
    even, odd = (
        each.each(lambda log: dataclasses.replace(log, cmd=None, thrust=log.cmd[:, 3]))
        for each in halves("crazyflie_plain")
    )
    assert not changed(even, odd).blamed
    found = changed(ALL["thrust_gain"].apply(even, {"e": -0.1}), odd)
    assert "thrust_gain" in class_of(found)


def test_three_flights_beside_five_name_a_family_of_aliases():
    even, odd = halves("crazyflie_plain")
    found = changed(ALL["thrust_gain"].apply(some(even, 3), {"e": 0.1}), some(odd, 5))
    assert {"thrust_gain", "mass"} <= class_of(found)


@pytest.mark.exhaustive
def test_a_drone_that_carries_more_is_told_by_each_flight_alone():
    heavy, plain = real("crazyflie_changed"), real("crazyflie_plain")
    for flights in (heavy, some(heavy, 1)):
        found = changed(flights, plain)
        assert class_of(found) & {"mass", "thrust_gain"}
        assert len(found.blamed) == 1
        (size,) = found.blamed[0].parameters
        over = size.value if found.blamed[0].name == "thrust_gain" else 1 / (1 + size.value) - 1
        assert over == pytest.approx(-0.257, abs=0.01)


@pytest.mark.exhaustive
def test_a_mass_that_was_weighed_anew_is_taken_out_first():
    heavy, plain = real("crazyflie_changed"), real("crazyflie_plain")
    weighed = dataclasses.replace(heavy.vehicle, mass=1.347 * heavy.vehicle.mass)
    found = changed(dataclasses.replace(heavy, vehicle=weighed), plain)
    assert not class_of(found) & {"mass", "thrust_gain", "battery"}


@pytest.mark.parametrize("rate", [0.0, 0.005, -0.01])
def test_a_motor_clock_that_drifts_is_measured_in_four_flights(rate):
    flights = some(halves("nanobench")[0], 4)
    logs = ALL["clock_drift"].apply(flights, {"rate": rate}) if rate else flights
    found = [fault for fault in interface_faults(logs) if fault.part == MOTOR_CLOCK]
    assert len(found) == (rate != 0.0)
    for fault in found:
        assert fault.evidence[0].value == pytest.approx(1e3 * rate / (1.0 + rate), rel=0.1)
