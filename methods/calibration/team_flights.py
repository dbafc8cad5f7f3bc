"""What a team's own flights of its task show of reality: rows as those of the calibration pool."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Key, PRNGKeyArray

from methods.calibration.pool import TrackingFlight, tracked
from methods.training.policy import AbstractPolicy, PolicyController
from simulators.contract import AbstractSimulator
from tasks.contract import AbstractTask, TaskState
from tasks.rollout import start


@eqx.filter_jit
def fly_team(
    task: AbstractTask,
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    policy: AbstractPolicy,
    keys: Key[Array, " flights"],
) -> TrackingFlight:
    """Whole episodes of the team in `reality`, a nominal lag running along on the same actions."""
    controller = PolicyController(task, policy)

    def one(key: PRNGKeyArray) -> TrackingFlight:
        state, goal = start(task, reality, key)
        shadow = nominal.reset(reality.flight(state).pos, key)

        def step(carry: tuple, k: Array) -> tuple[tuple, TrackingFlight]:
            before = reality.flight(carry[0])
            action = controller(TaskState(reality.sensed(carry[0]), goal, k))
            clipped = jnp.zeros(task.n_drones, bool)
            return tracked(nominal, reality, carry, before, action, clipped)

        return jax.lax.scan(step, (state, shadow), jnp.arange(task.horizon))[1]

    return jax.lax.map(one, keys)
