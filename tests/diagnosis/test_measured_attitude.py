"""When an answer about forces, judged under the measured attitude, is believed."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flights_for_tests import COMMON, all_but, flight_set, misled, point_mass_set

from diagnosis.decide.prepared import reference_of
from diagnosis.decide.study import Study
from diagnosis.decide.verdict import Structure
from diagnosis.decision import Decision
from diagnosis.engine import diagnose
from diagnosis.logs.inputs import PRESCRIBED, choose_inputs
from diagnosis.replay.believed import nominal_simulator
from diagnosis.replay.library import make_library
from diagnosis.replay.replay import make_replay
from simulators.effects.thrust_gain import ThrustGain
from simulators.effects.thrust_lag import ThrustLag
from simulators.effects.wind import Wind

NOT_TRIED = all_but(*COMMON, "attitude_lag", "attitude_gain", "delay")
"""So few candidates share a program that compiles soon; the last three act through commands."""


@pytest.mark.parametrize(
    ("found", "kind", "share", "convinces"),
    [
        (50.0, "effect", 0.05, True),
        (50.0, "effect", 0.2, False),
        (50.0, "unexplained", 0.05, False),
        (1.13, "effect", 0.0, False),
    ],
)
def test_forces_convince_only_with_a_gap_and_a_clear_cause(found, kind, share, convinces):
    """A gap of mere noise, of which nothing is left to explain, has no cause."""
    verdict = types.SimpleNamespace(
        found=Structure(found, 700, 8), kind=kind, unexplained_share=share
    )
    study = object.__new__(Study)  # without flights: the answer alone is asked
    study.__dict__.update(
        prepared=types.SimpleNamespace(base=None, decision=Decision()), verdict=verdict
    )
    assert study.convinces() is convinces


@pytest.mark.parametrize(("enlarged", "lost"), [(24.0, True), (1.5, False)])
def test_beside_a_reference_whose_attitude_nothing_explains_none_is_believed(enlarged, lost):
    """Whatever was found of a change there; what the reference leaves would excuse anything."""
    study = object.__new__(Study)
    prepared = types.SimpleNamespace(
        inputs=types.SimpleNamespace(prescribed=False),
        decision=Decision(),
        base=types.SimpleNamespace(enlarged=np.r_[np.ones(6), enlarged, 1.0, 1.0]),
    )
    study.__dict__.update(prepared=prepared, verdict=types.SimpleNamespace(kind="effect"))
    assert study.attitude_lost() is lost


def fine_set(*effects, **settings):
    """Flights in steps so fine that a measured attitude is that of the forces, too."""
    return point_mass_set(*effects, dt=0.001, n_flights=4, **settings)


def spun_set(*effects, rotors_of=1.0):
    """The same with the speeds of rotors that follow steadily, and without commands."""
    return fine_set(*effects, ThrustLag(up=0.05, down=0.05), rotors_of=rotors_of)


def test_forces_are_judged_under_the_measured_attitude_where_nothing_explains_it():
    rng = np.random.default_rng(0)
    flights = [misled(f, rng, [0, 1], 0.15) for f in fine_set(Wind(x=1.5)).flights]
    content = diagnose(flight_set(flights), simulator="point_mass", exclude=NOT_TRIED)
    assert content.flights.driven_by == PRESCRIBED
    assert content.verdict == "effect"
    (effect,) = content.effects
    assert effect.name == "wind"
    assert effect.parameter("x").value == pytest.approx(1.5, abs=0.1)
    why = {x.effect: x.why for x in content.details.not_observable}
    assert "measurement" in why["attitude_lag"]
    noise = {line.channel: line.sigma for line in content.details.noise}
    assert noise["attitude roll"] is None
    assert noise["position x"] > 0.0


def test_rotor_speeds_alone_tell_a_weaker_thrust():
    flights = spun_set(ThrustGain(e=-0.1), rotors_of=1.0 / 0.9)
    content = diagnose(flights, simulator="point_mass", exclude=NOT_TRIED)
    assert content.flights.driven_by == "rotor speeds"
    (effect,) = content.effects
    assert "thrust_gain" in [effect.name, *effect.aliases]
    (size,) = effect.parameters
    expected = {"thrust_gain": -0.1, "mass": 1.0 / 0.9 - 1.0}[effect.name]
    assert size.value == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize(("given", "limited"), [(False, 0.65), (True, 0.48)])
def test_only_a_commanded_thrust_is_limited_to_what_can_be_commanded(given, limited):
    """Motors of this airframe can be commanded 0.48 N; PWM and voltage may stand for more."""
    flights = flight_set((), mass=0.027, drone="cf2x_L250")
    simulator = nominal_simulator("crazyflow", flights, limited=given)
    cmds = jnp.zeros((1, 4)).at[:, 3].set(0.65)
    state = simulator.reset(jnp.asarray([[0.0, 0.0, 5.0]]), jax.random.key(0))
    state = jax.jit(lambda state: simulator.step_cmd(state, cmds, 2.0))(state)
    np.testing.assert_allclose(simulator.flight(state).thrust, limited, rtol=1e-3)


def test_the_noise_of_measured_attitudes_is_no_effect():
    """Structure is one, where it was 1.5 while the noise in the force did not count."""
    content = diagnose(spun_set(), simulator="point_mass", exclude=NOT_TRIED)
    assert content.verdict == "none"
    assert content.remainder.share == 0.0
    hidden = {line.effect: line.why for line in content.details.not_observable}
    assert {"trim", "delay", "attitude_gain"} <= set(hidden)
    assert "prescribed" in hidden["trim"]
    assert content.remainder.structure_before == pytest.approx(1.0, abs=0.15)
    assert content.details.misfit.before == pytest.approx(1.0, abs=0.1)
    where = {line.channel: line for line in content.where}
    assert not any("attitude" in name for name in where)
    for axis, shaken in (("x", True), ("y", True), ("z", False)):
        line = where[f"specific force {axis}"]
        assert line.gap_rms == pytest.approx(line.noise_floor, rel=0.25)
        above = line.noise_floor > 1.05 * where["specific force z"].noise_floor
        assert above == shaken


def test_a_prescribed_reference_without_a_gap_enlarges_no_noise():
    """Its attitude holds no numbers, so that those of position and velocity count alone."""
    logged = spun_set()
    library = make_library(
        nominal_simulator("point_mass", logged), prescribed=True, referenced=True
    )
    replay = make_replay(library, 0.005, measured=4)
    found = reference_of(replay, choose_inputs(logged).flights, narrow=False)
    assert found.enlarged.max() < 1.15
