"""Simulators that are drawn anew in every episode: how numbers are drawn, and that they act."""

import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, assert_near, fly, hold, hover_flight, positions, random_cmds
from scipy.stats import kstest

from methods.domain_randomization import RANGES, randomized
from methods.training.varied import vary, vary_around
from simulators.algebra.rotation import quat_to_rpy
from simulators.contract import with_effects
from simulators.effects.attitude_loop import AttitudeLoop
from simulators.effects.delay import Delay
from simulators.effects.drag import Drag
from simulators.effects.late import LONGEST_DELAY_S
from simulators.effects.thrust_gain import ThrustGain
from simulators.effects.thrust_lag import ThrustLag
from simulators.effects.wind import Wind
from simulators.point_mass import PointMass

NOMINAL = PointMass(dt=0.01)
POS = positions(2)
KEYS = jax.random.split(jax.random.key(0), 4000)
EFFECTS = [
    AttitudeLoop(natural_freq=14.0, damping=0.7),
    ThrustLag(up=0.09, down=0.06),
    Drag(c=1.0),
    Delay(seconds=0.035),
]
TIMES = {"seconds": 0.035, "natural_freq": 14.0, "up": 0.09, "down": 0.06}
"""Those of the effects above, in the order of their doors."""
DISTURBED = with_effects(NOMINAL, EFFECTS)
ORDER = ("attitude_tau", "thrust_lag", "thrust_lag", "delay", "drag", "thrust_gain")


@eqx.filter_jit
def drawn(simulator, keys=KEYS):
    """The numbers of so many episodes, a row each."""
    return jax.vmap(lambda key: simulator.reset(POS, key).drawn)(keys)


def flown(simulator, key, cmds=None):
    """Flights of an episode under commands that change at every step."""
    cmds = random_cmds(0, 40, len(POS)) if cmds is None else cmds
    return fly(simulator, simulator.reset(POS, key), cmds)


assert_alike = functools.partial(assert_near, rtol=1e-5, atol=1e-6)


RANGED = {"up": (0.03, 0.15), "c": (0.0, 0.6), "e": (-0.14, 0.03)}


@pytest.fixture(scope="module")
def values():
    """Values of so many episodes, by name."""
    simulator = with_effects(NOMINAL, [ThrustLag(), Drag(), ThrustGain()])

    def numbers(simulator):
        found = {type(effect): effect for effect in simulator.effects}
        return [found[ThrustLag].up, found[Drag].c, found[ThrustGain].e]

    found = np.asarray(drawn(vary(simulator, numbers, list(RANGED.values()))), float)
    assert found.shape == (len(KEYS), len(RANGED))
    return dict(zip(RANGED, found.T, strict=True))


@pytest.mark.parametrize("name", RANGED)
def test_drawn_numbers_fill_their_range_and_stay_in_it(values, name):
    low, high = RANGED[name]
    slip = 1e-6 * (high - low)  # of single precision
    assert low - slip <= values[name].min() < low + 0.01 * (high - low)
    assert high - 0.01 * (high - low) < values[name].max() <= high + slip


def test_numbers_above_zero_are_drawn_log_uniformly(values):
    low, high = RANGED["up"]
    logs = np.log(values["up"])
    assert kstest((logs - np.log(low)) / np.log(high / low), "uniform").pvalue > 1e-3
    assert kstest((values["up"] - low) / (high - low), "uniform").pvalue < 1e-9
    error = np.log(high / low) / np.sqrt(12.0 * len(KEYS))
    assert logs.mean() == pytest.approx(0.5 * np.log(low * high), abs=4.0 * error)


@pytest.mark.parametrize("name", ["c", "e"])
def test_numbers_that_may_be_zero_or_below_are_drawn_uniformly(values, name):
    low, high = RANGED[name]
    assert kstest((values[name] - low) / (high - low), "uniform").pvalue > 1e-3
    error = (high - low) / np.sqrt(12.0 * len(KEYS))
    assert values[name].mean() == pytest.approx(0.5 * (low + high), abs=4.0 * error)


def test_numbers_are_drawn_independently_of_each_other(values):
    correlation = np.corrcoef(np.stack(list(values.values())))
    off = correlation[~np.eye(len(RANGED), dtype=bool)]
    assert np.abs(off).max() < 4.0 / np.sqrt(len(KEYS))


def test_nothing_to_draw_leaves_a_simulator_as_it_is():
    simulator = PointMass()
    assert vary_around(simulator, 0.5) is simulator


def test_times_are_drawn_within_a_factor_and_nothing_else_is():
    found = np.asarray(drawn(vary_around(DISTURBED, 0.5)))
    center = np.asarray(list(TIMES.values()))
    assert found.shape == (len(KEYS), len(center))
    np.testing.assert_allclose(found.min(axis=0), center * np.exp(-0.5), rtol=0.01)
    np.testing.assert_allclose(found.max(axis=0), center * np.exp(0.5), rtol=0.01)
    np.testing.assert_allclose(np.exp(np.log(found).mean(axis=0)), center, rtol=0.02)


def test_what_is_switched_off_beyond_its_bounds_is_not_drawn_within_them():
    """It would be switched on: a loop at 5e8 rad/s became one at 100 rad/s."""
    for loop in (AttitudeLoop(natural_freq=5e8, damping=1.5), AttitudeLoop()):
        with pytest.raises(
            ValueError, match=r"`natural_freq` of AttitudeLoop must lie in \[5, 100\]"
        ):
            vary_around(with_effects(NOMINAL, [loop]), 0.5)


def test_without_a_spread_it_is_the_simulator():
    same = vary_around(DISTURBED, 0.0)
    np.testing.assert_allclose(drawn(same, KEYS[:3]), [list(TIMES.values())] * 3, rtol=1e-6)
    assert_alike(flown(same, KEYS[0]), flown(DISTURBED, KEYS[0]))


def test_an_episode_flies_with_the_times_that_it_has_drawn():
    varied = vary_around(DISTURBED, 0.5)
    ends = []
    for key in KEYS[:3]:
        late, freq, up, down = drawn(varied, key[None])[0]
        effects = [
            AttitudeLoop(natural_freq=freq, damping=0.7),
            ThrustLag(up=up, down=down),
            Drag(c=1.0),
            Delay(seconds=late),
        ]
        assert_alike(flown(varied, key), flown(with_effects(NOMINAL, effects), key), atol=1e-5)
        ends.append(np.asarray(flown(varied, key).vel[-1]))
    assert min(np.abs(a - b).max() for a, b in itertools.pairwise(ends)) > 0.01


def test_a_delay_is_never_drawn_beyond_its_buffer():
    """It would be extrapolated from it: a step came out as -3 steps."""
    varied = vary_around(with_effects(NOMINAL, [Delay(seconds=0.09)]), 0.5)
    late = np.asarray(drawn(varied))[:, 0]
    assert 0.099 < late.max() <= LONGEST_DELAY_S * (1.0 + 1e-6)
    assert late.min() == pytest.approx(0.09 * np.exp(-0.5), rel=0.01)
    longest = KEYS[late.argmax()]
    cmds = jnp.concatenate([hold([r, 0.0, 0.0, HOVER], 8, len(POS)) for r in (0.0, 0.5)])
    roll = quat_to_rpy(flown(varied, longest, cmds).quat)[..., 0]
    fixed = with_effects(NOMINAL, [Delay(seconds=LONGEST_DELAY_S)])
    expected = quat_to_rpy(flown(fixed, longest, cmds).quat)[..., 0]
    np.testing.assert_allclose(roll, expected, atol=5e-3)
    assert float(roll.min()) > -1e-6
    assert float(roll.max()) > 0.1


def test_a_restored_flight_goes_on_with_the_numbers_as_they_are():
    varied = vary_around(DISTURBED, 0.5)
    history = random_cmds(1, 20, len(POS))
    begin = [s.restore(hover_flight(POS), history, KEYS[0]) for s in (varied, DISTURBED)]
    np.testing.assert_allclose(begin[0].drawn, list(TIMES.values()), rtol=1e-6)
    ends = [
        fly(s, b, random_cmds(2, 20, 2)) for s, b in zip((varied, DISTURBED), begin, strict=True)
    ]
    assert_alike(*ends)


# --- Domain randomization -------------------------------------------------------------------


def test_what_is_published_lies_within_the_bounds_of_the_effects():
    bounds = {
        "thrust_lag": ThrustLag.parameters["up"],
        "delay": Delay.parameters["seconds"],
        "drag": Drag.parameters["c"],
        "thrust_gain": ThrustGain.parameters["e"],
    }
    assert set(bounds) | {"attitude_tau"} == set(RANGES)
    for name, parameter in bounds.items():
        assert parameter.low <= RANGES[name][0] < RANGES[name][1] <= parameter.high
    assert 0.0 < RANGES["attitude_tau"][0] < float(NOMINAL.attitude_tau) < RANGES["attitude_tau"][1]


def test_vehicles_are_drawn_from_all_of_what_is_published_and_from_nothing_else():
    found = np.asarray(drawn(randomized(NOMINAL)))
    ends = np.asarray([RANGES[name] for name in ORDER])
    width = ends[:, 1] - ends[:, 0]
    assert (found >= ends[:, 0] - 1e-6 * width).all()
    assert (found <= ends[:, 1] + 1e-6 * width).all()
    assert (np.ptp(found, axis=0) > 0.98 * width).all()
    assert (found[:, 1] != found[:, 2]).all()  # thrust rises and falls at rates of its own


def test_a_drawn_vehicle_is_the_point_mass_with_these_effects():
    simulator, ends = randomized(NOMINAL), []
    for key in KEYS[:3]:
        tau, up, down, late, drag, gain = drawn(simulator, key[None])[0]
        effects = [ThrustLag(up=up, down=down), Delay(seconds=late), Drag(c=drag)]
        fixed = with_effects(
            PointMass(dt=NOMINAL.dt, attitude_tau=tau), [*effects, ThrustGain(e=gain)]
        )
        assert_alike(flown(simulator, key), flown(fixed, key), atol=1e-5)
        ends.append(np.asarray(flown(simulator, key).vel[-1]))
    assert min(np.abs(a - b).max() for a, b in itertools.pairwise(ends)) > 0.01


def test_commands_are_later_than_identified_by_a_drawn_time():
    """With an identified delay, and with none, where one is added."""
    known = np.asarray(drawn(vary_around(with_effects(NOMINAL, [Delay(seconds=0.02)]), 0.0, 0.03)))
    np.testing.assert_allclose([known.min(), known.max()], [0.02, 0.05], rtol=0.02)
    added = vary_around(with_effects(NOMINAL, [Drag(c=1.0)]), 0.5, 0.06)
    late = np.asarray(drawn(added))
    assert late.shape == (len(KEYS), 1)
    np.testing.assert_allclose([late.min(), late.mean(), late.max()], [0, 0.03, 0.06], atol=1e-3)
    own = with_effects(NOMINAL, [Drag(c=1.0), Delay(seconds=float(late[0, 0]))])
    assert_alike(flown(added, KEYS[0]), flown(own, KEYS[0]), atol=1e-5)


def test_a_steady_push_is_drawn_along_each_axis_around_what_was_identified():
    """With an identified wind, and with none, where one is added; no axis leaves its bounds."""
    pushed = vary_around(with_effects(NOMINAL, [Delay(seconds=0.02)]), 0.0, push=0.5)
    time, *push = np.asarray(drawn(pushed)).T
    np.testing.assert_allclose(time, 0.02)
    np.testing.assert_allclose([min(axis) for axis in push], [-0.5] * 3, atol=0.02)
    np.testing.assert_allclose([max(axis) for axis in push], [0.5] * 3, atol=0.02)
    assert abs(np.corrcoef(push)[0, 1]) < 0.2
    own = Wind(**dict(zip("xyz", (float(axis[0]) for axis in push), strict=True)))
    alike = with_effects(NOMINAL, [Delay(seconds=0.02), own])
    assert_alike(flown(pushed, KEYS[0]), flown(alike, KEYS[0]), atol=1e-5)
    known = np.asarray(
        drawn(vary_around(with_effects(NOMINAL, [Wind(x=1.0, z=0.8)]), 0.0, push=0.5))
    )
    np.testing.assert_allclose(known.min(axis=0), [0.5, -0.5, 0.3], atol=0.02)
    np.testing.assert_allclose(known.max(axis=0), [1.5, 0.5, 1.0], atol=0.02)
