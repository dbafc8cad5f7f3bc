"""Reference paths: what a policy flies in the nominal simulator, for a PD controller to follow.

One role of a path is what a calibration flight follows; all of them at once, by the team in an
episode that starts alike, is the paper's baseline without any training (Sec. V-C).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simulators.contract import AbstractSimulator
from simulators.tracking import PDTracker
from simulators.vehicle import CONTROL_DT
from tasks.contract import AbstractTask, TaskState
from tasks.rollout import AbstractEpisodeController, Controller, record


class ReferencePath(eqx.Module):
    """Paths to follow, world frame, `CONTROL_DT` apart; of one drone or of a team."""

    pos: Float[Array, "time *drones 3"]
    """Position [m]."""
    vel: Float[Array, "time *drones 3"]
    """Velocity [m/s]."""
    acc: Float[Array, "time *drones 3"]
    """Acceleration until the next entry [m/s^2]."""


def team_reference(
    task: AbstractTask, nominal: AbstractSimulator, leader: Controller, key: PRNGKeyArray
) -> ReferencePath:
    """The paths of `leader` in a low-fidelity episode, from the spawn to the last step but one."""
    flown = record(task, nominal, leader, key).flight
    spawn, _ = task.reset(jax.random.split(key)[0])
    pos = jnp.concatenate([spawn[None], flown.pos])
    vel = jnp.concatenate([jnp.zeros_like(spawn)[None], flown.vel])
    return ReferencePath(pos=pos[:-1], vel=vel[:-1], acc=jnp.diff(vel, axis=0) / CONTROL_DT)


class PathFollower(eqx.Module):
    """A controller whose drones each follow one path."""

    reference: ReferencePath
    """The paths of the team."""
    tracker: PDTracker
    """Makes the commands."""

    def __call__(self, state: TaskState) -> Float[Array, "drones 3"]:
        now = jax.tree.map(lambda x: x[state.step], self.reference)
        return self.tracker.action(state.flight, now.pos, now.vel, now.acc)[0]


class Followers(AbstractEpisodeController):
    """A controller that follows the paths which `leader` flies in the nominal simulator."""

    task: AbstractTask
    """What is flown."""
    nominal: AbstractSimulator
    """Where `leader` flies."""
    leader: Controller
    """Whose paths are followed."""

    def for_episode(self, key: PRNGKeyArray) -> PathFollower:
        spec, space = self.nominal.spec, self.nominal.action_space
        reference = team_reference(self.task, self.nominal, self.leader, key)
        return PathFollower(reference, PDTracker(mass=spec.mass, action_space=space))
