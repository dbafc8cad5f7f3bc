"""The PD tracker follows a moving target in both simulators."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, SIMULATORS, SPEC, hovering, positions

from simulators.tracking import PDTracker
from simulators.vehicle import CONTROL_DT, VEHICLES

N, STEPS = 3, 300


def reference(t):
    """A circle of radius 1 m at 1 m/s, height swinging by 0.2 m: position and derivatives."""

    def pos(t):
        phase = t + jnp.arange(N)
        return jnp.stack(
            [jnp.cos(phase), jnp.sin(phase), 3.0 + 0.2 * jnp.sin(2 * t + 0 * phase)], -1
        )

    vel = lambda t: jax.jvp(pos, (t,), (jnp.ones_like(t),))[1]  # noqa: E731
    return pos(t), *jax.jvp(vel, (t,), (jnp.ones_like(t),))


@eqx.filter_jit
def tracked(simulator):
    """Distance to the reference after every step, and whether an action was clipped."""
    tracker = PDTracker()
    state = hovering(simulator, reference(jnp.asarray(0.0))[0])

    def step(state, k):
        action, clipped = tracker.action(simulator.flight(state), *reference(CONTROL_DT * k))
        state = simulator.step(state, action)
        goal = reference(CONTROL_DT * (k + 1))[0]
        return state, (jnp.linalg.norm(simulator.flight(state).pos - goal, axis=-1), clipped)

    return jax.lax.scan(step, state, jnp.arange(STEPS, dtype=float))[1]


# The lag of LF and, in HF, drag of 0.5 1/s against a position gain of 6 1/s^2 (0.5 / 6 = 0.08 m at
# 1 m/s) keep the drones behind; the prototype measured means of 0.04 to 0.11 m.
@pytest.mark.parametrize(("name", "bound"), [("point_mass", 0.06), ("crazyflow", 0.15)])
def test_the_tracker_follows_a_circle_at_1_m_per_s(name, bound):
    distance, clipped = tracked(SIMULATORS[name]())
    assert float(distance[100:].mean()) < bound
    assert float(clipped.mean()) < 0.03


def test_the_command_is_the_inverse_of_the_point_masss_acceleration():
    simulator = SIMULATORS["point_mass"]()
    flight = simulator.flight(hovering(simulator, positions(N)))
    tracker = PDTracker()
    pos, vel, acc = (jnp.asarray(np.random.default_rng(s).normal(size=(N, 3))) for s in range(3))
    pos, acc = flight.pos + 0.2 * pos, 0.5 * acc
    cmd = tracker.cmd(flight, pos, vel, acc)
    wanted = acc + 6.0 * (pos - flight.pos) + 4.0 * (vel - flight.vel)
    np.testing.assert_allclose(simulator.acceleration(cmd[:, :3], cmd[:, 3]), wanted, atol=1e-4)


def test_on_its_target_the_tracker_hovers():
    simulator = SIMULATORS["point_mass"]()
    flight = simulator.flight(hovering(simulator, positions(N)))
    cmd = PDTracker().cmd(flight, flight.pos, flight.vel, jnp.zeros((N, 3)))
    np.testing.assert_allclose(cmd, jnp.tile(jnp.asarray([0, 0, 0, HOVER]), (N, 1)), atol=1e-6)
    assert PDTracker().mass == SPEC.mass == VEHICLES["cf21B_500"].mass


def test_actions_out_of_range_are_clipped_and_reported():
    simulator = SIMULATORS["point_mass"]()
    flight = simulator.flight(hovering(simulator, positions(N)))
    goal = flight.pos.at[1, 0].add(10.0)
    action, clipped = PDTracker().action(flight, goal, flight.vel, jnp.zeros((N, 3)))
    assert clipped.tolist() == [False, True, False]
    assert float(jnp.abs(action).max()) == 1.0
