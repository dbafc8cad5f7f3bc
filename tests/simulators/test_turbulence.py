"""Turbulence: Dryden's spectra at low altitude, exactly stepped, one air for the whole team."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, fly, hold, positions
from scipy.linalg import expm

from simulators.contract import with_effects
from simulators.effects.turbulence import FOOT, INTENSITIES, LENGTHS, Turbulence, innovation
from simulators.point_mass import PointMass

WIND = 6.0


def gusts(dt, n_steps):
    """u, v and w of a long flight [m/s]."""
    effect = Turbulence(wind=WIND, response=1.0)
    memory = effect.seeded(effect.init(1, dt), jax.random.key(0))

    def step(memory, _):
        memory, force, _ = effect.wrench(memory, FLIGHT, VEHICLE, dt)
        return memory, force[0] / VEHICLE.believed_mass

    return np.asarray(jax.lax.scan(step, memory, None, length=n_steps)[1])


NOMINAL = PointMass()
FLIGHT = NOMINAL.flight(NOMINAL.reset(positions(1), jax.random.key(0)))
VEHICLE = NOMINAL.spec.vehicle(drag=False)


def test_lengths_and_intensities_are_those_of_the_specification_at_10_ft():
    np.testing.assert_allclose(np.asarray(LENGTHS) / FOOT, [75.63, 75.63, 10.0], rtol=1e-3)
    np.testing.assert_allclose(INTENSITIES, [0.1963, 0.1963, 0.1], rtol=1e-3)


@pytest.mark.parametrize("r", [1e-3, 1e-2, 0.3, 0.999, 1.001, 4.0])
def test_what_a_step_adds_is_the_integral_of_white_noise_through_the_filter(r):
    # Van Loan's block matrix in time over T: dx = y, dy = -x - 2 y + 2 n.
    with jax.enable_x64(True):
        found = [float(x) for x in innovation(jnp.asarray(r))]
    a, noise = np.array([[0.0, 1.0], [-1.0, -2.0]]), np.diag([0.0, 4.0])
    block = expm(np.block([[-a, noise], [np.zeros((2, 2)), a.T]]) * r)
    covariance = block[2:, 2:].T @ block[:2, 2:]
    expected = [covariance[0, 0], covariance[0, 1], covariance[1, 1]]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def test_small_steps_keep_their_precision_in_single_precision():
    r = 2e-4
    xx, xy, yy = (float(x) for x in innovation(jnp.asarray(r, jnp.float32)))
    np.testing.assert_allclose([xx, xy, yy], [4 / 3 * r**3, 2 * r**2, 4 * r], rtol=1e-3)


@pytest.mark.parametrize("dt", [0.1, 1.0])
def test_variances_and_correlations_are_those_of_drydens_spectra(dt):
    found = gusts(dt, 200_000)
    np.testing.assert_allclose(found.std(0), WIND * np.asarray(INTENSITIES), rtol=0.1)
    for axis, lag in ((0, 1), (1, 1), (2, 1), (2, 3)):
        x = found[:, axis] / found[:, axis].std()
        tau = lag * dt * WIND / LENGTHS[axis]
        expected = np.exp(-tau) * (1.0 if axis == 0 else 1.0 - tau / 2.0)
        assert np.mean(x[lag:] * x[:-lag]) == pytest.approx(expected, abs=0.03)


def test_the_whole_team_flies_in_one_air_that_the_key_decides():
    simulator = with_effects(NOMINAL, [Turbulence(wind=WIND)])
    pos = positions(3)

    def flown(seed):
        state = simulator.reset(pos, jax.random.key(seed))
        return np.asarray(fly(simulator, state, hold(HOVER, 20, 3)).vel[-1])

    first = flown(0)
    np.testing.assert_allclose(first, np.broadcast_to(first[0], first.shape), atol=1e-6)
    assert np.array_equal(first, flown(0))
    assert np.abs(first - flown(1)).max() > 1e-3


def test_without_wind_nothing_differs_and_slopes_are_finite():
    def last(wind):
        simulator = with_effects(NOMINAL, [Turbulence(wind=wind)])
        state = simulator.reset(positions(1), jax.random.key(0))
        state = simulator.step_cmd(state, hold(HOVER, 1)[0], 0.02)
        return jnp.sum(simulator.flight(state).vel)

    value, slope = jax.value_and_grad(last)(0.0)
    plain = NOMINAL.step_cmd(
        NOMINAL.reset(positions(1), jax.random.key(0)), hold(HOVER, 1)[0], 0.02
    )
    assert float(value) == float(jnp.sum(NOMINAL.flight(plain).vel))
    assert np.isfinite(slope)
