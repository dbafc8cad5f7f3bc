"""Circle, the point mass and their training in PyTorch, in the style of DiffPhysDrone.

Steps in eager mode, autograd through the whole episode. Written from the equations of
`simulators/point_mass.py`, `tasks/circle.py` and `tasks/contact.py`; `test_peers.py` compares the
loss with theirs.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import torch

from methods.training.policy import Policy
from simulators.point_mass import PointMass
from simulators.vehicle import CONTROL_DT, GRAVITY
from tasks.circle import Circle
from tasks.contract import CORE

Weights = list[tuple[torch.Tensor, torch.Tensor]]


def weights_of(policy: Policy) -> Weights:
    """A policy's layers as leaves of PyTorch's graph."""
    tensor = lambda x: torch.tensor(np.asarray(x), requires_grad=True)  # noqa: E731
    return [(tensor(layer.weight), tensor(layer.bias)) for layer in policy.net.layers]


def loss_of(task: Circle, simulator: PointMass, policy: Policy, spawn: jax.Array) -> torch.Tensor:
    """Minus the mean smooth reward a drone and step, from `spawn`."""
    return _loss(task, simulator, weights_of(policy), torch.tensor(np.asarray(spawn)))


def epoch_of(
    task: Circle, simulator: PointMass, policy: Policy, spawn: jax.Array, lr: float
) -> Callable[[], float]:
    """A function that trains for one epoch and gives its loss."""
    weights, start = weights_of(policy), torch.tensor(np.asarray(spawn))
    leaves = [x for layer in weights for x in layer]
    adam = torch.optim.Adam(leaves, lr=lr)

    def epoch() -> float:
        adam.zero_grad()
        loss = _loss(task, simulator, weights, start)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(leaves, 0.5)
        adam.step()
        return loss.item()

    return epoch


def _loss(task: Circle, simulator: PointMass, weights: Weights, pos: torch.Tensor) -> torch.Tensor:
    """Positions, velocities, angles: worlds x drones x 3."""
    spec, space = simulator.spec, simulator.action_space
    lag = 1.0 - math.exp(-CONTROL_DT / float(simulator.attitude_tau))
    vel, rpy = torch.zeros_like(pos), torch.zeros_like(pos)
    rewards = []
    for _ in range(task.horizon):
        action = _observe(task, pos, vel)
        for weight, bias in weights:
            action = torch.tanh(action @ weight.T + bias)
        angles = action[..., :2] * space.tilt_limit
        thrust = 0.5 * space.thrust_max * (action[..., 2] + 1.0)
        wanted = torch.cat([angles, torch.zeros_like(angles[..., :1])], dim=-1)
        rpy = rpy + lag * (wanted - rpy)
        roll, pitch = rpy[..., 0], rpy[..., 1]
        direction = [pitch.sin() * roll.cos(), -roll.sin(), pitch.cos() * roll.cos()]
        acc = torch.stack(direction, dim=-1) * (thrust / spec.mass)[..., None]
        acc = acc - acc.new_tensor([0.0, 0.0, GRAVITY])
        vel = vel + CONTROL_DT * acc
        pos = pos + CONTROL_DT * vel
        rewards.append(_reward(task, pos, vel))
    return -torch.stack(rewards).mean()


def _norm(x: torch.Tensor) -> torch.Tensor:
    return (x.square().sum(dim=-1) + 1e-6).sqrt()


def _target(task: Circle, pos: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Offset, velocity, acceleration of where each drone should be."""
    xy = pos[..., :2]
    out = xy / _norm(xy).clamp(min=CORE)[..., None]
    height = task.altitude - pos[..., 2:]
    flat = torch.zeros_like(height)
    offset = torch.cat([float(task.radius) * out - xy, height], dim=-1)
    tangent = torch.cat([-out[..., 1:], out[..., :1], flat], dim=-1)
    inward = torch.cat([-out, flat], dim=-1)
    return offset, task.speed * tangent, task.speed**2 / float(task.radius) * inward


def _observe(task: Circle, pos: torch.Tensor, vel: torch.Tensor) -> torch.Tensor:
    offset, wanted, acc = _target(task, pos)
    k = min(task.n_neighbors, task.n_drones - 1)
    squared = torch.cdist(pos.detach(), pos.detach()).square()
    squared = squared + torch.diag(torch.full((task.n_drones,), math.inf))
    index = squared.topk(k, largest=False).indices
    worlds = torch.arange(len(pos))[:, None, None]
    state = torch.cat([pos, vel], dim=-1)
    relative = state[worlds, index] - state[:, :, None]
    seen = relative / (0.25 + relative[..., :3].square().sum(dim=-1, keepdim=True))
    seen = torch.nn.functional.pad(seen.flatten(2), (0, 6 * (task.n_neighbors - k)))
    return torch.cat([offset, wanted - vel, vel, acc, seen], dim=-1)


def _reward(task: Circle, pos: torch.Tensor, vel: torch.Tensor) -> Any:
    offset, wanted, _ = _target(task, pos)
    apart = _norm(pos[:, :, None] - pos[:, None]) + 10.0 * torch.eye(task.n_drones)
    inside = ((0.5 - apart) / 0.2).clamp(min=0.0)
    penalty = torch.where(inside < 1.0, 0.5 * inside.square(), inside - 0.5).sum(dim=-1)
    return -_norm(offset) - task.vel_weight * _norm(wanted - vel) - penalty
