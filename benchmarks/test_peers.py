"""The same epoch of circle, trained in several ways; `make bench` prints a line for each.

An epoch is the same work everywhere: as many worlds, drones and steps, the same policy,
observation, reward and optimiser. What differs is the simulator (our point mass, or crazyflow's
fitted `so_rpy` stepped once a control step) and who differentiates it:
`methods/training/adjoint.py`, `jax.value_and_grad` of a scan written the obvious way, or PyTorch,
where it is installed, in the style of DiffPhysDrone (Zhang et al., 2024: a point mass stepped in
eager mode, gradients decayed).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
import pytest
from crazyflow.drones import Drone
from crazyflow.dynamics.core import parametrize
from crazyflow.dynamics.so_rpy import dynamics
from jaxtyping import Array, Float

from benchmarks.programs.training import epoch_of
from methods.training.bptt import BPTT, optimizer
from methods.training.policy import make_policy
from simulators.flight import Flight
from simulators.point_mass import PointMass
from simulators.vehicle import CONTROL_DT, VEHICLES, ActionSpace
from tasks.circle import Circle
from tasks.contract import TaskState
from tasks.rollout import start

KEY = jax.random.key(0)
TRAINER = BPTT(decay=1.0)
"""Without gradient decay, so that the plain scan does the same."""
TEAMS = (3, 12, 18)


SO_RPY = parametrize(dynamics, Drone.cf21B_500, xp=jnp)
"""Derivatives of (pos, quat, vel, ang_vel) under roll, pitch, yaw [rad] and thrust [N]."""


class SecondOrder(eqx.Module):
    """crazyflow's `so_rpy` as a cheap simulator: state (pos, quat, vel, ang_vel), Euler steps."""

    spec = VEHICLES["cf21B_500"]
    action_space: ActionSpace = ActionSpace()

    def reset(self, pos: Float[Array, "drones 3"], key: Array) -> tuple[Array, ...]:
        """At rest and level."""
        level = jnp.zeros((len(pos), 4)).at[:, 3].set(1.0)
        return pos, level, jnp.zeros_like(pos), jnp.zeros_like(pos)

    def flight(self, state: tuple[Array, ...]) -> Flight:
        """Time is not kept: only contact with the floor asks for it."""
        pos, quat, vel, ang_vel = state
        nothing = jnp.zeros(len(pos))
        return Flight(jnp.zeros(()), pos, vel, quat, ang_vel, nothing, jnp.zeros_like(pos))

    def step(self, state: tuple[Array, ...], action: Float[Array, "drones 3"]) -> tuple:
        """Semi-implicit Euler, as the point mass; the quaternion is normalised."""
        pos, quat, vel, ang_vel = state
        cmd = self.action_space.to_cmd(action)
        _, _, acc, ang_acc = SO_RPY(pos, quat, vel, ang_vel, cmd)
        vel, ang_vel = vel + CONTROL_DT * acc, ang_vel + CONTROL_DT * ang_acc
        _, turn, _, _ = SO_RPY(pos, quat, vel, ang_vel, cmd)
        quat = quat + CONTROL_DT * turn
        quat = quat / jnp.linalg.norm(quat, axis=-1, keepdims=True)
        return pos + CONTROL_DT * vel, quat, vel, ang_vel


SIMULATORS = {"point mass": PointMass, "so_rpy": SecondOrder}


def plain_loss(policy, task, simulator, keys):
    """Minus the mean smooth reward a drone and step: a scan over steps inside a vmap."""

    def fly(key):
        first, goal = start(task, simulator, key)

        def step(state, k):
            action = policy(task.observe(TaskState(simulator.flight(state), goal, k)))
            state = simulator.step(state, action)
            after = TaskState(simulator.flight(state), goal, k + 1)
            return state, jnp.mean(task.rewards(after)[1])

        return jnp.mean(jax.lax.scan(step, first, jnp.arange(task.horizon))[1])

    return -jnp.mean(jax.vmap(fly)(keys))


@eqx.filter_jit
def plain_update(policy, state, task, simulator, keys):
    """One epoch as it is written without a second thought."""
    loss, slopes = eqx.filter_value_and_grad(plain_loss)(policy, task, simulator, keys)
    steps, state = optimizer(TRAINER.clip).update(slopes, state)
    updates = jax.tree.map(lambda step: -TRAINER.lr * step, steps)
    return eqx.apply_updates(policy, updates), state, loss, optax.tree.norm(slopes)


def given(simulator_name, n_drones):
    """Task, simulator and fresh policy."""
    task, simulator = Circle(n_drones=n_drones), SIMULATORS[simulator_name]()
    return task, simulator, make_policy(task, simulator.spec, simulator.action_space, KEY)


@pytest.mark.parametrize("n_drones", TEAMS)
@pytest.mark.parametrize("simulator_name", SIMULATORS)
def test_our_epoch(benchmark, simulator_name, n_drones):
    task, simulator, policy = given(simulator_name, n_drones)
    epoch = epoch_of(TRAINER, task, simulator, policy, KEY)
    _agrees(epoch(), task, simulator, policy)
    benchmark.pedantic(epoch, rounds=7)


@pytest.mark.parametrize("n_drones", TEAMS)
@pytest.mark.parametrize("simulator_name", SIMULATORS)
def test_a_scan_written_the_obvious_way(benchmark, simulator_name, n_drones):
    task, simulator, policy = given(simulator_name, n_drones)
    state = optimizer(TRAINER.clip).init(eqx.filter(policy, eqx.is_inexact_array))
    keys = jax.random.split(KEY, TRAINER.worlds(n_drones))
    carried = [(policy, state)]

    def epoch():
        *carried[0], _, norm = plain_update(*carried[0], task, simulator, keys)
        return jax.block_until_ready(norm)

    assert jnp.isfinite(epoch())
    benchmark.pedantic(epoch, rounds=7)


@pytest.mark.parametrize("n_drones", TEAMS)
def test_pytorch_point_mass(benchmark, n_drones):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from benchmarks.programs import torch_circle

    task, simulator, policy = given("point mass", n_drones)
    n_worlds = TRAINER.worlds(n_drones)
    keys = jax.random.split(KEY, n_worlds)
    spawn = jax.vmap(lambda key: start(task, simulator, key)[0].pos)(keys)
    ours = plain_loss(policy, task, simulator, keys)
    torch.set_num_threads(1)
    theirs = torch_circle.loss_of(task, simulator, policy, spawn)
    assert theirs.item() == pytest.approx(float(ours), rel=1e-4)
    epoch = torch_circle.epoch_of(task, simulator, policy, spawn, TRAINER.lr)
    epoch()
    benchmark.pedantic(epoch, rounds=3)


def _agrees(row, task, simulator, policy):
    """The written-out gradient has the norm of the plain one's, in the same epoch."""
    keys = jax.random.split(KEY, TRAINER.worlds(task.n_drones))
    slopes = eqx.filter_jit(eqx.filter_grad(plain_loss))(policy, task, simulator, keys)
    assert float(row["grad_norm"]) == pytest.approx(float(optax.tree.norm(slopes)), rel=1e-3)
