r"""Back-propagation through time: the one trainer of every configuration.

Each epoch flies up to `n_worlds` full episodes with one policy, differentiates their mean return
per step through the simulator, and takes one Adam step (no critic, no advantage; paper, Sec. II-B).
The learning rate falls as a cosine to `final_lr` of its start. The gradient is decayed along the
carried state (`tasks/rollout.py`) and clipped by its global norm. An update whose gradient is not
finite is left out and counted.

The returned policy is the one of the epoch whose training return, averaged over the last
`smoothing` epochs, was best. With `patience`, training ends when that average has not improved
by `min_improvement` for as many epochs (noise alone makes small records for ever).
"""

import dataclasses
import functools
import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from methods.contract import Progress
from methods.policy import Policy, PolicyController
from simulators.contract import AbstractSimulator
from tasks.contract import AbstractTask
from tasks.rollout import Episode, episode

LARGEST_SKIPPED_SHARE = 0.1
"""Share of left-out updates above which a run counts as diverged."""


class BPTT(eqx.Module):
    """Settings of a training run; the defaults are those of low-fidelity training."""

    epochs: int = eqx.field(static=True, default=300)
    """Largest number of updates."""
    lr: float = eqx.field(static=True, default=3e-3)
    """Adam's learning rate at the start."""
    final_lr: float = eqx.field(static=True, default=0.02)
    """Learning rate at the end over that at the start."""
    n_worlds: int = eqx.field(static=True, default=16)
    """Most episodes per update."""
    max_drones: int = eqx.field(static=True, default=96)
    """Most drones per update, all episodes together; large teams fly fewer episodes."""
    decay: float = eqx.field(static=True, default=0.98)
    """Share of the gradient that each step passes back; 1 is the paper's plain BPTT."""
    clip: float = eqx.field(static=True, default=0.5)
    """Largest global norm of the gradient of the mean reward per step."""
    patience: int | None = eqx.field(static=True, default=None)
    """Epochs without improvement after which training ends early; None: never."""
    smoothing: int = eqx.field(static=True, default=10)
    """Epochs over which the training return is averaged before two are compared."""
    min_improvement: float = eqx.field(static=True, default=0.005)
    """Share of the best return by which it must improve for patience to start again."""

    def __check_init__(self) -> None:
        for name in ("epochs", "n_worlds", "max_drones", "smoothing"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be at least 1, got {getattr(self, name)}.")
        if not 0.0 < self.decay <= 1.0:
            raise ValueError(f"`decay` must lie in (0, 1], got {self.decay}.")

    def worlds(self, n_drones: int) -> int:
        """Episodes per update of a team: each drone's view is a sample for the shared policy."""
        return max(1, min(self.n_worlds, self.max_drones // n_drones))

    def train(
        self,
        task: AbstractTask,
        simulator: AbstractSimulator,
        policy: Policy,
        key: PRNGKeyArray,
        progress: Progress,
        stage: str,
    ) -> "Training":
        """The best policy found from `policy` on, with its history."""
        start = time.perf_counter()
        opt_state = _optimizer(self).init(eqx.filter(policy, eqx.is_inexact_array))
        history, best, best_policy = [], -np.inf, policy
        window = min(self.smoothing, self.epochs)
        milestone, milestone_epoch = -np.inf, window - 1
        for epoch in range(self.epochs):
            epoch_key = jax.random.fold_in(key, epoch)
            updated, opt_state, row = _epoch(self, task, simulator, policy, opt_state, epoch_key)
            history.append(jax.tree.map(float, row))
            recent = [r["smooth_reward"] for r in history[-window:]]
            if len(recent) == window and np.mean(recent) > best:
                best, best_policy = float(np.mean(recent)), policy
                if not best - milestone < self.min_improvement * abs(milestone):
                    milestone, milestone_epoch = best, epoch
            policy = updated
            progress(stage, epoch + 1, self.epochs, history[-1]["reward"])
            if self.patience is not None and epoch - milestone_epoch >= self.patience:
                break
        curves = {name: np.asarray([r[name] for r in history], np.float32) for name in history[0]}
        return Training(
            policy=best_policy,
            curves=curves,
            stopped_early=len(history) < self.epochs,
            best_reward=best,
            seconds=time.perf_counter() - start,
        )


@dataclasses.dataclass(frozen=True)
class Training:
    """The outcome of one BPTT run."""

    policy: Policy
    """The policy at the best epoch."""
    curves: dict[str, Float[np.ndarray, " epochs"]]
    """History, one entry an epoch."""
    stopped_early: bool
    """Whether patience ran out before the budget."""
    best_reward: float
    """Best smoothed training return."""
    seconds: float
    """Wall time [s]."""

    @property
    def epochs(self) -> int:
        """Updates made."""
        return len(self.curves["reward"])

    @property
    def crashes(self) -> int:
        """Onsets of contact in all training episodes."""
        return int(self.curves["crashes"].sum(dtype=float))

    @property
    def contact_steps(self) -> int:
        """Training steps with any drone in contact."""
        return int(self.curves["contact_steps"].sum(dtype=float))

    @property
    def skipped(self) -> int:
        """Updates left out because they were not finite."""
        return int(self.curves["skipped"].sum())

    @property
    def diverged(self) -> bool:
        """Whether many updates failed or the return ended twice as far from zero as its best."""
        last = self.curves["smooth_reward"][-10:].mean()
        if self.skipped > LARGEST_SKIPPED_SHARE * self.epochs or not np.isfinite(last):
            return True
        return bool(last < self.best_reward - abs(self.best_reward))


@functools.cache
def _optimizer(settings: BPTT) -> optax.GradientTransformation:
    schedule = optax.cosine_decay_schedule(settings.lr, settings.epochs, settings.final_lr)
    return optax.chain(optax.clip_by_global_norm(settings.clip), optax.adam(schedule))


@eqx.filter_jit
def _epoch(
    settings: BPTT,
    task: AbstractTask,
    simulator: AbstractSimulator,
    policy: Policy,
    opt_state: Any,
    key: PRNGKeyArray,
) -> tuple[Policy, Any, dict[str, Array]]:
    """One update; the history's row describes the policy before it."""
    n_worlds = settings.worlds(task.n_drones)

    def loss(policy: Policy) -> tuple[Array, Episode]:
        controller = PolicyController(task, policy)
        keys = jax.random.split(key, n_worlds)
        fly = lambda k: episode(task, simulator, controller, k, settings.decay)  # noqa: E731
        episodes = jax.vmap(fly)(keys)
        return -jnp.sum(episodes.smooth_reward), episodes

    (_, episodes), grads = eqx.filter_value_and_grad(loss, has_aux=True)(policy)
    grads = jax.tree.map(lambda g: g / (n_worlds * task.horizon * task.n_drones), grads)
    norm = optax.tree.norm(grads)
    finite = jnp.isfinite(norm)
    updates, new_state = _optimizer(settings).update(grads, opt_state)
    updated = eqx.apply_updates(policy, updates)
    keep = lambda new, old: jnp.where(finite, new, old) if eqx.is_array(new) else new  # noqa: E731
    row = {
        "reward": jnp.mean(episodes.reward),
        "smooth_reward": jnp.mean(episodes.smooth_reward) / task.n_drones,
        "crashes": jnp.sum(episodes.crashes),
        "contact_steps": jnp.sum(episodes.contact_steps),
        "grad_norm": norm,
        "skipped": ~finite,
    }
    return jax.tree.map(keep, updated, policy), jax.tree.map(keep, new_state, opt_state), row
