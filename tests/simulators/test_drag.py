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
