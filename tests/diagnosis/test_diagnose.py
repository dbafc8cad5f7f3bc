"""The whole diagnosis of flights whose truth is known."""

import dataclasses
import json
from pathlib import Path

import flying
import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest
from flights_for_tests import (
    SIGMA,
    all_but,
    edited,
    few_or_all,
    flight_set,
    fly,
    point_mass_set,
    sizes,
    thinned,
)

import diagnosis
from diagnosis.decide.prepared import Question, make_likelihood, prepare
from diagnosis.decision import Decision
from diagnosis.engine import diagnose
from diagnosis.fit import gap, shrinkage
from diagnosis.logs.airframes import Airframe
from diagnosis.logs.flights import LeftOut, LogError, check_comparable
from diagnosis.recorded import flights_used
from diagnosis.result import Diagnosis
from diagnosis.statements import judged_of
from simulators import registry
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.gust import Gust
from simulators.effects.mass import Mass
from simulators.effects.motor_lag import MotorLag
from simulators.effects.wind import Wind
from simulators.point_mass import PointMass

PUBLISHED = Path(__file__).parents[2] / "docs" / "diagnosis.schema.json"


@pytest.fixture(scope="module")
def windy():
    stages = []
    flights = point_mass_set(Wind(x=0.5))
    found = diagnose(flights, simulator="point_mass", progress=lambda s, x: stages.append((s, x)))
    return found, stages


def test_the_json_is_of_the_published_schema_and_reads_back(windy, tmp_path):
    content = windy[0].to_json()
    jsonschema.validate(content, json.loads(PUBLISHED.read_text(encoding="utf-8")))
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
    assert Diagnosis.load(path) == windy[0]


def test_inputs_settings_and_program_are_recorded(windy):
    found, _ = windy
    digests = {flight.digest for flight in found.flights.used}
    assert len(digests) == len(found.flights.used) == 4
    assert all(len(digest) == 64 for digest in (*digests, found.program.digest))
    assert found.settings.simulator == "point_mass"
    assert found.settings.decision == Decision().values()
    assert found.flights.mass == point_mass_set(n_flights=1).vehicle.mass


def test_the_effect_is_named_with_its_value(windy):
    (effect,) = windy[0].blamed
    assert effect.name == "wind"
    x = effect.parameter("x")
    assert x.value == pytest.approx(0.5, abs=0.02)
    assert (x.unit, x.use, x.at_bound) == ("m/s^2", "measured", "no")
    assert windy[0].verdict == "effect"
    assert windy[0].support == ()  # the simulator follows, so that no flight is left out in turn
    assert 0.9 < windy[0].probability <= effect.probability


def test_the_gap_lies_where_the_force_acts(windy):
    where = {line.channel: line for line in windy[0].where}
    assert where["specific force x"].gap_rms == pytest.approx(0.5, rel=0.15)
    assert where["specific force x"].beyond_noise
    for other in ("specific force y", "attitude roll", "attitude yaw"):
        assert where[other].gap_rms < 2.5 * where[other].noise_floor
        assert not where[other].main
    assert sum(line.share for line in where.values()) == pytest.approx(1.0)
    x = where["specific force x"]
    assert x.low <= x.gap_rms <= x.high


def test_the_gap_shrinks_to_the_noise(windy):
    shrink = windy[0].shrink
    assert shrink.before == pytest.approx(0.5 * 0.5 * 0.5**2, rel=0.2)
    assert shrink.percent > 80
    assert shrink.low < shrink.percent < shrink.high


def flown(simulator):
    """Position after one second at a constant command."""
    cmds = flying.hold([0.0, 0.0, 0.0, 0.44], 50)
    return np.asarray(flying.fly_from_rest(simulator, jnp.asarray([[0.0, 0.0, 1.0]]), cmds).pos[-1])


def test_a_diagnosed_wind_blows_in_the_corrected_simulator(windy, tmp_path):
    found, path = windy[0], tmp_path / "diagnosis.json"
    path.write_text(json.dumps(found.to_json()))
    simulator = diagnosis.corrected(path)
    truth = with_effects(PointMass(dt=simulator.dt), [Wind(x=0.5)])
    off = np.abs(flown(simulator) - flown(truth)).max()
    assert off < 0.05 * np.abs(flown(PointMass(dt=simulator.dt)) - flown(truth)).max()
    assert sizes(diagnosis.corrected(str(path))) == sizes(diagnosis.corrected(found))


def test_progress_moves_forward_to_the_end(windy):
    shares = [share for _, share in windy[1]]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@few_or_all()
def test_two_flights_are_diagnosed_but_their_shrinkage_is_not_stated(exclude):
    flights = point_mass_set(Wind(x=0.5), n_flights=2)
    content = diagnose(flights, simulator="point_mass", exclude=exclude)
    assert content.verdict == "effect"
    assert content.shrink.percent is None
    assert "at least 3" in content.shrink.reason


@few_or_all()
def test_with_many_flights_a_third_is_never_fitted(exclude):
    flights = point_mass_set(Wind(x=0.5), n_flights=12, seconds=3.0)
    content = diagnose(flights, simulator="point_mass", exclude=exclude)
    held = set(content.flights.held_out)
    fit = {flight.name for flight in content.flights.used if flight.use == "fit"}
    assert not fit & held
    assert len(fit | held) == 12
    assert content.shrink.percent > 60
    curves = {line.flight for line in content.details.before_after}
    assert curves == held
    windows = content.details.windows
    assert 12 * 4 <= windows.n <= 12 * 6
    assert windows.aside <= 0.25 * windows.n


@few_or_all("wind", "mass", "downwash")
def test_flights_of_different_team_sizes_are_diagnosed_together(exclude):
    """Two flights of one drone and one of two, each left out in turn."""
    first, second, third, fourth = point_mass_set(Wind(x=0.5), n_flights=4).flights
    (beside,) = fourth.drones
    beside = dataclasses.replace(beside, pos=beside.pos + np.asarray([5.0, 0.0, 0.0]))
    both = dataclasses.replace(third, drones=(*third.drones, beside))
    content = diagnose(
        flight_set([first, second, both]),
        simulator="point_mass",
        exclude=exclude,
    )
    (effect,) = content.effects
    assert effect.name == "wind"
    assert content.shrink.n == 3
    for line in content.details.before_after:
        assert (np.diff(line.t) > 0).all()  # both drones' drift is one curve
        assert len(line.t) == len(line.before) == len(line.after) > 5


@few_or_all()
def test_of_a_single_flight_nothing_is_called_held_out(exclude):
    flights = point_mass_set(Wind(x=0.5), n_flights=1)
    content = diagnose(flights, simulator="point_mass", exclude=exclude)
    assert content.flights.held_out == []
    assert content.details.before_after == ()
    assert {line.evidence for line in content.candidates} == {None}


def tracks_of(replay, flights):
    """The flights as they were measured and as the simulator alone predicts them."""
    return make_likelihood(replay, flights, SIGMA).tracks(replay.library.neutral)


@pytest.fixture(scope="module")
def gusty(replay):
    """Tracks of flights in which a gust sets in."""
    return tracks_of(replay, point_mass_set(Gust(y=1.0, onset=3.1)).flights)


@pytest.fixture(scope="module")
def heavy(replay):
    """Tracks of flights of a heavier vehicle."""
    return tracks_of(replay, point_mass_set(Mass(e=0.2)).flights)


def test_a_gust_has_an_onset_in_its_channel(gusty):
    where = gap.where(gusty, SIGMA)
    found = {line.channel: line.onset_s for line in where}
    assert found["specific force y"] == pytest.approx(3.1, abs=0.5)
    assert found["specific force x"] is None


def test_a_gap_that_is_there_from_the_start_sets_in_nowhere(gusty):
    """Large in the first flight seconds and then small, as of a loop that swings in."""
    (side,) = (c for c in gap.channels(gusty, SIGMA) if c.name == "specific force y")
    turned = dataclasses.replace(gusty, t=gusty.t.max() - gusty.t)
    assert gap.onset(side, gusty) == pytest.approx(3.1, abs=0.5)
    assert gap.onset(side, turned) is None


def test_a_gap_that_grows_with_thrust_shows_in_that_regime(heavy):
    (line,) = [x for x in gap.where(heavy, SIGMA) if x.channel == "specific force z"]
    (thrust,) = [r for r in line.regimes if r.variable == "thrust"]
    assert thrust.gap[-1] > 1.05 * thrust.gap[0]
    assert np.all(np.diff(thrust.edges) > 0)


def test_a_gap_in_one_half_of_the_voltages_shows_in_that_regime(replay):
    """Flights of which two logged their battery, one of them with a gap."""
    heavy, plain = (point_mass_set(Mass(e=e), n_flights=2).flights for e in (0.2, 0.0))
    flights = [with_battery(heavy[0], 3.6), with_battery(plain[0], 4.1), plain[1]]
    (line,) = [
        x for x in gap.where(tracks_of(replay, flights), SIGMA) if x.channel == "specific force z"
    ]
    (battery,) = [r for r in line.regimes if r.variable == "battery"]
    assert battery.unit == "V"
    assert (battery.edges[0], battery.edges[-1]) == pytest.approx((3.5, 4.1), abs=0.02)
    assert battery.gap[0] > 4.0 * battery.gap[-1]
    assert "battery" not in gap.regimes(tracks_of(replay, plain))


def with_battery(flight, full):
    """The flight with a voltage [V] that falls from `full` by 0.1."""
    return edited(flight, lambda log: {"battery": np.linspace(full, full - 0.1, len(log.t))})


def test_the_gap_in_time_is_that_of_all_windows_which_start_then(heavy):
    for line, channel in zip(gap.in_time(heavy, SIGMA), gap.channels(heavy, SIGMA), strict=True):
        for t, rms, low, high in zip(line.t, line.gap, line.low, line.high, strict=True):
            then = np.abs(channel.value[(heavy.t == t) & np.isfinite(channel.value)])
            assert rms == pytest.approx(np.sqrt(np.mean(then**2)))
            assert (low, high) == (then.min(), then.max())


SPARSE = slice(None, None, 8)
"""One row of eight: no window holds enough of them."""


def test_a_flight_with_nothing_to_compare_is_left_out_by_name():
    good = point_mass_set(Wind(x=0.5), n_flights=4)
    mixed = dataclasses.replace(good, flights=(*good.flights[:3], thinned(good.flights[3], SPARSE)))
    inputs = prepare(Question(mixed, "point_mass")).inputs
    content = flights_used(mixed, inputs, lambda i: "fit")
    assert len(content.used) == 3
    (left_out,) = content.left_out
    assert left_out.name == "flight_3"
    assert (
        "flights/flight_3: in the air no 0.5 s without unknown commands hold 5 rows"
        in left_out.reason
    )


def test_flights_without_anything_to_compare_are_refused_with_a_line_each():
    flights = tuple(thinned(f, SPARSE) for f in point_mass_set(n_flights=2).flights)
    with pytest.raises(LogError, match=r"flight_0.*\n.*flight_1"):
        diagnose(flight_set(flights), simulator="point_mass")


def test_beside_a_reference_only_what_changed_is_named():
    """Wind blew before and after; the reference's files that were left out are reported."""
    before = point_mass_set(Wind(x=0.5), n_flights=4, seed=1)
    before = dataclasses.replace(before, left_out=(LeftOut("x.csv", "flights/x.csv: empty"),))
    after = point_mass_set(Wind(x=0.5), Mass(e=0.2), n_flights=4)
    content = diagnose(after, simulator="point_mass", reference=before)
    named = [e.name for e in content.effects]
    assert len(named) == 1
    assert "mass" in [*named, *content.effects[0].aliases]
    shared = {(x.effect, x.parameter): x.value for x in content.details.shared}
    assert shared["wind", "x"] == pytest.approx(0.5, abs=0.05)
    assert content.flights.left_out == ()
    assert content.reference.left_out == before.left_out
    assert {flight.use for flight in content.reference.used} == {"reference"}


@few_or_all("mass", "drag", "trim", others=("wind",))
def test_a_withheld_effect_is_not_blamed_and_what_is_left_is_located(exclude):
    content = diagnose(point_mass_set(Wind(x=0.5)), simulator="point_mass", exclude=exclude)
    named = {name for line in content.candidates for name in line.effects}
    assert named.isdisjoint({"wind", "gust"})
    assert judged_of(content.verdict) == "unexplained"
    sizes = [x for effect in content.effects for x in effect.parameters]
    assert sizes
    assert {x.use for x in sizes} == {"descriptive"}
    left = {line.channel: line.share for line in content.remainder.where}
    assert max(left, key=lambda name: left[name]) == "specific force x"
    why = {x.effect: x.why for x in content.details.not_observable}
    assert "excluded" in why["wind"]


def test_a_reference_of_another_vehicle_is_refused():
    flights = point_mass_set(n_flights=2)
    vehicle = dataclasses.replace(flights.vehicle, drone="cf2x_L250")
    with pytest.raises(LogError, match=r"vehicle\.toml: drone is"):
        diagnose(flights, reference=dataclasses.replace(flights, vehicle=vehicle))


def test_numbers_of_two_data_sheets_are_named():
    flights = point_mass_set(n_flights=1)
    one, other = (
        dataclasses.replace(
            flights,
            vehicle=dataclasses.replace(
                flights.vehicle, airframe=Airframe(thrust_max=1.0, attitude_lag=lag)
            ),
        )
        for lag in (0.1, None)
    )
    said = "attitude_lag is 0.1, but not given in the vehicle.toml of the reference"
    with pytest.raises(LogError, match=said):
        check_comparable(one, other)


def test_flights_of_several_drones_need_one_believed_mass():
    """Those of one drone go to the twin, which takes the difference out."""
    one, other = point_mass_set(n_flights=1), point_mass_set(n_flights=1, seed=1)
    heavier = dataclasses.replace(other.vehicle, mass=2.0 * other.vehicle.mass)
    question = Question(one, "point_mass", dataclasses.replace(other, vehicle=heavier))
    with pytest.raises(LogError, match="need the same mass in both"):
        prepare(question)


def test_a_flight_cannot_be_its_own_reference():
    flights = point_mass_set(n_flights=2)
    first, last = (dataclasses.replace(flights, flights=(one,)) for one in flights.flights)
    check_comparable(first, last)
    names = [flight.name for flight in flights.flights]
    said = f"flight {names[1]} has the positions of the flight {names[1]} of the reference"
    with pytest.raises(LogError, match=said):
        diagnose(last, reference=flights)


@pytest.mark.parametrize(("n", "held"), [(2, 2), (9, 9), (10, 3), (30, 10)])
def test_flights_are_held_out_once_there_are_ten(n, held):
    fit, out = shrinkage.split(n)
    assert len(out) == held
    assert (fit == out) == (n < 10)


@pytest.mark.parametrize(
    ("withheld", "name"),
    [
        (Mass(e=0.15), "mass"),
        # Close to where flights turn over, at 4 times the nominal lag.
        pytest.param(MotorLag(scale=3.5), "motor_lag", marks=pytest.mark.exhaustive),
    ],
    ids=["mass", "motor lag"],
)
def test_a_withheld_effect_is_named_through_crazyflow(withheld, name):
    few = all_but("mass", "drag", "delay", "motor_lag")
    content = diagnose(flight_set(fly(with_effects(Crazyflow(), [withheld]), 4, 4.0)), exclude=few)
    assert content.verdict == "effect"
    (effect,) = content.effects
    assert name in [effect.name, *effect.aliases]
    registered = set(registry.names("effect"))
    assert {line.effect for line in content.details.not_observable} <= registered
