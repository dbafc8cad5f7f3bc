"""The contract of every registered simulator."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import (
    HOVER,
    KEY,
    SIMULATORS,
    SPEC,
    assert_near,
    fly,
    fly_from_rest,
    hold,
    hovering,
    positions,
    random_cmds,
)

pytestmark = pytest.mark.parametrize("name", SIMULATORS)

N, STEPS = 3, 50
# One rounding of float32 is 1.2e-7; programs of different shape round differently, and
# crazyflow's rotors (1e4 rev/min) and gyroscope amplify it over the flight.
ROUNDING = {"rtol": 1e-4, "atol": 2e-5}


def nominal_flight(name, seed=0):
    return fly_from_rest(SIMULATORS[name](), positions(N), random_cmds(seed, STEPS, N))


@pytest.mark.parametrize("n_drones", [1, 2, 5])
def test_a_flight_has_one_row_per_drone(name, n_drones):
    simulator = SIMULATORS[name]()
    action = jnp.zeros((n_drones, 3))
    state = jax.eval_shape(lambda: simulator.reset(positions(n_drones), KEY))
    after = jax.eval_shape(lambda s: simulator.step(s, action), state)
    flight = jax.eval_shape(simulator.flight, after)
    shapes = {field: getattr(flight, field).shape for field in vars(flight)}
    assert shapes == {
        "t": (),
        "pos": (n_drones, 3),
        "vel": (n_drones, 3),
        "quat": (n_drones, 4),
        "ang_vel": (n_drones, 3),
        "thrust": (n_drones,),
        "torque": (n_drones, 3),
    }


def test_a_step_keeps_the_structure_and_types_of_the_state(name):
    simulator = SIMULATORS[name]()
    state = jax.eval_shape(lambda: simulator.reset(positions(N), KEY))
    after = jax.eval_shape(lambda s: simulator.step(s, jnp.zeros((N, 3))), state)
    restored = jax.eval_shape(lambda: hovering(simulator, positions(N)))
    assert jax.tree.structure(state) == jax.tree.structure(after) == jax.tree.structure(restored)
    described = [[(x.shape, x.dtype) for x in jax.tree.leaves(s)] for s in (state, after, restored)]
    assert described[0] == described[1] == described[2]


def test_reset_puts_the_team_at_rest_and_level(name):
    simulator = SIMULATORS[name]()
    flight = simulator.flight(simulator.reset(positions(N), KEY))
    assert_near(flight.pos, positions(N))
    assert float(flight.t) == 0.0
    for rest in (flight.vel, flight.ang_vel, flight.thrust, flight.quat[:, :3]):
        assert not rest.any()
    assert (flight.quat[:, 3] == 1.0).all()


def test_jit_equals_eager(name):
    simulator = SIMULATORS[name]()
    state = simulator.reset(positions(N), KEY)
    cmds = random_cmds(1, 2, N)
    jitted = fly(simulator, state, cmds)
    for k in range(2):
        state = simulator.step_cmd(state, cmds[k], 0.02)
    assert_near(jax.tree.map(lambda x: x[-1], jitted), simulator.flight(state), **ROUNDING)


def test_vmap_over_worlds_equals_a_loop_of_single_worlds(name):
    simulator = SIMULATORS[name]()
    cmds = jnp.stack([random_cmds(seed, STEPS, N) for seed in range(3)])
    state = simulator.reset(positions(N), KEY)
    batched = eqx.filter_jit(jax.vmap(lambda c: fly(simulator, state, c)))(cmds)
    for seed in range(3):
        world = jax.tree.map(lambda x, seed=seed: x[seed], batched)
        assert_near(world, nominal_flight(name, seed), **ROUNDING)


def test_the_same_key_gives_the_same_flight(name):
    assert_near(nominal_flight(name), nominal_flight(name), rtol=0)


def test_renumbering_the_drones_renumbers_the_flight(name):
    order = np.array([2, 0, 1])
    cmds = random_cmds(0, STEPS, N)
    renumbered = fly_from_rest(SIMULATORS[name](), positions(N)[order], cmds[:, order])
    straight = nominal_flight(name)
    for field in ("pos", "vel", "quat", "ang_vel", "thrust"):
        expected = getattr(straight, field)[:, order]
        np.testing.assert_allclose(getattr(renumbered, field), expected, **ROUNDING)


def test_drones_do_not_act_on_each_other(name):
    cmds = random_cmds(0, STEPS, N)
    crowd = fly_from_rest(SIMULATORS[name](), jnp.zeros((N, 3)).at[:, 2].set(3.0), cmds)
    apart = fly_from_rest(SIMULATORS[name](), positions(N).at[:, 2].set(3.0), cmds)
    np.testing.assert_allclose(crowd.vel, apart.vel, **ROUNDING)


def test_a_step_is_the_command_of_its_action_held_for_20_ms(name):
    simulator = SIMULATORS[name]()
    state = hovering(simulator, positions(N))
    action = jnp.asarray([[0.3, -0.2, 0.1], [0.0, 0.5, -0.1], [-1.0, 1.0, 0.4]])
    stepped = eqx.filter_jit(lambda s: simulator.step(s, action))(state)
    cmd = jnp.stack(
        [0.5 * action[:, 0], 0.5 * action[:, 1], jnp.zeros(N), 0.4 * action[:, 2] + 0.4]
    )
    held = fly(simulator, state, cmd.T[None])
    assert_near(simulator.flight(stepped), jax.tree.map(lambda x: x[0], held), **ROUNDING)


def test_time_counts_what_was_flown(name):
    flight = nominal_flight(name)
    np.testing.assert_allclose(flight.t, 0.02 * np.arange(1, STEPS + 1), rtol=1e-5)


def test_quaternions_stay_unit(name):
    quat = nominal_flight(name).quat
    np.testing.assert_allclose(jnp.linalg.norm(quat, axis=-1), 1.0, atol=1e-5)


def test_hover_thrust_holds_the_height(name):
    """From spun-up rotors; what remains is the rounding of the rotor speed."""
    simulator = SIMULATORS[name]()
    flight = fly(simulator, hovering(simulator, positions(N)), hold([0, 0, 0, HOVER], STEPS, N))
    np.testing.assert_allclose(flight.pos[-1], positions(N), atol=1e-3)
    np.testing.assert_allclose(flight.thrust, HOVER, rtol=1e-4)


@pytest.mark.parametrize("axis", [0, 1])
def test_tilt_accelerates_in_the_direction_of_the_paper(name, axis):
    """Positive pitch flies to +x, positive roll to -y."""
    cmd = [0.0, 0.0, 0.0, HOVER]
    cmd[1 - axis] = 0.1
    simulator = SIMULATORS[name]()
    vel = fly(simulator, hovering(simulator, positions(N)), hold(cmd, STEPS, N)).vel[-1, 0]
    sign = 1.0 if axis == 0 else -1.0
    assert sign * vel[axis] > 0.5
    assert abs(vel[1 - axis]) < 0.02


def test_the_airframe_is_the_one_that_controllers_believe(name):
    assert SIMULATORS[name]().spec == SPEC
