"""What is logged is what was flown: commands, times, noise and gaps."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from blind.draw import cases, catalogue
from blind.fly import flying, references
from blind.fly.realities import DT, HOVER
from simulators.crazyflow import Crazyflow
from simulators.flight import Flight

STATES = flying.COLUMNS[:13]
CMDS = flying.COLUMNS[13:]


@functools.cache
def flown(noise=1.0, seed=3, *effects):
    """Flights without dropouts of a case with the given (name, size)."""
    rng = np.random.default_rng(seed)
    t = np.arange(5000) * DT
    refs = [[references.make_reference(kind, t, rng)] for kind in range(8)]
    chosen = tuple(catalogue.draw_effect(name, size, rng, 10.0) for name, size in effects)
    disturbance = catalogue.make_disturbance(chosen, 8, rng)
    noise = flying.Noise().scaled(noise)
    return flying.fly("crazyflow", disturbance, refs, noise, np.random.default_rng(seed + 1))


@jax.jit
def replay(pos, steps, cmds):
    """Truth after each control step under logged commands, held for `steps` physics steps."""
    simulator = Crazyflow()
    still, level = jnp.zeros((1, 3)), jnp.asarray([[0.0, 0.0, 0.0, 1.0]])
    start = Flight(jnp.asarray(0.0), pos, still, level, still, jnp.asarray([HOVER]), still)
    hover = jnp.zeros((25, 1, 4)).at[:, :, 3].set(HOVER)

    def held(state, now):
        count, cmd = now

        def maybe(i, state):
            return jax.lax.cond(
                i < count, lambda s: simulator.step_cmd(s, cmd[None], DT), lambda s: s, state
            )

        after = jax.lax.fori_loop(0, 11, maybe, state)
        return after, jnp.concatenate([after.pos[0], after.vel[0], after.quat[0]])

    state = simulator.restore(start, hover, jax.random.key(0))
    return jax.lax.scan(held, state, (steps, cmds))[1]


def test_the_logged_commands_fly_the_logged_flight_in_the_nominal_simulator():
    """Times, commands and truth of a clean case belong together."""
    one = flown()[4]
    t = one.true["t"].to_numpy()
    steps = np.round(np.diff(t) / DT).astype(int)
    cmds = one.true[CMDS].to_numpy()
    found = replay(jnp.asarray(one.true[STATES[:3]].to_numpy()[:1]), steps, jnp.asarray(cmds[:-1]))
    np.testing.assert_allclose(found, one.true[STATES[:10]].to_numpy()[1:], atol=2e-3)


def test_an_effect_makes_the_nominal_replay_part_from_the_flight():
    one = flown(1.0, 3, ("drag", 1))[4]
    steps = np.round(np.diff(one.true["t"].to_numpy()) / DT).astype(int)
    start = jnp.asarray(one.true[STATES[:3]].to_numpy()[:1])
    found = replay(start, steps, jnp.asarray(one.true[CMDS].to_numpy()[:-1]))
    assert np.abs(found[:, :3] - one.true[STATES[:3]].to_numpy()[1:]).max() > 0.1


def test_the_controller_acts_every_18_to_22_ms():
    for one in flown():
        gaps = np.round(1e3 * np.diff(one.logged["t"]), 6)
        assert set(gaps) == {18.0, 20.0, 22.0}


def test_noise_has_its_declared_size():
    logged = np.concatenate([one.logged[STATES] for one in flown()])
    true = np.concatenate([one.true[STATES] for one in flown()])
    error = np.std(logged - true, axis=0)
    np.testing.assert_allclose(error[:3], 1e-3, rtol=0.1)
    np.testing.assert_allclose(error[3:6], 1e-2, rtol=0.1)
    np.testing.assert_allclose(error[10:], 2e-2, rtol=0.1)
    turn = 2 * np.arccos(np.minimum(np.abs(np.sum(logged[:, 6:10] * true[:, 6:10], axis=1)), 1.0))
    np.testing.assert_allclose(np.sqrt(np.mean(turn**2)), 3e-3 * np.sqrt(3), rtol=0.1)
    np.testing.assert_allclose(np.linalg.norm(logged[:, 6:10], axis=1), 1.0, atol=1e-5)


def test_without_noise_the_log_is_the_truth():
    for one in flown(0.0):
        np.testing.assert_allclose(one.logged[STATES], one.true[STATES], atol=1e-6)


def test_commands_swing_about_what_the_controller_asks_for():
    """Dither shakes every flight: the commands of a slow flight move at several hertz."""
    cmds = flown(0.0)[6].true[CMDS].to_numpy()[200:]
    assert (np.std(np.diff(cmds[:, :2], axis=0), axis=0) > 4e-3).all()
    assert np.std(np.diff(cmds[:, 3])) > 2e-3


def test_flights_stay_off_the_floor_and_low_ones_come_near():
    lowest = [one.true["pos_z"].min() for one in flown()]
    assert min(lowest) > 0.03
    assert all((lowest[kind] < 0.2) == (kind in references.LOW) for kind in range(8))


def test_dropped_rows_are_gone_from_log_and_truth_alike():
    rng = np.random.default_rng(0)
    shares, longest = [], []
    for one in flown() * 4:
        left = flying.drop_rows(one, rng)
        np.testing.assert_array_equal(left.logged["t"], left.true["t"])
        gaps = np.diff(left.logged["t"])
        longest.append(gaps.max())
        shares.append(1 - len(left.logged) / len(one.logged))
    assert 0.015 < np.mean(shares) < 0.09
    assert 0.1 < max(longest) < 0.85


def test_a_longer_flight_goes_on_where_the_first_call_of_the_program_ended():
    case = cases.make_case("clean", [], np.random.default_rng(2), seconds=12.0, noise=0.1)
    for one in cases.fly_case(dataclasses.replace(case, drones=1)):
        t, pos = one.true["t"].to_numpy(), one.true[STATES[:3]].to_numpy()
        assert t[-1] > 11.9
        speed = np.linalg.norm(np.diff(pos, axis=0), axis=1) / np.diff(t)
        assert speed.max() < 4.0


def test_an_unknown_reality_is_named():
    with pytest.raises(ValueError, match="`reality` must be one of crazyflow, rotorpy, got 'real'"):
        cases.fly_case(cases.make_case("clean", [], np.random.default_rng(0), reality="real"))
