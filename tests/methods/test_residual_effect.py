"""A residual is frozen: it moves the drones, and no gradient passes through it."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import CLIMB, RESIDUALS, SPEC, Hold, climb_gradient, fresh, lift

from methods.calibration.residual_effect import ResidualEffect, features
from methods.residuals.contract import (
    HISTORY,
    AbstractHistoryModel,
    AbstractResidualModel,
    Transitions,
)
from methods.training.policy import PolicyController
from simulators.contract import with_effects
from simulators.effects.contract import WrenchEffect
from simulators.effects.delay import Delay
from simulators.effects.mass import Mass
from simulators.point_mass import PointMass
from tasks.rollout import episode, record

KEY = jax.random.key(3)
TASK = Hold(n_drones=2, horizon=8, spacing=(0.4, 3.0), goal=(0.3, 0.2, 0.5))


class Damping(AbstractResidualModel):
    """-2 v plus a push sideways."""

    rate: float = 2.0

    def __call__(self, features):
        return jnp.asarray([0.5, 0.0, 0.0]) - self.rate * features[:, 3:6]


class Replay(WrenchEffect):
    """Accelerations written down before, by step."""

    acc: jax.Array

    parameters: ClassVar[dict] = {}
    version: ClassVar[str] = "1"

    def init(self, n_drones, dt):
        return jnp.asarray(0)

    def wrench(self, memory, flight, vehicle, dt):
        force = vehicle.mass * self.acc[memory]
        return memory + 1, force, jnp.zeros_like(force)


@pytest.mark.parametrize("effects", [(), (Mass(e=0.2),)], ids=["believed", "heavier"])
def test_what_it_adds_is_an_acceleration_whatever_the_drone_weighs(effects):
    vel = []
    for more in (effects, (*effects, ResidualEffect(Damping(), SPEC.mass))):
        simulator = with_effects(PointMass(), more)
        state = simulator.reset(jnp.zeros((2, 3)).at[:, 2].set(1.0), KEY)
        state = simulator.step_cmd(state, jnp.zeros((2, 4)).at[:, 3].set(0.4), 0.002)
        vel.append(np.asarray(simulator.flight(state).vel))
    np.testing.assert_allclose(vel[1] - vel[0], [[0.001, 0.0, 0.0]] * 2, atol=1e-7)


def corrected(model):
    return with_effects(PointMass(), [ResidualEffect(model, SPEC.mass)])


@eqx.filter_jit
@eqx.filter_grad
def gradients(learned, simulator):
    """Of the return, by the policy and by the residual that `simulator` is given."""
    policy, model = learned
    if model is not None:
        simulator = with_effects(simulator, [ResidualEffect(model, SPEC.mass)])
    controller = PolicyController(TASK, policy)
    return episode(TASK, simulator, controller, KEY).smooth_reward


@pytest.fixture(scope="module", params=sorted(RESIDUALS))
def model(request):
    """A fit to noise: anything but zero."""
    x_key, y_key, fit_key = jax.random.split(KEY, 3)
    transitions = Transitions(
        features=jax.random.normal(x_key, (60, 12)),
        target=2.0 + jax.random.normal(y_key, (60, 3)),
        weight=jnp.ones(60),
        history=jax.random.uniform(x_key, (60, HISTORY, 4)),
    )
    return RESIDUALS[request.param]().fit(transitions, fit_key)


def written_down(policy, model):
    """Accelerations of the residual along the episode, from single steps without it."""
    simulator, nominal = corrected(model), PointMass()
    task_key, simulator_key = jax.random.split(KEY)
    pos, _ = TASK.reset(task_key)
    state, acc = simulator.reset(pos, simulator_key), []
    actions = record(TASK, simulator, PolicyController(TASK, policy), KEY).action
    for action in actions:
        without = nominal.step(eqx.tree_at(lambda s: s.memory, state, ()), action)
        state = simulator.step(state, action)
        acc.append((state.vel - without.vel) / 0.02)
    return jnp.stack(acc)


def test_gradients_pass_the_residual_as_if_its_output_had_been_written_down(model):
    policy = fresh(TASK)
    by_policy, by_model = gradients((policy, model), PointMass())
    leaves = jax.tree.leaves(eqx.filter(by_model, eqx.is_array))
    assert leaves
    assert all((np.asarray(leaf) == 0.0).all() for leaf in leaves)

    acc = written_down(policy, model)
    assert np.abs(acc).min() > 0.1
    expected, _ = gradients((policy, None), with_effects(PointMass(), [Replay(acc)]))
    for a, b in zip(jax.tree.leaves(by_policy), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-3 * float(np.abs(b).max()))


def test_the_gradient_through_a_linear_flight_is_the_nominal_one():
    """Damping changes the flight, but an unfrozen one would make the gradient smaller too."""

    def total(controller, simulator):
        return episode(CLIMB, simulator, controller, KEY).smooth_reward

    plan, damped = lift(CLIMB, 0.1), corrected(Damping())
    found = eqx.filter_jit(eqx.filter_grad(total))(plan, damped).actions[:, 0, 2]
    np.testing.assert_allclose(found, climb_gradient(CLIMB, 1.0), rtol=1e-4)
    assert float(total(plan, damped)) < float(total(plan, PointMass())) - 1e-3


def test_features_are_the_papers_twelve_numbers():
    nominal = PointMass()
    state = nominal.reset(jnp.asarray([[1.0, 2.0, 3.0]]), KEY)
    for _ in range(10):
        state = nominal.step(state, jnp.asarray([[0.4, -0.6, 0.3]]))
    before, state = state, nominal.step(state, jnp.asarray([[0.4, -0.6, 0.3]]))
    x = np.asarray(features(nominal.flight(state), SPEC.mass))[0]
    np.testing.assert_allclose(x[:3], state.pos[0])
    np.testing.assert_allclose(x[3:6], state.vel[0])
    np.testing.assert_allclose(x[6:9], state.rpy[0], atol=1e-6)
    np.testing.assert_allclose(x[9:], (state.vel - before.vel)[0] / 0.02, atol=1e-3)


class Echo(AbstractHistoryModel):
    """The thrust commands of the last steps, weighted: 1, 10, 100 and so on, the newest first."""

    def __call__(self, features):
        thrust = features[:, 12:].reshape(len(features), HISTORY, 4)[:, ::-1, 3]
        push = thrust @ (10.0 ** jnp.arange(HISTORY))
        return jnp.zeros((len(features), 3)).at[:, 0].set(push)


@pytest.mark.parametrize("dt", [0.02, 0.01, 0.015, 0.05])
def test_a_rollout_carries_the_last_commands(dt):
    """At each step the last five, whatever the integration step; restored flights know theirs."""
    nominal, thrusts = PointMass(dt=dt), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    simulator = with_effects(nominal, [ResidualEffect(Echo(), SPEC.mass)])
    cmds = jnp.zeros((7, 1, 4)).at[:, 0, 3].set(jnp.asarray(thrusts))
    state = simulator.reset(jnp.zeros((1, 3)), KEY)
    pushed = []
    for cmd in cmds:
        before, state = state.vel, simulator.step_cmd(state, cmd, 0.02)
        pushed.append(float(state.vel[0, 0] - before[0, 0]) / 0.02)
    np.testing.assert_allclose(pushed[:2], [1.0, 12.0], rtol=1e-4)
    np.testing.assert_allclose(pushed[6], 34567.0, rtol=1e-4)

    flight = nominal.flight(nominal.reset(jnp.zeros((1, 3)), KEY))
    warm = simulator.restore(flight, cmds[:6], KEY)
    after = simulator.step_cmd(warm, cmds[6], 0.02)
    np.testing.assert_allclose(after.vel[0, 0] / 0.02, 34567.0, rtol=1e-4)


def test_it_is_told_the_command_that_was_sent():
    """As in the rows that it was fitted to, whatever becomes of the command on its way."""
    late = with_effects(PointMass(), [Delay(seconds=0.04), ResidualEffect(Echo(), SPEC.mass)])
    state = late.reset(jnp.zeros((1, 3)), KEY)
    after = late.step_cmd(state, jnp.zeros((1, 4)).at[0, 3].set(2.0), 0.02)
    np.testing.assert_allclose(after.vel[0, 0] / 0.02, 2.0, rtol=1e-4)
