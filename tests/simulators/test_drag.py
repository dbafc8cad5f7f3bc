"""Drag that is taken away, because a simulator has too much of it."""

import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, SIMULATORS, attached, fly, hold, hovering, positions

from simulators.effects.quadratic_drag import FASTEST

DT = 0.002


@pytest.mark.parametrize("k", [0.1, -0.1])
@pytest.mark.parametrize("speed", [5.0, 19.0, 40.0])
def test_drag_below_zero_grows_no_faster_than_linearly_beyond_any_flight(k, speed):
    """With the square it would push a drone to infinity within an episode."""
    simulator = attached(SIMULATORS["point_mass"](dt=DT), quadratic_drag={"k": jnp.asarray(k)})
    start = hovering(simulator, positions(1), jnp.asarray([[speed, 0.0, 0.0]]))
    after = fly(simulator, start, hold([0.0, 0.0, 0.0, HOVER], 1), DT).vel[0, 0, 0]
    counted = min(speed, FASTEST) if k < 0.0 else speed
    np.testing.assert_allclose(after - speed, -k * counted * speed * DT, rtol=0.02)


def test_lift_grows_no_further_beyond_any_flight():
    """Without drag a drone at full thrust would be at infinity within ten seconds."""
    simulator = attached(
        SIMULATORS["point_mass"](dt=DT), translational_lift={"k": jnp.asarray(0.6)}
    )
    rises = []
    for speed in (10.0, 19.0, 40.0, 400.0):
        start = hovering(simulator, positions(1), jnp.asarray([[speed, 0.0, 0.0]]))
        rises.append(fly(simulator, start, hold([0.0, 0.0, 0.0, HOVER], 1), DT).vel[0, 0, 2] / DT)
    np.testing.assert_allclose(rises, 0.6 * np.asarray([10.0, 19.0, 20.0, 20.0]) ** 2, rtol=0.02)
