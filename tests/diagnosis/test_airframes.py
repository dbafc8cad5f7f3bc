"""Any airframe: by its name, or from a data sheet; a 1.5 kg quadrotor that RotorPy flies."""

import dataclasses
import importlib.util
import pathlib
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rotorpy.vehicles.crazyflie_params
import rotorpy.vehicles.crazyfliebrushless_params
import rotorpy.vehicles.hummingbird_params
import rotorpy.vehicles.px4_sihsim_quadx_params
from flights_for_tests import few_or_all, flight_set, made_log
from log_tables import table
from scipy.spatial.transform import Rotation

import diagnosis
from bench.diagnosis_report.sentences import remarks
from diagnosis.logs import vehicle_file
from diagnosis.logs.airframes import AIRFRAMES, POINT_MASSES, RPM, Airframe
from diagnosis.logs.flights import (
    DroneLog,
    FlightLog,
    LogError,
    VehicleFile,
    load_flights,
    read_vehicle,
    write_flights,
)
from diagnosis.logs.inputs import PRESCRIBED, choose_inputs, thrust_of_rotors
from diagnosis.replay.believed import default_simulator, loop_is_known, nominal_simulator
from simulators.point_mass import PointMass
from simulators.rotorpy_vehicle import derivative, make_multirotor, motor_speeds, runge_kutta
from simulators.vehicle import CONTROL_DT, GRAVITY, VEHICLES

SHEET = """
name = "a quadrotor of 1.5 kg"
drone = "x500"
mass = 1.5

[airframe]
thrust_max = 34.0
attitude_lag = 0.06
"""

QUAD = {
    **rotorpy.vehicles.px4_sihsim_quadx_params.quad_params,
    "mass": 1.5,
    "k_eta": 8.5e-6,
    "k_m": 1.5e-7,
    "k_d": 1e-4,
    "k_w": 1.0,
    "k_v": 10.0,
    "kp_att": 240.0,
    "kd_att": 22.0,
    "rotor_directions": np.asarray([-1.0, -1.0, 1.0, 1.0]),
}
"""RotorPy's parameters of it: four rotors that carry 34 N together, and an attitude loop that
commands reach in about 0.1 s."""


def flown(mass=1.5, n_flights=4, seconds=8.0, believed=1.5, seed=0):
    """Flights with steps of the target and dithered commands, with noise of motion capture."""
    rng = np.random.default_rng(seed)
    quad, n = {**QUAD, "mass": mass}, round(seconds / CONTROL_DT)
    hold = lambda size, k: np.repeat(rng.uniform(-1, 1, (n // k + 1, size)), k, axis=0)[:n]  # noqa: E731

    @jax.jit
    def fly(target, dither):
        vehicle, told = make_multirotor(quad), make_multirotor(QUAD)

        def step(body, row):
            target, dither = row
            pos, vel = body[:3], body[3:6]
            acc = jnp.clip(2.0 * (target - pos) - 2.5 * vel, -4.0, 4.0)
            tilt = jnp.stack([-acc[1], acc[0]]) / GRAVITY + dither[:2]
            thrust = believed * (GRAVITY + acc[2] + dither[3])
            cmd = jnp.concatenate([tilt, jnp.zeros(1), thrust[None]])
            seen = (body, cmd)
            for _ in range(4):
                speeds = motor_speeds(told, body, cmd)
                rate = lambda b, s=speeds: derivative(  # noqa: E731
                    vehicle, b[0], s, jnp.zeros(3), jnp.zeros(3)
                )[None]
                body = runge_kutta(rate, body[None], CONTROL_DT / 4)[0]
            return body, seen

        hover = jnp.sqrt(mass * GRAVITY / 4.0 / QUAD["k_eta"])
        rest = jnp.concatenate(
            [jnp.asarray([0, 0, 1.5, 0, 0, 0, 0, 0, 0, 1.0, 0, 0, 0]), jnp.full(4, hover)]
        )
        return jax.lax.scan(step, rest, (target, dither))[1]

    flights = []
    for i in range(n_flights):
        target = np.array([0.0, 0.0, 1.5]) + hold(3, 75) * [0.8, 0.8, 0.4]
        dither = hold(4, 10) * [0.08, 0.08, 0.0, 1.0]
        body, cmd = (np.asarray(x, float) for x in fly(target, dither))
        noise = lambda s, k: rng.normal(0.0, s, (n, k))  # noqa: E731
        attitude = Rotation.from_quat(body[:, 6:10]) * Rotation.from_rotvec(noise(3e-3, 3))
        log = DroneLog(
            t=CONTROL_DT * np.arange(n),
            pos=body[:, :3] + noise(1e-3, 3),
            vel=body[:, 3:6] + noise(1e-2, 3),
            quat=attitude.as_quat(),
            cmd=cmd,
        )
        flights.append(FlightLog(f"flight_{i}", (log,)))
    return tuple(flights)


def written(folder, flights, text=SHEET):
    """A folder of flights with that vehicle.toml."""
    write_flights(folder, VehicleFile("x", "cf21B_500", 0.04), flights)
    (folder / "vehicle.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    """Flights of a quadrotor that weighs a tenth more than its operator believes."""
    return written(tmp_path_factory.mktemp("own") / "heavy", flown(mass=1.65))


@few_or_all("mass", "trim")
def test_a_quadrotor_of_another_size_is_diagnosed_from_its_data_sheet(heavy, exclude):
    found = diagnosis.diagnose(heavy, exclude=exclude)
    assert found.settings.simulator == "point_mass"
    (named,) = [e for e in found.blamed if {"mass", "thrust_gain"} & {e.name, *e.aliases}]
    (size,) = named.parameters
    true = 0.1 if named.name == "mass" else 1.0 / 1.1 - 1.0
    assert size.low < true < size.high
    assert size.value == pytest.approx(true, abs=0.04)
    assert found.flights.airframe.thrust_max == 34.0
    fixed = diagnosis.corrected(diagnosis.Diagnosis.of_json(found.to_json()))
    assert fixed.spec.mass == 1.5
    assert fixed.attitude_tau == pytest.approx(0.06)
    whole = {"inertia": (0.02, 0.02, 0.03), "arm": 0.17, "rotor_lag": 0.03}
    for given, said in [
        ({}, "does not give inertia, drag, arm and rotor_lag. Of these a point mass needs drag"),
        (whole, "does not give drag: the point mass flies without"),
        ({"drag": (0.1, 0.1, 0.2)}, "does not give inertia, arm and rotor_lag, which a point mass"),
        ({**whole, "drag": (0.1, 0.1, 0.2)}, None),
    ]:
        sheet = dataclasses.replace(found.flights.airframe, **given)
        other = dataclasses.replace(
            found, flights=dataclasses.replace(found.flights, airframe=sheet)
        )
        lines = [line for line in remarks(other) if "does not give" in line]
        assert len(lines) == (said is not None)
        assert all(said in line for line in lines)


@few_or_all("mass", "trim")
def test_an_attitude_loop_that_nobody_gave_is_not_blamed(heavy, tmp_path, exclude):
    """It is no Crazyflie's; taken for one, it hid the mass."""
    text = SHEET.replace("attitude_lag = 0.06\n", "")
    folder = written(tmp_path / "no_lag", load_flights(heavy).flights, text)
    found = diagnosis.diagnose(folder, exclude=exclude)
    (named,) = found.blamed
    assert "mass" in {named.name, *named.aliases}
    assert found.flights.driven_by == PRESCRIBED
    (said,) = (line for line in remarks(found) if "attitude" in line and "drove" in line)
    assert said.startswith("vehicle.toml gives no attitude_lag")


def test_the_attitude_loop_of_a_vehicle_is_known_of_crazyflies_and_from_data_sheets():
    own = Airframe(thrust_max=34.0)
    lag = dataclasses.replace(own, attitude_lag=0.06)
    known = lambda *vehicle: loop_is_known("point_mass", VehicleFile("x", *vehicle))  # noqa: E731
    assert known("cf2x_P250", 0.03)
    assert known("x500", 1.5, lag)
    assert not known("hummingbird", 0.5)
    assert not known("x500", 1.5, own)
    assert loop_is_known("rotorpy", VehicleFile("x", "hummingbird", 0.5))


def test_an_airframe_that_crazyflow_lacks_flies_as_a_point_mass_and_says_so(heavy):
    flights = load_flights(heavy)
    assert default_simulator(flights) == "point_mass"
    nominal = nominal_simulator("point_mass", flights)
    assert isinstance(nominal, PointMass)
    assert (nominal.spec.mass, nominal.spec.thrust_max) == (1.5, 34.0)
    assert nominal.action_space.thrust_max == 34.0  # a policy commands what it can do
    with pytest.raises(LogError, match=r"got 'x500'\. 'point_mass' flies any"):
        nominal_simulator("crazyflow", flights)


def test_an_airframe_is_read_back_as_it_is_written(tmp_path, heavy):
    flights = load_flights(heavy)
    whole = Airframe(
        thrust_max=34.0,
        thrust_curve=(0.0, 1e-6, 2e-8),
        attitude_lag=0.06,
        rotor_lag=0.03,
        inertia=(0.02, 0.02, 0.03),
        arm=0.17,
        drag=(0.1, 0.1, 0.2),
    )
    vehicle = dataclasses.replace(flights.vehicle, airframe=whole)
    write_flights(tmp_path / "again", vehicle, flights.flights)
    assert read_vehicle(tmp_path / "again") == vehicle


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("thrust_max = 34.0", "", "thrust_max is missing"),
        ("thrust_max = 34.0", "thrust_max = 3.4", "is 0.231 times the weight of 1.5 kg"),
        ("thrust_max = 34.0", 'thrust_max = "x"', "thrust_max must be a number"),
        ("attitude_lag = 0.06", "attitude_lag = 60", "attitude_lag must be a number from 0.001"),
        ("attitude_lag = 0.06", "inertia = [0.02, 0.02]", "inertia must be three numbers"),
        ("attitude_lag = 0.06", "inertia = 0.02", "inertia must be three numbers"),
        ("attitude_lag = 0.06", "lag = 0.06", "unknown key 'lag'"),
        ('"x500"', '"cf21B_500"', "'cf21B_500' is known; leave out [airframe]"),
        ('"x500"', '"x 500"', "letters, digits"),
        ("mass = 1.5", "mass = -1.5", "key 'mass': got -1.5"),
        ("mass = 1.5", "mass = 1500", "times the weight of 1500 kg"),
    ],
)
def test_a_wrong_data_sheet_gets_one_line(tmp_path, old, new, message):
    (tmp_path / "vehicle.toml").write_text(SHEET.replace(old, new))
    with pytest.raises(LogError) as caught:
        read_vehicle(tmp_path)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_table_that_is_none_and_a_name_without_one_are_refused(tmp_path):
    text = SHEET.split("[airframe]")[0]
    (tmp_path / "vehicle.toml").write_text(f"{text}airframe = 3\n")
    with pytest.raises(LogError, match="a table is expected, got 3"):
        read_vehicle(tmp_path)
    (tmp_path / "vehicle.toml").write_text(text)
    with pytest.raises(LogError, match=r"got 'x500'.*or another with a table \[airframe\]"):
        read_vehicle(tmp_path)


def test_rotor_speeds_need_a_thrust_curve_and_duty_a_crazyflie():
    log = made_log(rotor_vel=np.full((200, 4), 600.0), cmd=None)
    own = Airframe(thrust_max=34.0)
    flights = flight_set([FlightLog("f", (log,))])
    sheet = dataclasses.replace(flights, vehicle=VehicleFile("x", "x500", 1.5, own))
    with pytest.raises(LogError, match="Rotor speeds need a thrust_curve"):
        choose_inputs(sheet)
    curve = dataclasses.replace(own, thrust_curve=(0.0, 0.0, 8.5e-6 / RPM**2))
    known = dataclasses.replace(flights, vehicle=VehicleFile("x", "x500", 1.5, curve))
    thrust = choose_inputs(known).flights[0].drones[0].cmd[:, 3]
    np.testing.assert_allclose(thrust, 4 * 8.5e-6 * 600.0**2)
    duty = made_log(pwm=np.full((200, 4), 0.5), battery=np.full(200, 3.7), cmd=None)
    sheet = dataclasses.replace(known, flights=(FlightLog("f", (duty,)),))
    with pytest.raises(LogError, match="known of Crazyflies alone"):
        choose_inputs(sheet)


def test_the_slow_rotors_of_a_large_airframe_are_used_and_revolutions_per_second_refused(tmp_path):
    text = SHEET.replace("34.0\n", "34.0\nthrust_curve = [0.0, 0.0, 1.8e-7]\n")
    hover = np.sqrt(1.5 * GRAVITY / 4.0 / 1.8e-7) / RPM
    assert 400.0 < hover < 500.0
    for name, speed in {"a": hover, "rev": hover / (2.0 * np.pi), "rpm": hover * RPM}.items():
        log = made_log(rotor_vel=np.full((200, 4), speed), cmd=None)
        log = dataclasses.replace(log, vel=np.gradient(log.pos, log.t, axis=0))
        written(tmp_path / name, [FlightLog("f", (log,))], text)
    assert load_flights(tmp_path / "a").left_out == ()
    with pytest.raises(LogError, match=r"hovers with 473\.4 rad/s by its .* Is it in rev"):
        load_flights(tmp_path / "rev")
    with pytest.raises(LogError, match=r"Is it in rpm\?"):
        load_flights(tmp_path / "rpm")


def test_a_thrust_curve_that_carries_nothing_is_named(tmp_path):
    text = SHEET.replace("34.0\n", "34.0\nthrust_curve = [0.0, 0.0, -1.8e-7]\n")
    log = made_log(rotor_vel=np.full((200, 4), 450.0), cmd=None)
    log = dataclasses.replace(log, vel=np.gradient(log.pos, log.t, axis=0))
    with pytest.raises(LogError, match=r"four rotors make 14\.7 N at no speed"):
        load_flights(written(tmp_path / "a", [FlightLog("f", (log,))], text))


def test_what_a_vehicle_file_is_checked_by_is_what_flies():
    assert {name: spec.mass for name, spec in AIRFRAMES.items()} == vehicle_file.MASSES
    assert vehicle_file.GRAVITY == GRAVITY
    assert list(vehicle_file.LIMITS) == [field.name for field in dataclasses.fields(Airframe)]
    assert list(vehicle_file.VehicleText._fields) == [
        field.name for field in dataclasses.fields(VehicleFile)
    ]


@pytest.mark.parametrize("name", ["cf2x_P250", "cf2x_T350", *VEHICLES])
def test_named_airframes_are_crazyflows(name):
    package = pathlib.Path(importlib.util.find_spec("crazyflow").submodule_search_locations[0])
    text = (package / "dynamics/first_principles/params.toml").read_text()
    theirs, ours = tomllib.loads(text)[name], AIRFRAMES[name]
    assert ours.name == name
    assert (ours.mass, ours.arm) == (theirs["mass"], theirs["L"])
    assert ours.thrust_max == pytest.approx(4 * theirs["thrust_max"])
    assert list(ours.rpm2thrust) == theirs["rpm2thrust"]
    np.testing.assert_array_equal(np.diag(ours.inertia), theirs["J"])
    np.testing.assert_array_equal(np.diag(ours.drag), -np.asarray(theirs["drag_matrix"]))


ROTORPYS = ("crazyflie", "crazyfliebrushless", "hummingbird", "px4_sihsim_quadx")


def test_every_airframe_of_rotorpy_has_a_name_here():
    folder = pathlib.Path(rotorpy.vehicles.crazyflie_params.__file__).parent
    assert {file.stem for file in folder.glob("*_params.py")} == {f"{n}_params" for n in ROTORPYS}


@pytest.mark.parametrize("name", ROTORPYS)
def test_named_airframes_are_rotorpys(name):
    theirs = getattr(rotorpy.vehicles, f"{name}_params").quad_params
    ours = AIRFRAMES[name]
    assert (ours.mass, ours.rotor_lag) == (theirs["mass"], theirs["tau_m"])
    assert ours.inertia == tuple(theirs[f"I{a}{a}"] for a in "xyz")
    assert ours.arm == pytest.approx(abs(theirs["rotor_pos"]["r1"][0]), rel=1e-9)
    fastest = np.full((1, 4), float(theirs["rotor_speed_max"]))
    assert ours.thrust_max == pytest.approx(thrust_of_rotors(fastest, ours)[0])
    assert ours.thrust_max == pytest.approx(4 * theirs["k_eta"] * fastest[0, 0] ** 2)


def test_every_named_airframe_loads_and_has_a_nominal_simulator(tmp_path):
    for name, spec in POINT_MASSES.items():
        folder = tmp_path / name
        (folder / "flights").mkdir(parents=True)
        frame = table()
        frame["cmd_thrust"] *= spec.mass * GRAVITY / frame["cmd_thrust"].median()
        frame.to_parquet(folder / "flights" / "a.parquet")
        (folder / "vehicle.toml").write_text(f'name = "x"\ndrone = "{name}"\nmass = {spec.mass}\n')
        flights = load_flights(folder)
        nominal = nominal_simulator(default_simulator(flights), flights)
        assert nominal.spec == spec
