"""What a policy is, and the shared one: a small network applied to each drone's own observation."""

import abc
from typing import TypeGuard

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simulators.vehicle import ActionSpace, VehicleSpec
from tasks.contract import AbstractTask, TaskState

WIDTH = 128
"""Width of both hidden layers; paper, Sec. III-A."""
OUTPUT_SCALE = 0.1
"""Factor on the output layer's initial weights, so that a fresh policy nearly hovers."""
LIFT = 0.1
"""Excess of a fresh policy's thrust action over hover: a drone that never lifts off learns
nothing in a simulator with a floor."""


class AbstractPolicy(eqx.Module):
    """Maps observations to actions. A method may have a class of its own.

    It is stored by its structure, so that it holds equinox modules, arrays, lists, tuples, numbers,
    text, and functions that stand at the top of a module.
    """

    @abc.abstractmethod
    def __call__(self, obs: Float[Array, "drones obs"]) -> Float[Array, "drones 3"]:
        """Actions in [-1, 1], one row a drone."""


class Policy(AbstractPolicy):
    """obs -> 128 -> 128 -> 3, tanh throughout. Source: paper, Sec. III-A."""

    net: eqx.nn.MLP
    """The network, for one drone."""

    def __call__(self, obs: Float[Array, "drones obs"]) -> Float[Array, "drones 3"]:
        """Actions in [-1, 1], from each drone's own row of `obs`."""
        return jax.vmap(self.net)(obs)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the observation and of what each layer gives."""
        weights = [layer.weight for layer in self.net.layers]
        return (weights[0].shape[1], *(weight.shape[0] for weight in weights))

    def layers(self, obs: Float[Array, "rows obs"]) -> list[Array]:
        """The observations and what each layer gives, the actions last."""
        values = [obs]
        for layer in self.net.layers:
            assert layer.bias is not None  # see `is_written_out`
            values.append(jnp.tanh(values[-1] @ layer.weight.T + layer.bias))
        return values

    def pull_back(
        self, values: list[Array], cotangent: Float[Array, "rows 3"]
    ) -> tuple[Float[Array, "rows obs"], "Policy"]:
        """Derivatives of a loss by the observations and by the policy, from those by the actions.

        `values` is what `layers` gave.
        """
        slopes = []
        for i, layer in reversed(list(enumerate(self.net.layers))):
            delta = cotangent * (1.0 - values[i + 1] ** 2)
            slopes += [jnp.sum(delta, axis=0), delta.T @ values[i]]
            cotangent = delta @ layer.weight
        return cotangent, eqx.tree_at(
            lambda policy: [x for layer in policy.net.layers for x in (layer.weight, layer.bias)],
            eqx.filter(self, eqx.is_inexact_array),
            slopes[::-1],
        )


def make_policy(
    task: AbstractTask, spec: VehicleSpec, space: ActionSpace, key: PRNGKeyArray
) -> Policy:
    """A fresh policy that roughly hovers.

    Raises:
        ValueError: The largest thrust that can be commanded hardly lifts the vehicle.
    """
    if space.hover(spec.mass) + LIFT >= 1.0:
        raise ValueError(
            f"A mass of {spec.mass:g} kg cannot take off: at most {space.thrust_max:g} N can be "
            "commanded. Give the simulator an `action_space` with a larger `thrust_max`."
        )
    net = _network(task.obs_size, key)
    hover = jnp.arctanh(space.hover(spec.mass) + LIFT)
    last = net.layers[-1]
    net = eqx.tree_at(
        lambda n: (n.layers[-1].weight, n.layers[-1].bias),
        net,
        (OUTPUT_SCALE * last.weight, jnp.zeros(3).at[2].set(hover)),
    )
    return Policy(net)


def _network(obs_size: int, key: PRNGKeyArray) -> eqx.nn.MLP:
    """The network with equinox's initial weights."""
    return eqx.nn.MLP(
        obs_size, 3, WIDTH, 2, activation=jnp.tanh, final_activation=jnp.tanh, key=key
    )


def is_written_out(policy: AbstractPolicy) -> TypeGuard[Policy]:
    """Whether `Policy.layers` is what a policy does: biases, and tanh throughout."""
    if type(policy) is not Policy:
        return False
    net = policy.net
    tanh = net.activation is jnp.tanh and net.final_activation is jnp.tanh
    return tanh and all(layer.bias is not None for layer in net.layers)


def is_shared(policy: AbstractPolicy) -> bool:
    """Whether a policy has the architecture that `make_policy` gives, whatever its weights."""
    if type(policy) is not Policy:
        return False
    own, size = policy.net, policy.net.in_size
    if not isinstance(size, int):
        return False
    shared = eqx.filter_eval_shape(_network, size, jax.random.key(0))
    shapes = lambda net: [  # noqa: E731
        (x.shape, x.dtype) if hasattr(x, "shape") else x for x in jax.tree.leaves(net)
    ]
    return jax.tree.structure(own) == jax.tree.structure(shared) and shapes(own) == shapes(shared)


class PolicyController(eqx.Module):
    """Deploys a policy on a task."""

    task: AbstractTask
    """Makes the observations."""
    policy: AbstractPolicy
    """Makes the actions."""

    def __call__(self, state: TaskState) -> Float[Array, "drones 3"]:
        return self.policy(self.task.observe(state))
