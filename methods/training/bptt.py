r"""Back-propagation through time: the one trainer of every configuration.

Each epoch flies up to `n_worlds` full episodes with one policy, differentiates their mean return
per step through the simulator, and takes one Adam step (no critic, no advantage; paper, Sec. II-B).
The learning rate falls as a cosine to `final_lr` of its start. The gradient is decayed along the
carried state (`tasks/rollout.py`) and clipped by its global norm. An update whose gradient is not
finite is left out and counted.

A training ends when its budget of epochs is spent, at the end of the cosine, and returns its last
policy: a training return of one world is too noisy to choose an epoch by (in one world the standard
error of a mean over 20 epochs is 2 to 12 % on three of the four tasks). With `patience`, as in the
paper, training ends when the return, averaged over `smoothing` epochs, has not improved by
`min_improvement` for as many epochs, and the policy at the best average is returned.

With a keeper (`methods/training/checkpoint.py`) a training that was killed goes on from its last
saved epoch, and equals one that was not. Its bill is that of its epochs, each counted once.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from methods.training.adjoint import buffers, gradient
from methods.training.checkpoint import pack, unpack
from methods.training.context import Context
from methods.training.meter import billed
from methods.training.policy import AbstractPolicy, is_written_out
from methods.training.together import Team
from simulators.contract import AbstractSimulator
from tasks.contract import AbstractTask, check_above, check_at_least


@dataclasses.dataclass(frozen=True)
class Rule:
    """The settings that enter the compiled program; trainings with equal rules share a program."""

    n_worlds: int
    """Episodes per update."""
    decay: float
    """Share of the gradient that each step passes back."""
    clip: float
    """Largest global norm of the gradient."""
    limit: float | None
    """Largest number that a step passes back; None: as `passed_back` says."""


LARGEST_SKIPPED_SHARE = 0.1
"""Share of left-out updates above which a run counts as diverged."""


class BPTT(eqx.Module):
    """Settings of a training run; the defaults are those of low-fidelity training."""

    epochs: int = eqx.field(static=True, default=400)
    """Number of updates; with `patience`, the most."""
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
    """Epochs over which the training return is averaged."""
    min_improvement: float = eqx.field(static=True, default=0.005)
    """Share of the best return by which it must improve for patience to start again."""
    share: float = eqx.field(static=True, default=1.0, metadata={"neutral": True})
    """Share of the epochs that are flown: a checkpoint along the whole training, rates and all."""
    limit: float | None = eqx.field(static=True, default=None, metadata={"neutral": True})
    """Largest derivative of a drone's return by a number of the state that a step passes back;
    None: 500 with a `decay` below 1, none with 1."""

    def __check_init__(self) -> None:
        check_at_least(self, 1, "epochs", "n_worlds", "max_drones", "smoothing")
        check_at_least(self, 0, "lr", "final_lr")
        check_above(self, 0, "clip")
        if self.patience is not None and self.patience < 1:
            raise ValueError(f"`patience` must be at least 1 or None, got {self.patience}.")
        if not 0.0 < self.share <= 1.0:
            raise ValueError(f"`share` must lie in (0, 1], got {self.share}.")
        if not 0.0 < self.decay <= 1.0:
            raise ValueError(f"`decay` must lie in (0, 1], got {self.decay}.")
        if self.limit is not None and not self.limit > 0.0:
            raise ValueError(f"`limit` must be above 0 or None, got {self.limit}.")

    def worlds(self, n_drones: int) -> int:
        """Episodes per update of a team: each drone's view is a sample for the shared policy."""
        return max(1, min(self.n_worlds, self.max_drones // n_drones))

    @property
    def last_epoch(self) -> int:
        """Number of updates after which a training ends at the latest."""
        return max(1, round(self.share * self.epochs))

    def rule(self, n_drones: int) -> Rule:
        """The settings that the compiled epochs of a team depend on."""
        return Rule(self.worlds(n_drones), self.decay, self.clip, self.limit)

    def learning_rate(self, epoch: int) -> Float[Array, ""]:
        """Learning rate of an epoch."""
        return _schedule(self.lr, self.epochs, self.final_lr)(epoch)

    def room(self, policy: AbstractPolicy, task: AbstractTask, n_trainings: int = 0) -> Any:
        """Buffers for the policy's layers (`methods/training/adjoint.py`), or None.

        Who trains in one world at a time, trains in an expensive simulator: there its steps cost,
        not products, and memory is to stay small.
        """
        if self.n_worlds == 1 or not is_written_out(policy):
            return None
        return buffers(policy, task, self.worlds(task.n_drones), n_trainings)

    def train(
        self,
        task: AbstractTask,
        simulator: AbstractSimulator,
        policy: AbstractPolicy,
        key: PRNGKeyArray,
        context: Context,
        stage: str,
    ) -> "Training":
        """The policy trained from `policy` on, with its history.

        `stage` names the training in reports and checkpoints: one name per training of a run.
        """
        start = time.perf_counter()
        place = context.place(stage, repr(self), key, task, simulator, policy)
        course, others = _Course(self, policy), 0.0
        if (kept := place.load()) is not None:
            course.restore(kept)
        rule = self.rule(task.n_drones)
        flown = rule.n_worlds * task.horizon * task.n_drones
        billed(simulator, len(course.history) * flown)  # by the process that was killed
        step = _step(context.team, functools.partial(self.room, policy, task))
        spent = lambda: course.seconds + time.perf_counter() - start - others  # noqa: E731
        while not course.over():
            epoch = len(course.history)
            epoch_key = jax.random.fold_in(key, epoch)
            rates = (self.learning_rate(epoch), epoch_key)
            given = (rule, task, billed(simulator, flown), course.policy, course.opt_state, *rates)
            (updated, opt_state, row), waited = step(given)
            others += waited
            course.add(updated, opt_state, {name: float(x) for name, x in row.items()})
            if place.due():
                place.save(course.arrays(spent()))
            context.progress(stage, epoch + 1, self.last_epoch, course.history[-1]["reward"])
        place.save(course.arrays(spent()))
        history = course.history
        curves = {name: np.asarray([r[name] for r in history], np.float32) for name in history[0]}
        return Training(
            policy=course.policy if self.patience is None else course.best_policy,
            curves=curves,
            out_of_budget=self.patience is not None and not course.patience_ran_out(),
            best_reward=course.best,
            final_reward=course.recent,
            seconds=spent(),
        )


def _step(team: Team | None, room: Callable[[int], Any]) -> Callable[[tuple], tuple[tuple, float]]:
    """One epoch, alone or in a program with a team's, and how long it waited for others [s]."""
    if team is not None:
        return lambda given: team.call(_update, given, room)
    kept = room(0)

    def step(given: tuple) -> tuple[tuple, float]:
        nonlocal kept
        *results, kept = update(given, kept)
        return tuple(results), 0.0

    return step


class _Course:
    """The state of a training: everything but its key that the next epochs depend on."""

    def __init__(self, settings: BPTT, policy: AbstractPolicy) -> None:
        self.settings = settings
        self.policy = policy
        self.opt_state = optimizer(settings.clip).init(eqx.filter(policy, eqx.is_inexact_array))
        self.history: list[dict[str, float]] = []
        self.best = -np.inf
        self.best_policy = policy
        self.seconds = 0.0
        """Wall time of processes that were killed, up to what was restored [s]."""
        self._window = min(settings.smoothing, settings.last_epoch)
        self._milestone = -np.inf
        self._milestone_epoch = self._window - 1

    @property
    def recent(self) -> float:
        """Training return, averaged over the last `smoothing` epochs."""
        return float(np.mean([row["smooth_reward"] for row in self.history[-self._window :]]))

    def over(self) -> bool:
        """Whether the budget is spent or patience has run out."""
        return self.patience_ran_out() or len(self.history) >= self.settings.last_epoch

    def patience_ran_out(self) -> bool:
        """Whether the return has not improved for as many epochs as patience allows."""
        patience = self.settings.patience
        return patience is not None and len(self.history) - 1 - self._milestone_epoch >= patience

    def add(self, updated: AbstractPolicy, opt_state: Any, row: dict[str, float]) -> None:
        """One more epoch; its row describes the policy before the update."""
        self.history.append(row)
        if len(self.history) >= self._window and self.recent > self.best:
            self.best, self.best_policy = self.recent, self.policy
            enough = self.settings.min_improvement * abs(self._milestone)
            if not self.best - self._milestone < enough:
                self._milestone, self._milestone_epoch = self.best, len(self.history) - 1
        self.policy, self.opt_state = updated, opt_state

    def arrays(self, seconds: float) -> dict[str, np.ndarray]:
        """Everything as arrays, by name; it took `seconds` of wall time until now."""
        trees = (self.policy, self.opt_state, self.best_policy)
        patience = np.asarray([self.best, self._milestone, self._milestone_epoch], float)
        return pack(trees, self.history, seconds) | {"patience": patience}

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the state that `arrays` hold, which must be of the same training."""
        trees = (self.policy, self.opt_state, self.best_policy)
        trees, self.history, self.seconds = unpack(trees, arrays)
        self.policy, self.opt_state, self.best_policy = trees
        self.best, self._milestone = arrays["patience"][:2].tolist()
        self._milestone_epoch = int(arrays["patience"][2])


@dataclasses.dataclass(frozen=True)
class Training:
    """The outcome of one BPTT run."""

    policy: AbstractPolicy
    """The last policy; with patience, that at the best average."""
    curves: dict[str, Float[np.ndarray, " epochs"]]
    """History, one entry an epoch."""
    out_of_budget: bool
    """Whether the budget ended a training that patience was meant to end."""
    best_reward: float
    """Best training return, averaged over `smoothing` epochs."""
    final_reward: float
    """That average at the end."""
    seconds: float
    """Wall time, including that before a kill [s]; its share where epochs are flown together."""

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
        """Whether many updates failed, no return was finite, or the last fell far behind the best.

        Far: the mean of the last ten epochs is twice as far from zero as the best.
        """
        last = self.curves["smooth_reward"][-10:].mean()
        if not np.isfinite([self.best_reward, last]).all():
            return True
        if self.skipped > LARGEST_SKIPPED_SHARE * self.epochs:
            return True
        return bool(last < self.best_reward - abs(self.best_reward))


@functools.cache
def optimizer(clip: float) -> optax.GradientTransformation:
    """Adam at a learning rate of -1, behind a clip of the gradient's global norm."""
    return optax.chain(optax.clip_by_global_norm(clip), optax.scale_by_adam())


@functools.cache
def _schedule(lr: float, epochs: int, final_lr: float) -> Callable[[int], Array]:
    """The cosine as a program of its own, so that the program of an epoch is given a number."""
    return jax.jit(optax.cosine_decay_schedule(lr, epochs, final_lr))


def _update(
    given: tuple[Rule, AbstractTask, AbstractSimulator, AbstractPolicy, Any, Array, PRNGKeyArray],
    kept: Any,
) -> tuple[AbstractPolicy, Any, dict[str, Array], Any]:
    """Policy and optimiser state after one epoch, its row, and the buffers of `kept`.

    The history's row describes the policy before the update. `kept` comes from `BPTT.room` and
    may not be used again.
    """
    rule, task, simulator, policy, opt_state, lr, key = given
    keys = jax.random.split(key, rule.n_worlds)
    episodes, grads, kept = gradient(task, simulator, policy, keys, rule.decay, kept, rule.limit)
    grads = jax.tree.map(lambda g: g / (rule.n_worlds * task.horizon * task.n_drones), grads)
    norm = optax.tree.norm(grads)
    finite = jnp.isfinite(norm)
    steps, new_state = optimizer(rule.clip).update(grads, opt_state)
    updates = jax.tree.map(lambda step: (-lr * step).astype(step.dtype), steps)
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
    policy, opt_state = (
        jax.tree.map(keep, new, old) for new, old in ((updated, policy), (new_state, opt_state))
    )
    return policy, opt_state, row, kept


update = eqx.filter_jit(_update, donate="all-except-first")
"""`_update`, compiled."""
