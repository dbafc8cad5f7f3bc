"""What drives a replay where no attitude is commanded."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import SIGMA, edited, flight_set, fly, rotor_speeds

from diagnosis.decide.prepared import make_likelihood, noise_of
from diagnosis.fit.gap import drifts, rms
from diagnosis.logs.flights import LogError, load_flights, write_flights
from diagnosis.logs.inputs import (
    PRESCRIBED,
    VOLTS,
    choose_inputs,
    driven_alike,
    on_ground,
    thrust_of_pwm,
    thrust_of_rotors,
)
from diagnosis.replay.library import make_library
from diagnosis.replay.replay import make_replay
from simulators import registry
from simulators.contract import replayable_class
from simulators.crazyflow import Crazyflow
from simulators.point_mass import PointMass
from simulators.vehicle import GRAVITY, VEHICLES


def test_rotors_at_their_largest_speed_give_the_largest_thrust():
    spec = VEHICLES["cf2x_L250"]
    _, c1, c2 = spec.rpm2thrust
    each = spec.thrust_max / 4
    rpm = (-c1 + np.sqrt(c1**2 + 4 * c2 * each)) / (2 * c2)
    speeds = np.full((1, 4), rpm * 2 * np.pi / 60)
    assert thrust_of_rotors(speeds, spec)[0] == pytest.approx(spec.thrust_max)


@pytest.mark.parametrize("grams", [0.0, 10.0, 32.0, 55.0])
def test_pwm_map_inverts_the_firmware_parabola(grams):
    volts = VOLTS[0] * grams + VOLTS[1] * grams**2
    pwm = np.full((1, 4), volts / 3.8)
    assert thrust_of_pwm(pwm, np.array([3.8]))[0] == pytest.approx(grams * 1e-3 * GRAVITY, abs=1e-9)


def test_more_voltage_than_the_parabola_knows_holds_its_top():
    full, more = (thrust_of_pwm(np.ones((1, 4)), np.array([v]))[0] for v in (3.2, 4.2))
    assert full == more == pytest.approx(-VOLTS[0] / (2 * VOLTS[1]) * 1e-3 * GRAVITY)


def rotors_only(flights, spec):
    """The flights with rotor speeds in the place of their commands."""
    return _instead(flights, "rotor_vel", lambda thrust: rotor_speeds(thrust, spec))


def thrust_only(flights):
    """The flights with the commanded thrust alone."""
    return _instead(flights, "thrust", lambda thrust: thrust)


def _instead(flights, column, of_thrust):
    """The flights without commands, with a column that is made of the commanded thrust."""
    bare = lambda log: {"cmd": None, column: of_thrust(log.cmd[:, 3])}  # noqa: E731
    return tuple(edited(flight, bare) for flight in flights)


def test_commanded_thrust_alone_is_flown_under_the_measured_attitude(tmp_path):
    flown = fly(PointMass(), n_flights=2, noise=0.0)
    bare = flight_set(thrust_only(flown))
    write_flights(tmp_path, bare.vehicle, bare.flights)
    inputs = choose_inputs(load_flights(tmp_path))
    (drone,), (was,) = inputs.flights[0].drones, flown[0].drones
    assert (inputs.kind, inputs.prescribed, inputs.measured) == (PRESCRIBED, True, 3)
    np.testing.assert_array_equal(drone.cmd[:, 3], was.cmd[:, 3])
    # Beside it, whole commands give way to what both have.
    assert choose_inputs(flight_set(flown), beside=bare).kind == PRESCRIBED


def test_flights_without_commands_are_driven_by_their_rotors():
    spec = VEHICLES["cf21B_500"]
    flown = fly(PointMass(), n_flights=1, noise=0.0)
    inputs = choose_inputs(flight_set(rotors_only(flown, spec)))
    (drone,), (was,) = inputs.flights[0].drones, flown[0].drones
    assert inputs.prescribed
    np.testing.assert_allclose(drone.cmd[:, 3], was.cmd[:, 3], rtol=1e-9)


def test_flights_that_lack_the_common_input_are_left_out_with_the_reason():
    spec = VEHICLES["cf21B_500"]
    flown = fly(PointMass(), n_flights=2, noise=0.0)
    mixed = (flown[0], rotors_only(flown[1:], spec)[0])
    inputs = choose_inputs(flight_set(mixed))
    assert [f.name for f in inputs.flights] == ["flight_0"]
    assert inputs.left_out[0].name == "flight_1"
    assert "commands" in inputs.left_out[0].reason


def test_no_input_at_all_is_an_error():
    (flight,) = fly(PointMass(), n_flights=1, noise=0.0)
    bare = edited(flight, lambda log: {"cmd": None})
    with pytest.raises(LogError, match="no flight has cmd"):
        choose_inputs(flight_set([bare]))


def test_time_on_the_ground_is_found():
    (flight,) = fly(PointMass(), n_flights=1, noise=0.0)
    cmd = flight.drones[0].cmd.copy()
    cmd[:50, 3] = 0.0
    (stretch,) = on_ground(dataclasses.replace(flight.drones[0], cmd=cmd), 0.0434, turning=False)
    assert stretch == pytest.approx((0.0, 1.0))


@pytest.mark.parametrize(("turning", "found"), [(True, [(0.0, 1.0)]), (False, [])])
def test_a_drone_with_turning_rotors_stands_where_nothing_moves_low_down(turning, found):
    """Until it first moves; one that hovers later, low down or a metre up, does not stand."""
    (flight,) = fly(PointMass(), n_flights=1, noise=0.0)
    log = flight.drones[0]
    pos, vel = log.pos.copy(), log.vel.copy()
    pos[:50], vel[:50] = [0.0, 0.0, 0.05], 0.01
    pos[100:150], vel[100:150] = [0.0, 0.0, 0.05], 0.0
    pos[-50:], vel[-50:] = [0.0, 0.0, 1.0], 0.0
    stood = dataclasses.replace(log, pos=pos, vel=vel)
    stretches = on_ground(stood, 0.0434, turning=turning)
    assert [tuple(np.round(ends, 9)) for ends in stretches] == found


def test_a_dip_of_thrust_in_the_air_is_no_landing():
    (flight,) = fly(PointMass(), n_flights=1, noise=0.0)
    cmd = flight.drones[0].cmd.copy()
    cmd[:5, 3] = cmd[100:110, 3] = cmd[-5:, 3] = 0.0
    found = on_ground(dataclasses.replace(flight.drones[0], cmd=cmd), 0.0434, turning=False)
    assert [begin for begin, _ in found] == pytest.approx([0.0, 5.9])


def test_measured_rotors_of_an_unchanged_vehicle_leave_no_gap():
    """What they produce is not delayed again; that they lag is nothing that could be seen."""
    simulator = Crazyflow()
    flown = fly(simulator, n_flights=3, seconds=4.0, rotors_of=1.0)
    flights = flight_set(flown)
    inputs = choose_inputs(flights)
    assert inputs.produced
    driven = {"prescribed": True, "produced": True}
    assert not {"motor_lag", "rotor_response"} & set(make_library(simulator, **driven).effects)
    library = make_library(simulator, registry.names("effect"), **driven)  # flown without effects
    replay = make_replay(library, replayable_class("crazyflow").replay_dt, inputs.measured)
    tracks = make_likelihood(replay, inputs.flights, noise_of(replay, inputs.flights)).tracks(
        library.neutral
    )
    assert rms(drifts(tracks)[:, 5]) < 1.5 * np.hypot(SIGMA[3], 0.4 * SIGMA[3])


def test_both_sets_are_replayed_by_what_both_have():
    """Rotor speeds where only the reference logs commands as well."""
    spec = VEHICLES["cf21B_500"]
    logged = fly(PointMass(), n_flights=1, seconds=2.0)
    (bare,) = rotors_only(logged, spec)
    both = edited(bare, lambda log: {"cmd": logged[0].drones[0].cmd})
    target, reference = flight_set([bare]), flight_set([both])
    assert choose_inputs(reference).kind == "commands"
    assert choose_inputs(reference, beside=target).kind == "rotor speeds"
    assert choose_inputs(target, beside=reference).kind == "rotor speeds"


def test_two_sets_without_a_common_input_are_refused():
    flown = fly(PointMass(), n_flights=1, seconds=2.0)
    target = flight_set(rotors_only(flown, VEHICLES["cf21B_500"]))
    reference = flight_set(thrust_only(flown))
    with pytest.raises(LogError, match="both must log the same kind of input"):
        driven_alike(target, reference)
