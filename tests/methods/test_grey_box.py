"""Identification from three flights: what is found, in a known and in a disturbed reality."""

import contextlib
import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import METHODS, TINY, Hold, same

from methods import grey_box
from methods.calibration import identification
from methods.calibration.identification import NOISE_VEL, along, identify
from methods.calibration.remainder import remaining_transitions
from methods.contract import Setup
from methods.running.metered import train_metered
from methods.training.bptt import BPTT
from methods.training.evaluate import evaluation_keys, fly
from methods.training.policy import PolicyController, make_policy
from methods.training.varied import TIMES, vary_around
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.delay import Delay
from simulators.effects.drag import Drag
from simulators.effects.floor import Floor
from simulators.effects.mass import Mass
from simulators.effects.thrust_gain import ThrustGain
from simulators.effects.thrust_lag import ThrustLag
from simulators.effects.wind import Wind
from simulators.point_mass import PointMass
from tasks.circle import Circle
from tasks.contract import TaskState

DT, LARGEST = METHODS["grey_box"]().dt, METHODS["grey_box"]().largest
NOMINAL = PointMass(dt=DT)


KEY, OTHER = jax.random.key(0), jax.random.key(1)


@contextlib.contextmanager
def clean_logs():
    """Inside, flights are logged as they were flown."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification, "logged", lambda flights, key: flights)
        yield


@pytest.fixture(scope="module")
def found():
    """What the high-fidelity simulator differs by."""
    return identify(NOMINAL, Crazyflow(), DT, LARGEST, KEY)


@pytest.fixture(scope="module")
def other():
    """The same from flights of another key."""
    return identify(NOMINAL, Crazyflow(), DT, LARGEST, OTHER)


@pytest.fixture(scope="module")
def exact():
    """The same from logs without noise."""
    with clean_logs():
        return identify(NOMINAL, Crazyflow(), DT, LARGEST, KEY)


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


def drift(simulator, flown):
    """RMS distance [m] after each window of 0.5 s of a flight replayed in `simulator`."""
    n = 25

    def one(flight, action, start):
        pos, vel = (jnp.concatenate([a[None], x]) for a, x in zip(start, flight, strict=True))

        def step(state, row):
            k, pos, vel, action, after = row
            placed = simulator.with_motion(state, pos, vel)
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


def test_three_flights_are_flown_and_nothing_crashes(found):
    assert found.n_flights == 3
    assert found.crashes == 0


def check_physics(identified, drag, height):
    """Drag over mass is 0.499 1/s, the floor lies at -1 mm; rotors follow within 0.05 to 0.08 s.

    `drag` is the largest relative error, `height` the largest error of the floor [m].
    """
    spec = Crazyflow().spec
    assert float(effect(identified, Drag).c) == pytest.approx(spec.drag[0] / spec.mass, rel=drag)
    assert float(effect(identified, Floor).height) == pytest.approx(-0.001, abs=height)
    lag = effect(identified, ThrustLag)
    assert 0.05 < float(lag.up) < 0.08
    assert 0.05 < float(lag.down) < 0.08
    assert identified.notes["drag.c"] == pytest.approx(float(effect(identified, Drag).c))


def test_the_known_physics_of_the_reality_is_found(exact):
    check_physics(exact, drag=0.03, height=1e-5)


def test_the_known_physics_is_found_in_noisy_flights_of_any_seed(found, other):
    """A floor's height is the median of a dozen positions and more, each with 1 mm of noise."""
    for identified in (found, other):
        check_physics(identified, drag=0.05, height=1e-3)


def test_every_seed_has_flights_and_numbers_of_its_own(found, other):
    """Alike, as far as flights with noise can say; equal they are not."""
    assert not np.array_equal(found.flights.action, other.flights.action)
    for kind in (Drag, ThrustLag):
        for parameter in kind.parameters:
            one, two = (float(getattr(effect(x, kind), parameter)) for x in (found, other))
            assert one != two
            assert one == pytest.approx(two, rel=0.15)


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
        pytest.param(Wind(x=0.8, y=-0.5, z=0.0), {"x": 0.8, "y": -0.5}, id="wind"),
        pytest.param(
            Mass(e=0.15),
            {"e": 1.0 / 1.15 - 1.0},
            marks=pytest.mark.exhaustive,  # `make test` has the wind
            id="mass",
        ),
    ],
)
def test_an_effect_on_the_reality_is_found_as_well(disturbance, expected):
    """A mass is told by its acceleration: thrust_gain -0.130 is its alias in a point mass."""
    identified = identify(NOMINAL, with_effects(Crazyflow(), [disturbance]), DT, LARGEST, KEY)
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
    with clean_logs():
        identified = identify(NOMINAL, reality, DT, LARGEST, KEY)
    assert {type(e) for e in identified.effects} == {ThrustLag, Drag, Delay, Floor}
    for e in truth:
        for parameter in type(e).parameters:
            fitted = float(getattr(effect(identified, type(e)), parameter))
            assert fitted == pytest.approx(float(getattr(e, parameter)), rel=0.03)


def test_a_run_identifies_anew_by_its_own_key_and_is_billed_in_full(found, monkeypatch):
    """The same seed finds the same for every task and team size, another seed something else.

    One effect of what is found is trained in: programs with all of them take twice as long.
    """
    asked, found = [], dataclasses.replace(found, effects=(effect(found, Drag),))

    def identify(nominal, reality, dt, largest, key, n_flights, excitation, all_candidates):
        assert (n_flights, excitation, all_candidates) == (3, identification.DITHER, False)
        identification.fly(nominal, reality, key, n_flights, excitation)
        asked.append((float(nominal.dt), dt, largest, jax.random.key_data(key).tolist()))
        return found

    monkeypatch.setattr(grey_box, "identify", identify)
    cells = [(Hold(n_drones=2, horizon=5), 0), (Circle(n_drones=3, horizon=5), 0)]
    for task, seed in [*cells, (Hold(n_drones=2, horizon=5), 1)]:
        setup = Setup(task, PointMass(), Crazyflow())
        trained = train_metered(METHODS["grey_box"](trainer=TINY), setup, jax.random.key(seed))
        assert same(trained.effects, found.effects)
        assert trained.ledger.hf_fleet_seconds == pytest.approx(30.0)
        assert trained.ledger.calibration_flights == 3
        assert trained.notes.items() >= found.notes.items()
    assert asked[0] == asked[1]
    assert asked[0][:3] == asked[2][:3] == (DT, DT, LARGEST)
    assert asked[0][3] != asked[2][3]


@pytest.mark.parametrize("all_candidates", [False, True])
def test_drag_of_the_rotors_is_a_candidate_if_all_are_asked_for(monkeypatch, all_candidates):
    class Asked(Exception):  # noqa: N818 - no error, a way to stop
        pass

    def make_library(simulator, exclude):
        raise Asked(exclude)

    monkeypatch.setattr(identification, "fly", lambda *_: None)
    monkeypatch.setattr(identification, "_log", lambda *_: None)
    monkeypatch.setattr(identification, "make_library", make_library)
    asked = (PointMass(), Crazyflow(), DT, LARGEST, jax.random.key(0))
    with pytest.raises(Asked) as caught:
        identification.identify(*asked, all_candidates=all_candidates)
    (excluded,) = caught.value.args
    assert ("rotor_drag" in excluded) is not all_candidates
    assert "gust" in excluded  # it sets in at a moment of one flight


def test_what_is_left_vanishes_where_the_simulator_is_the_reality(found):
    """Targets are what the corrected point mass lacks: nothing, when it is the one that flies."""
    corrected = with_effects(NOMINAL, found.effects)
    with clean_logs():
        flights = identification.fly(NOMINAL, corrected, KEY)
    left = remaining_transitions(corrected, flights)
    assert len(left) == 3
    for transitions in left:
        assert 450 < len(transitions.target) <= 500
        np.testing.assert_allclose(transitions.target, 0.0, atol=2e-3)
    assert float(jnp.abs(along(corrected, flights).vel).max()) > 1.0


def test_of_noisy_flights_nothing_but_the_noise_is_left_there(found):
    """Velocities before and after a step are logged with noise of their own."""
    corrected = with_effects(NOMINAL, found.effects)
    flights = identification.fly(NOMINAL, corrected, KEY)
    left = remaining_transitions(corrected, flights)
    target = np.concatenate([transitions.target for transitions in left])
    expected = np.sqrt(2.0) * NOISE_VEL / 0.02
    np.testing.assert_allclose(target.std(axis=0), expected, rtol=0.06)
    np.testing.assert_allclose(target.mean(axis=0), 0.0, atol=0.01 * expected)  # it telescopes


def test_a_residual_is_believed_as_far_as_other_flights_confirm_it(exact):
    corrected = with_effects(NOMINAL, exact.effects)
    model, notes = grey_box.fit_residual("affine", corrected, exact, jax.random.key(0))
    assert 0.0 <= notes["residual_share"] < 1.0
    assert float(model.share) == pytest.approx(notes["residual_share"])
    left = remaining_transitions(corrected, exact.flights)
    x = left[0].features
    np.testing.assert_allclose(model(x), model.share * model.model(x), rtol=1e-6)
    assert notes["residual_error_rms"] < notes["residual_target_rms"]


def test_a_residual_of_what_nobody_lacks_is_hardly_believed(found):
    """Fitted to noise alone: flights of its own do not confirm it."""
    corrected = with_effects(NOMINAL, found.effects)
    flights = identification.fly(NOMINAL, corrected, KEY)
    noise = dataclasses.replace(found, flights=flights)
    model, notes = grey_box.fit_residual("affine", corrected, noise, jax.random.key(0))
    x = jnp.concatenate([t.features for t in remaining_transitions(corrected, flights)])
    acc = np.linalg.norm(model(x), axis=-1)
    assert np.sqrt(np.mean(acc**2)) < 0.05 * notes["residual_target_rms"]


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
        identify(NOMINAL, heavy, DT, LARGEST, KEY)


class Begun(BaseException):
    """Ends a training before its first epoch."""


@pytest.fixture
def trained_in(found, monkeypatch):
    """The simulator that the trainer is given, by the method's settings."""
    given = []
    monkeypatch.setattr(grey_box, "identify", lambda *_: found)

    def train_nothing(*a):
        given.append(a[2])
        raise Begun

    monkeypatch.setattr(BPTT, "train", train_nothing)

    def train(**settings):
        setup = Setup(Hold(n_drones=2, horizon=5), PointMass(), Crazyflow())
        with pytest.raises(Begun):
            METHODS["grey_box"](trainer=TINY, **settings).train(setup, KEY)
        return given[-1]

    return train


def test_training_draws_every_time_of_the_effects_anew(found, trained_in):
    """Within a factor exp(+-spread), in the simulator that the trainer is given."""
    simulator = trained_in(spread=0.3)
    keys = jax.random.split(jax.random.key(0), 500)
    drawn = np.asarray(jax.vmap(lambda k: simulator.reset(jnp.zeros((1, 3)), k).drawn)(keys))
    times = [
        float(getattr(e, name))
        for e in with_effects(NOMINAL, found.effects).effects
        for name, parameter in e.parameters.items()
        if parameter.unit in ("s", "rad/s")
    ]
    assert drawn.shape == (500, len(times))
    assert len(times) >= 3
    np.testing.assert_allclose(drawn.min(axis=0), np.exp(-0.3) * np.asarray(times), rtol=0.05)
    np.testing.assert_allclose(drawn.max(axis=0), np.exp(0.3) * np.asarray(times), rtol=0.05)


def test_training_knows_commands_that_are_later_than_the_flights_showed(trained_in):
    without, late = trained_in(delay=0.0), trained_in(delay=0.05)
    np.testing.assert_array_equal(without.low, late.low)
    later = np.asarray(late.high - without.high)
    of_delay = [isinstance(e, Delay) for e in late.simulator.effects for p in e.parameters.values()
                if p.unit in TIMES]  # fmt: skip
    assert sum(of_delay) == 1
    np.testing.assert_allclose(later, np.where(of_delay, 0.05, 0.0), atol=1e-6)


def test_of_two_delays_one_is_drawn_later():
    twice = with_effects(NOMINAL, [Delay(seconds=0.02), Delay(seconds=0.01)])
    assert len(twice.effects) == 2
    varied, plain = vary_around(twice, 0.0, delay=0.06), vary_around(twice, 0.0)
    later = np.sort(np.asarray(varied.high) - np.asarray(plain.high))
    np.testing.assert_allclose(later, [0.0, 0.06], atol=1e-6)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("largest", 0),
        ("dt", 0.0),
        ("dt", 0.05),
        ("dt", 0.0125),
        ("spread", -0.1),
        ("delay", 0.2),
        ("push", 1.1),
    ],
)
def test_settings_out_of_range_are_refused(field, value):
    with pytest.raises(ValueError, match=f"`{field}` must"):
        METHODS["grey_box"](**{field: value})
