"""Identification from three flights: what is found, in a known and in a disturbed reality."""

import dataclasses
import time
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import METHODS, TINY, Hold, same

from methods import grey_box, identification
from methods.contract import Setup
from methods.evaluate import evaluation_keys, fly
from methods.identification import along, identify, once
from methods.policy import PolicyController, make_policy
from methods.varied import make_varied
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects import chain
from simulators.effects.delay import Delay
from simulators.effects.drag import Drag
from simulators.effects.floor import Floor
from simulators.effects.mass import Mass
from simulators.effects.thrust_gain import ThrustGain
from simulators.effects.thrust_lag import ThrustLag
from simulators.effects.wind import Wind
from simulators.point_mass import PointMass
from simulators.rotation import quat_to_rpy
from tasks.circle import Circle
from tasks.contract import TaskState

DT, LARGEST = METHODS["grey_box"]().dt, METHODS["grey_box"]().largest
NOMINAL = PointMass(dt=DT)


@pytest.fixture(scope="module")
def found():
    """What the high-fidelity simulator differs by."""
    return once(identify, NOMINAL, Crazyflow(), DT, LARGEST)[0]


def effect(identified, kind):
    return next(e for e in identified.effects if isinstance(e, kind))


class Weave(eqx.Module):
    """A controller unlike any of the calibration flights: open loop, then back to hover."""

    def __call__(self, state: TaskState):
        t = 0.02 * state.step + jnp.arange(len(state.flight.pos))
        lift = jnp.where(state.step < 20, 0.5, 0.0)
        height = 0.8 * (1.2 - state.flight.pos[:, 2]) - 0.6 * state.flight.vel[:, 2]
        hover = PointMass().action_space.hover(PointMass().spec.mass)
        tilt = jnp.stack([0.6 * jnp.sin(3.1 * t), 0.5 * jnp.sin(4.3 * t + 1.0)], axis=-1)
        thrust = jnp.clip(hover + height + lift, -0.7, 0.95)[:, None]
        return jnp.concatenate([tilt, thrust], axis=-1)


def drift(simulator, flown, seconds=0.5):
    """RMS distance [m] after each window of a flight replayed in `simulator`."""
    n = round(seconds / 0.02)

    def one(flight, action, start):
        pos, vel = (jnp.concatenate([a[None], x]) for a, x in zip(start, flight, strict=True))

        def step(state, row):
            k, pos, vel, action, after = row
            placed = simulator.placed(state, pos, vel)
            pick = lambda new, old: jnp.where(k % n == 0, new, old)  # noqa: E731
            state = simulator.step(jax.tree.map(pick, placed, state), action)
            return state, simulator.flight(state).pos - after

        rows = (jnp.arange(len(action)), pos[:-1], vel[:-1], action, pos[1:])
        return jax.lax.scan(step, simulator.reset(pos[0], jax.random.key(0)), rows)[1]

    flight = (flown.flight.pos, flown.flight.vel)
    keys = evaluation_keys(0, len(flown.action))
    spawn = jax.vmap(lambda k: Circle().reset(jax.random.split(k)[0])[0])(keys)
    error = eqx.filter_jit(jax.vmap(one))(flight, flown.action, (spawn, jnp.zeros_like(spawn)))
    ends = np.asarray(error)[:, 2 * n - 1 :: n]  # the first window is the take-off
    return float(np.sqrt(np.mean(np.sum(ends**2, axis=-1))))


def test_half_a_fleet_minute_is_flown_and_nothing_crashes(found):
    assert found.n_flights == 3
    assert found.fleet_seconds == pytest.approx(30.0)
    assert found.crashes == 0


def test_the_known_physics_of_the_reality_is_found(found):
    """Drag over mass is 0.499 1/s, the floor lies at -1 mm; rotors follow within 0.05 to 0.08 s."""
    spec = Crazyflow().spec
    assert float(effect(found, Drag).c) == pytest.approx(spec.drag[0] / spec.mass, rel=0.03)
    assert float(effect(found, Floor).height) == pytest.approx(-0.001, abs=1e-5)
    lag = effect(found, ThrustLag)
    assert 0.05 < float(lag.up) < 0.08
    assert 0.05 < float(lag.down) < 0.08
    assert found.notes["drag.c"] == pytest.approx(float(effect(found, Drag).c))


def test_every_identified_effect_does_something(found):
    for e in found.effects:
        kind = type(e)
        assert any(float(getattr(e, p)) != i.neutral for p, i in kind.parameters.items())


def test_flights_that_were_not_fitted_are_predicted_far_better(found):
    flown = fly(Circle(horizon=300), Crazyflow(), Weave(), evaluation_keys(0, 4))
    before, after = drift(NOMINAL, flown), drift(with_effects(NOMINAL, found.effects), flown)
    assert before > 0.03
    assert after < 0.25 * before


@pytest.mark.parametrize(
    ("disturbance", "expected"),
    [
        (Wind(x=0.8, y=-0.5, z=0.0), {"x": 0.8, "y": -0.5}),
        (Mass(e=0.15), {"e": 1.0 / 1.15 - 1.0}),
    ],
    ids=["wind", "mass"],
)
def test_an_effect_on_the_reality_is_found_as_well(disturbance, expected):
    """A mass is told by its acceleration: thrust_gain -0.130 is its alias in a point mass."""
    identified = identify(NOMINAL, with_effects(Crazyflow(), [disturbance]), DT, LARGEST)
    kind = Wind if isinstance(disturbance, Wind) else (ThrustGain, Mass)
    e = effect(identified, kind)
    for parameter, value in expected.items():
        given = float(getattr(e, parameter))
        given = 1.0 / (1.0 + given) - 1.0 if isinstance(e, Mass) else given
        assert given == pytest.approx(value, rel=0.1)


def test_known_effects_of_a_point_mass_are_recovered():
    """Flown in the very simulator that is fitted, with effects it has: their numbers come back."""
    truth = [ThrustLag(up=0.09, down=0.06), Drag(c=1.0), Delay(seconds=0.035)]
    reality = with_effects(NOMINAL, [*truth, Floor(height=0.0)])
    identified = identify(NOMINAL, reality, DT, LARGEST)
    assert {type(e) for e in identified.effects} == {ThrustLag, Drag, Delay, Floor}
    for e in truth:
        for parameter in type(e).parameters:
            fitted = float(getattr(effect(identified, type(e)), parameter))
            assert fitted == pytest.approx(float(getattr(e, parameter)), rel=0.03)


def test_tasks_team_sizes_and_seeds_share_one_identification(monkeypatch):
    """The second run finds bit for bit what the first one did, and flies nothing."""
    calls = []
    flown = identification.fly
    monkeypatch.setattr(identification, "fly", lambda *a: calls.append(a) or flown(*a))
    monkeypatch.setattr(identification, "_KEPT", {})
    trained = []
    for task, seed in ((Hold(n_drones=2, horizon=5), 0), (Circle(n_drones=3, horizon=5), 1)):
        setup = Setup(task, PointMass(), Crazyflow())
        trained.append(METHODS["grey_box"](trainer=TINY).train(setup, jax.random.key(seed)))
    assert len(calls) == 1
    first, second = trained
    assert same(first.effects, second.effects)
    assert first.ledger.hf_fleet_seconds == second.ledger.hf_fleet_seconds == 30.0
    assert first.ledger.calibration_flights == second.ledger.calibration_flights == 3
    seconds = [seconds for value, seconds in identification._KEPT.values()]
    assert len(seconds) == 1
    assert min(t.ledger.train_seconds for t in trained) > seconds[0] > 0.0


def test_identifying_again_gives_the_same_bits(found):
    again = identify(NOMINAL, Crazyflow(), DT, LARGEST)
    assert same(found.effects, again.effects)
    assert chain.canonical(found.effects) == chain.canonical(again.effects)


def test_another_reality_is_not_taken_for_the_first():
    first, _ = once(lambda *a: a, 1, "a", Wind(x=1.0))
    assert once(lambda *a: a, 1, "a", Wind(x=1.0))[0] is not first  # another function
    make = lambda *a: object()  # noqa: E731
    assert once(make, 1, Wind(x=1.0)) == once(make, 1, Wind(x=1.0))
    assert once(make, 1, Wind(x=1.0))[0] is not once(make, 1, Wind(x=2.0))[0]
    assert once(make, 1, Wind(x=1.0))[0] is not once(make, 2, Wind(x=1.0))[0]


def test_threads_that_ask_for_the_same_wait_for_the_first():
    calls = []

    def slow(x):
        calls.append(x)
        time.sleep(0.2)
        return object()

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda x: once(slow, x), [1, 1, 1, 2]))
    assert sorted(calls) == [1, 2]
    assert found[0] == found[1] == found[2] != found[3]
    assert all(seconds >= 0.2 for _, seconds in found)


def test_what_is_left_vanishes_where_the_simulator_is_the_reality(found):
    """Targets are what the corrected point mass lacks: nothing, when it is the one that flies."""
    corrected = with_effects(NOMINAL, found.effects)
    flights = identification.fly(NOMINAL, corrected)
    left = grey_box.what_is_left(corrected, dataclasses.replace(found, flights=flights))
    assert len(left) == 3
    for transitions in left:
        assert 450 < len(transitions.target) <= 500
        np.testing.assert_allclose(transitions.target, 0.0, atol=2e-3)
    assert float(jnp.abs(along(corrected, flights).vel).max()) > 1.0


def test_a_residual_is_believed_as_far_as_other_flights_confirm_it(found):
    arguments = (NOMINAL, Crazyflow(), DT, LARGEST)
    (model, notes), _ = once(grey_box.fit_residual, "affine", *arguments)
    assert 0.0 <= notes["residual_share"] < 1.0
    assert float(model.share) == pytest.approx(notes["residual_share"])
    left = grey_box.what_is_left(with_effects(NOMINAL, found.effects), found)
    x = left[0].features
    np.testing.assert_allclose(model(x), model.share * model.model(x), rtol=1e-6)
    assert notes["residual_error_rms"] < notes["residual_target_rms"]


def test_the_gradient_through_the_effects_matches_finite_differences(found):
    """In double precision, over half a second that begins on the floor."""
    with jax.enable_x64(True):
        simulator = jax.tree.map(
            lambda x: jnp.asarray(np.asarray(x), float), with_effects(NOMINAL, found.effects)
        )
        task = Circle(n_drones=2, horizon=25)
        policy = make_policy(task, simulator.spec, simulator.action_space, jax.random.key(0))
        key = evaluation_keys(0, 1)

        def value(excess):
            lifted = eqx.tree_at(
                lambda p: p.net.layers[-1].bias,
                policy,
                policy.net.layers[-1].bias + excess * jnp.asarray([0.3, -0.2, 1.0]),
            )
            return jnp.sum(fly(task, simulator, PolicyController(task, lifted), key).reward)

        slope, h = jax.grad(value)(0.5), 1e-6
        assert float(slope) == pytest.approx(
            float((value(0.5 + h) - value(0.5 - h)) / (2 * h)), rel=1e-4
        )
        assert abs(float(slope)) > 0.1


def test_a_drone_that_cannot_rise_is_an_error():
    heavy = with_effects(Crazyflow(), [ThrustGain(e=-0.9)])
    with pytest.raises(ValueError, match="never left the ground"):
        identify(NOMINAL, heavy, DT, LARGEST)


def test_training_draws_every_time_of_the_effects_anew(found):
    """Factors within exp(+-spread), other parameters untouched; spread 0 is the simulator."""
    simulator = with_effects(NOMINAL, found.effects)
    pos, cmd = jnp.asarray([[0.0, 0.0, 1.0]]), jnp.asarray([[0.1, -0.2, 0.0, 0.5]])
    keys = jax.random.split(jax.random.key(0), 200)
    varied = make_varied(simulator, 0.5)
    factors = np.asarray(jax.vmap(lambda k: varied.reset(pos, k).factors)(keys))
    units = [p.unit for e in found.effects for p in type(e).parameters.values()]
    assert factors.shape == (200, sum(unit in ("s", "rad/s") for unit in units))
    assert factors.min() == pytest.approx(np.exp(-0.5), rel=0.05)
    assert factors.max() == pytest.approx(np.exp(0.5), rel=0.05)

    def flown(simulator, key):
        state = simulator.reset(pos, key)
        for _ in range(10):
            state = simulator.step_cmd(state, cmd, 0.02)
        return np.asarray(simulator.flight(state).vel)

    np.testing.assert_allclose(
        flown(make_varied(simulator, 0.0), keys[0]), flown(simulator, keys[0]), rtol=1e-6
    )
    assert np.abs(flown(varied, keys[0]) - flown(varied, keys[1])).max() > 0.01


def test_varied_times_stay_within_their_bounds():
    """A delay beyond its buffer would be extrapolated from it: a step came out as -3 steps."""
    varied = make_varied(with_effects(NOMINAL, [Delay(seconds=0.09)]), 0.5)
    flat = make_varied(with_effects(NOMINAL, [Delay(seconds=0.1)]), 0.0)
    hover, steep = (jnp.asarray([[roll, 0.0, 0.0, 0.4]]) for roll in (0.0, 0.5))

    def rolled(simulator, key):
        state, found = simulator.reset(jnp.asarray([[0.0, 0.0, 1.0]]), key), []
        for cmd in [hover] * 8 + [steep] * 8:
            state = simulator.step_cmd(state, cmd, 0.02)
            found.append(quat_to_rpy(simulator.flight(state).quat)[0, 0])
        return np.asarray(found)

    keys = jax.random.split(jax.random.key(0), 50)
    longest = max(keys, key=lambda k: float(varied.reset(jnp.ones((1, 3)), k).factors[0]))
    assert float(varied.reset(jnp.ones((1, 3)), longest).factors[0]) * 0.09 > 0.12
    np.testing.assert_allclose(rolled(varied, longest), rolled(flat, longest), atol=1e-6)
    assert rolled(varied, longest).min() > -1e-6


@pytest.mark.parametrize(
    ("field", "value"), [("largest", 0), ("dt", 0.0), ("dt", 0.05), ("spread", -0.1)]
)
def test_settings_out_of_range_are_refused(field, value):
    with pytest.raises(ValueError, match=f"`{field}` must"):
        METHODS["grey_box"](**{field: value})
