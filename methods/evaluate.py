"""Deployment: what any controller is worth on a task in any simulator; trains nothing."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Key, PRNGKeyArray

from simulators.contract import AbstractSimulator
from simulators.vehicle import CONTROL_DT
from tasks.contact import onsets
from tasks.contract import AbstractTask
from tasks.rollout import AbstractEpisodeController, Controller, Record, record

EPISODES = 32
"""Episodes with independent initial states; paper, Sec. V."""
SETTLED = 5.0
"""The position error is that of the last so many seconds [s]."""


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Outcome over all episodes; the episodes are not replications, the seeds are."""

    rewards: Float[np.ndarray, " episodes"]
    """Return of each episode, exact collision penalty, mean over drones."""
    crashes: float
    """Onsets of contact per episode, summed over drones."""
    crash_step_rate: float
    """Share of steps with any drone in contact."""
    position_error: float
    """Median over the last 5 s, drones and episodes of the distance to the target [m]."""
    trajectory: dict[str, np.ndarray]
    """First episode: `t` [s] and `pos` (time, drones, 3) [m, world]."""

    @property
    def reward(self) -> float:
        """Mean return."""
        return float(self.rewards.mean())


def evaluation_keys(seed: int, n_episodes: int = EPISODES) -> Key[Array, " episodes"]:
    """The initial states of a seed, the same for every method and simulator."""
    return jax.random.split(jax.random.fold_in(jax.random.key(seed), 1_000_003), n_episodes)


def evaluate(
    task: AbstractTask,
    simulator: AbstractSimulator,
    controller: Controller | AbstractEpisodeController,
    seed: int,
    n_episodes: int = EPISODES,
) -> Evaluation:
    """Deploys `controller`, a pytree; one world after another, batched for speed only."""
    flown = fly(task, simulator, controller, evaluation_keys(seed, n_episodes))
    contact = np.asarray(flown.contact)
    settled = int(min(task.horizon, round(SETTLED / CONTROL_DT)))
    return Evaluation(
        rewards=np.asarray(flown.reward).sum(axis=1).mean(axis=1),
        crashes=float(np.asarray(onsets(flown.contact)).sum(axis=(1, 2)).mean()),
        crash_step_rate=float(contact.any(axis=2).mean()),
        position_error=float(np.median(np.asarray(flown.error)[:, -settled:])),
        trajectory={
            "t": np.asarray(flown.flight.t[0]),
            "pos": np.asarray(flown.flight.pos[0]),
        },
    )


@eqx.filter_jit
def fly(
    task: AbstractTask,
    simulator: AbstractSimulator,
    controller: Controller | AbstractEpisodeController,
    keys: Key[Array, " episodes"],
) -> Record:
    """Records of one episode a key, with a leading episode axis."""

    def one(key: PRNGKeyArray) -> Record:
        if isinstance(controller, AbstractEpisodeController):
            return record(task, simulator, controller.for_episode(key), key)
        return record(task, simulator, controller, key)

    return jax.vmap(one)(keys)
