"""What a team's own flights of its task show of reality: rows as those of the calibration pool."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Key, PRNGKeyArray

from methods.calibration.pool import TrackingFlight, as_flown
from methods.training.policy import AbstractPolicy, PolicyController
from simulators.contract import AbstractSimulator
from tasks.contact import in_contact
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
            state, shadow = carry
            before = reality.flight(state)
            action = controller(TaskState(reality.sensed(state), goal, k))
            shadow = as_flown(nominal, shadow, before)
            shadow, state = nominal.step(shadow, action), reality.step(state, action)
            after, lagged = reality.flight(state), nominal.flight(shadow)
            return (state, shadow), TrackingFlight(
                before=before,
                after=after,
                nominal_quat=lagged.quat,
                nominal_thrust=lagged.thrust,
                nominal_vel=lagged.vel,
                action=action,
                clipped=jnp.zeros(task.n_drones, bool),
                contact=in_contact(after.pos, after.t),
            )

        return jax.lax.scan(step, (state, shadow), jnp.arange(task.horizon))[1]

    return jax.lax.map(one, keys)
