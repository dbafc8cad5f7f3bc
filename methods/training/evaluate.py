"""Deployment: what any controller is worth on a task in any simulator; trains nothing.

Every policy for a task and team size meets the same initial states, whatever its seed and method:
scatter over seeds is training's alone. Trainings from `TUNING_SEEDS` on meet others, so that what
is tuned never sees what is counted.

The first fifth of an episode, 2 s of 10, is taken apart: there most of the return is the way from
the floor to where the task begins, nearly the same for everybody.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PRNGKeyArray

from simulators.contract import AbstractSimulator
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT
from tasks.contact import onsets
from tasks.contract import AbstractTask, TaskState
from tasks.rollout import AbstractEpisodeController, Controller, Record, record

EPISODES = 64
"""Episodes with independent initial states; the paper has 32 (Sec. V)."""
TUNING_SEEDS = 1000
"""Seeds from this one on are for tuning."""
TAKEOFF_SHARE = 0.2
"""Share of an episode that counts as take-off: 2 s of 10."""
SETTLED_BAND = 0.1
"""Distance to the target, mean over drones, within which a team is settled [m]; a choice."""
ERROR_SECONDS = 5.0
"""The position error is that of the last so many seconds [s]."""


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Outcome over all episodes; the episodes are not replications, the seeds are."""

    rewards: Float[np.ndarray, " episodes"]
    """Return of each episode, exact collision penalty, mean over drones."""
    takeoff_rewards: Float[np.ndarray, " episodes"]
    """The part of it that falls in the take-off."""
    worst_decile: float
    """Mean return after the take-off of the worst tenth of all drones of all episodes."""
    settling_time: float
    """Time after which the team stays within `SETTLED_BAND`, mean over episodes; the whole episode
    where it does not [s]."""
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

    @property
    def takeoff_reward(self) -> float:
        """Mean return of the take-off."""
        return float(self.takeoff_rewards.mean())

    @property
    def settled_reward(self) -> float:
        """Mean return of the rest of the episode."""
        return float((self.rewards - self.takeoff_rewards).mean())


def evaluation_keys(seed: int = 0, n_episodes: int = EPISODES) -> Key[Array, " episodes"]:
    """Keys of the initial states: one set for all seeds that count, another for tuning."""
    tuning = int(seed >= TUNING_SEEDS)
    return jax.random.split(jax.random.fold_in(jax.random.key(tuning), 1_000_003), n_episodes)


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
    rewards, error = np.asarray(flown.reward, float).mean(axis=2), np.asarray(flown.error)
    last = int(min(task.horizon, round(ERROR_SECONDS / CONTROL_DT)))
    settled = np.asarray(flown.reward, float)[:, takeoff_steps(task) :].sum(axis=1)
    return Evaluation(
        rewards=rewards.sum(axis=1),
        takeoff_rewards=rewards[:, : takeoff_steps(task)].sum(axis=1),
        worst_decile=worst_tenth(settled),
        settling_time=float(settling_times(error.mean(axis=2)).mean()),
        crashes=float(np.asarray(onsets(flown.contact)).sum(axis=(1, 2)).mean()),
        crash_step_rate=float(contact.any(axis=2).mean()),
        position_error=float(np.median(error[:, -last:])),
        trajectory={
            "t": np.asarray(flown.flight.t[0]),
            "pos": np.asarray(flown.flight.pos[0]),
        },
    )


def worst_tenth(returns: Float[np.ndarray, "episodes drones"]) -> float:
    """Mean of the lowest tenth of all, at least of one; NaN if one is."""
    if np.isnan(returns).any():
        return float("nan")
    lowest = np.sort(returns, axis=None)
    return float(lowest[: max(1, round(0.1 * lowest.size))].mean())


def takeoff_steps(task: AbstractTask) -> int:
    """Control steps that count as take-off."""
    return round(TAKEOFF_SHARE * task.horizon)


def settling_times(error: Float[np.ndarray, "episodes time"]) -> Float[np.ndarray, " episodes"]:
    """Time of the last step at which the error is above `SETTLED_BAND` or NaN [s]; 0 without."""
    steps = np.arange(1, error.shape[1] + 1)
    return CONTROL_DT * np.where(error <= SETTLED_BAND, 0, steps).max(axis=1)


def standing_rewards(
    task: AbstractTask, seed: int, n_episodes: int = EPISODES
) -> Float[np.ndarray, "episodes time"]:
    """Rewards of a team that stays at its spawn, mean over drones: the zero of every score.

    Every drone stands where the episode put it, level and at rest; no simulator is involved.
    """
    return np.asarray(_standing(task, evaluation_keys(seed, n_episodes)), float)


@eqx.filter_jit
def _standing(task: AbstractTask, keys: Key[Array, " episodes"]) -> Float[Array, "episodes time"]:
    def one(key: PRNGKeyArray) -> Float[Array, " time"]:
        pos, goal = task.reset(jax.random.split(key)[0])  # as a rollout draws it
        zero = jnp.zeros_like(pos)
        level = jnp.zeros((len(pos), 4)).at[:, 3].set(1.0)
        still = {"vel": zero, "quat": level, "ang_vel": zero, "torque": zero}

        def step(k: Array) -> Float[Array, ""]:
            t = CONTROL_DT * (k + 1)
            flight = Flight(t=t, pos=pos, thrust=zero[:, 0], **still)
            return jnp.mean(task.rewards(TaskState(flight, goal, k + 1))[0])

        return jax.lax.map(step, jnp.arange(task.horizon))

    return jax.vmap(one)(keys)


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
