r"""PPO: model-free learning in the high-fidelity simulator, one policy for all drones.

    A_t    = sum_l (gamma lambda)^l delta_(t+l),   delta_t = (1 - gamma) r_t + gamma V_(t+1) - V_t
    ratio  = pi(a_t | o_t) / pi_old(a_t | o_t)
    loss   = -mean min(ratio A, clip(ratio, 1 - eps, 1 + eps) A) + c mean (V - A_old - V_old)^2

pi is a normal distribution around the policy's action, as wide for every observation; what leaves
[-1, 1] is clipped by the action, not by the density. Each drone's view is a sample: policy and
critic are shared, and the critic sees what the drone sees. Rewards are those that are reported,
with the exact penalty of contacts; (1 - gamma) keeps values of the size of one step's reward.
Episodes end by time, so that the last value stands for what would follow. Nothing is differentiated
through the simulator.

Why not rejax (0.1.3), which installs beside our JAX: an environment of it has one agent, so that a
team's drones could not share a policy within one flight, its networks are not those that are
deployed here, its loop runs in one call without progress, checkpoints or a bill by epoch, and it
brings twelve packages, one of them a nightly build.

Sources: Schulman et al. (2017), arXiv 1707.06347; advantages: Schulman et al. (2016), arXiv
1506.02438; one policy for a team: Yu et al. (2022), arXiv 2103.01955. The first
gives discount, lambda, clip, learning rate, passes and 32 minibatches for continuous control (its
minibatches have 64 of 2,048 steps). With 4 passes over 8 minibatches, a tenth of the updates, two
of five teams stay on the floor on spread (`results/paper`).
"""

import time
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from methods.contract import AbstractMethod, Setup, Trained
from methods.running.high_fidelity import trained_in_reality
from methods.training.bptt import Training
from methods.training.checkpoint import pack, unpack
from methods.training.meter import billed
from methods.training.policy import WIDTH, AbstractPolicy, make_policy
from simulators.contract import AbstractSimulator
from tasks.contract import AbstractTask, TaskState, check_above, check_at_least
from tasks.rollout import Episode, start

STAGE = "PPO in reality"
EXPLORED = 1_000_081
"""What is folded into an episode's key to draw what is explored: far from the small numbers by
which the start of an episode and its reality split the same key."""
RECENT = 10
"""Epochs over which training returns are averaged."""


class Learner(eqx.Module):
    """What is trained: the policy, how widely it explores, and the critic."""

    policy: AbstractPolicy
    """The mean of the actions; what is deployed."""
    log_std: Float[Array, " 3"]
    """Logarithm of their standard deviations."""
    critic: eqx.nn.MLP
    """Value of one drone's observation."""

    def density(
        self, obs: Float[Array, "rows obs"], raw: Float[Array, "rows 3"]
    ) -> Float[Array, " rows"]:
        """Logarithm of the density of actions before they are clipped."""
        z = (raw - self.policy(obs)) * jnp.exp(-self.log_std)
        return -jnp.sum(0.5 * z**2 + self.log_std + 0.5 * jnp.log(2.0 * jnp.pi), axis=-1)

    def values(self, obs: Float[Array, "rows obs"]) -> Float[Array, " rows"]:
        """What the critic expects, in rewards of one step."""
        return jax.vmap(self.critic)(obs)


class Steps(eqx.Module):
    """Flown steps, with axes of time, worlds and drones, or with one axis of samples."""

    obs: Float[Array, "*axes obs"]
    raw: Float[Array, "*axes 3"]
    """Actions before they were clipped."""
    density: Float[Array, "*axes"]
    """Logarithm of their density when they were drawn."""
    value: Float[Array, "*axes"]
    reward: Float[Array, "*axes"]
    """Reward; after `prepared` the advantage."""


class PPO(AbstractMethod):
    """Source: Schulman et al. (2017), arXiv 1707.06347; see the top of this module."""

    epochs: int = eqx.field(static=True, default=400)
    """Number of times that episodes are flown and learned from."""
    n_worlds: int = eqx.field(static=True, default=16)
    """Most episodes an epoch."""
    max_drones: int = eqx.field(static=True, default=96)
    """Most drones an epoch, all episodes together; large teams fly fewer episodes."""
    lr: float = eqx.field(static=True, default=3e-4)
    """Adam's learning rate at the start; it falls linearly to 0."""
    discount: float = eqx.field(static=True, default=0.99)
    """gamma."""
    trace: float = eqx.field(static=True, default=0.95)
    """lambda."""
    clip: float = eqx.field(static=True, default=0.2)
    """eps."""
    passes: int = eqx.field(static=True, default=10)
    """Times that an epoch's samples are learned from."""
    minibatches: int = eqx.field(static=True, default=32)
    """Parts into which the samples are dealt each time."""
    value_weight: float = eqx.field(static=True, default=0.5)
    """c."""
    std: float = eqx.field(static=True, default=0.3)
    """Standard deviation of the actions at the start [-]; a choice."""

    version: ClassVar[str] = "2"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "crazyflow"

    def __check_init__(self) -> None:
        check_at_least(self, 1, "epochs", "n_worlds", "max_drones", "passes", "minibatches")
        for name in ("discount", "trace"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise ValueError(f"`{name}` must lie in [0, 1), got {getattr(self, name)}.")
        check_above(self, 0, "lr", "clip", "value_weight", "std")

    def worlds(self, n_drones: int) -> int:
        """Episodes an epoch of a team."""
        return max(1, min(self.n_worlds, self.max_drones // n_drones))

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        policy_key, critic_key, key = jax.random.split(key, 3)
        task, reality = setup.task, setup.reality
        policy = init or make_policy(task, reality.spec, reality.action_space, policy_key)
        critic = eqx.nn.MLP(task.obs_size, "scalar", WIDTH, 2, activation=jnp.tanh, key=critic_key)
        learner = Learner(policy, jnp.full(3, jnp.log(self.std)), critic)
        with setup.context.in_turn():
            training = self._training(setup, learner, key)
        steps = training.epochs * self.worlds(task.n_drones) * task.horizon
        return trained_in_reality(training, steps)

    def _training(self, setup: Setup, learner: Learner, key: PRNGKeyArray) -> Training:
        """All epochs, from the last checkpoint on."""
        begin, task = time.perf_counter(), setup.task
        state = (learner, _OPTIMIZER.init(eqx.filter(learner, eqx.is_inexact_array)))
        history, before = [], 0.0
        place = setup.context.place(STAGE, repr(self), key, task, setup.reality, learner)
        if (kept := place.load()) is not None:
            state, history, before = unpack(state, kept)
        flown = self.worlds(task.n_drones) * task.horizon * task.n_drones
        reality = billed(setup.reality, len(history) * flown)  # by the process that was killed
        spent = lambda: before + time.perf_counter() - begin  # noqa: E731
        while len(history) < self.epochs:
            epoch = len(history)
            lr = jnp.asarray(self.lr * (1.0 - epoch / self.epochs))
            billed(setup.reality, flown)
            state, row = _epoch(self, task, reality, state, lr, jax.random.fold_in(key, epoch))
            history.append({name: float(x) for name, x in row.items()})
            if place.due():
                place.save(pack(state, history, spent()))
            setup.context.progress(STAGE, epoch + 1, self.epochs, history[-1]["reward"])
        place.save(pack(state, history, spent()))
        curves = {name: np.asarray([r[name] for r in history], np.float32) for name in history[0]}
        smooth = curves["smooth_reward"].astype(float)
        width = min(RECENT, len(smooth))
        averages = np.convolve(smooth, np.full(width, 1.0 / width), "valid")
        return Training(
            policy=state[0].policy,
            curves=curves,
            out_of_budget=False,
            best_reward=float(averages.max()),
            final_reward=float(averages[-1]),
            seconds=spent(),
        )


_OPTIMIZER = optax.chain(optax.clip_by_global_norm(0.5), optax.scale_by_adam(eps=1e-5))
State = tuple[Learner, Any]


@eqx.filter_jit
def _epoch(
    settings: PPO,
    task: AbstractTask,
    reality: AbstractSimulator,
    state: State,
    lr: Float[Array, ""],
    key: PRNGKeyArray,
) -> tuple[State, dict[str, Array]]:
    """State after one epoch, and its row, which describes the policy before."""
    fly_key, deal_key = jax.random.split(key)
    keys = jax.random.split(fly_key, settings.worlds(task.n_drones))
    steps, last, episodes = jax.vmap(
        lambda key: fly(task, reality, state[0], key), out_axes=(1, 0, 0)
    )(keys)
    samples = prepared(steps, last, settings)
    n_samples = len(samples.value)
    n_parts = min(settings.minibatches, n_samples)
    size = n_samples // n_parts
    deal = lambda key: jax.random.permutation(key, n_samples)[: size * n_parts]  # noqa: E731
    dealt = jax.vmap(deal)(jax.random.split(deal_key, settings.passes)).reshape(-1, size)
    live, fixed = eqx.partition(state, eqx.is_array)

    def learn(live: Any, chosen: Array) -> tuple[Any, Array]:
        learner, opt_state = eqx.combine(live, fixed)
        part = jax.tree.map(lambda x: x[chosen], samples)
        slopes = eqx.filter_grad(loss)(learner, part, settings)
        norm = optax.tree.norm(slopes)
        updates, opt_state = _OPTIMIZER.update(slopes, opt_state)
        learner = eqx.apply_updates(learner, jax.tree.map(lambda u: -lr * u, updates))
        new = eqx.filter((learner, opt_state), eqx.is_array)
        return jax.tree.map(lambda a, b: jnp.where(jnp.isfinite(norm), a, b), new, live), norm

    live, norm = jax.lax.scan(learn, live, dealt)
    state = eqx.combine(live, fixed)
    return state, {
        "reward": jnp.mean(episodes.reward),
        "smooth_reward": jnp.mean(episodes.smooth_reward) / task.n_drones,
        "crashes": jnp.sum(episodes.crashes),
        "contact_steps": jnp.sum(episodes.contact_steps),
        "grad_norm": jnp.mean(norm),
        "skipped": jnp.mean(~jnp.isfinite(norm)),
    }


def fly(
    task: AbstractTask, reality: AbstractSimulator, learner: Learner, key: PRNGKeyArray
) -> tuple[Steps, Float[Array, " drones"], Episode]:
    """One explored episode: its steps, the value of where it ends, and its sums."""
    state, goal = start(task, reality, key)
    std = jnp.exp(learner.log_std)

    def step(carry: tuple, row: tuple[Array, PRNGKeyArray]) -> tuple[tuple, Steps]:
        (state, touched, sums), (k, noise_key) = carry, row
        obs = task.observe(TaskState(reality.sensed(state), goal, k))
        raw = learner.policy(obs) + std * jax.random.normal(noise_key, (task.n_drones, 3))
        state = reality.step(state, jnp.clip(raw, -1.0, 1.0))
        after = TaskState(reality.flight(state), goal, k + 1)
        sums, touched, reward = sums.with_step(task, after, touched)
        made = Steps(obs, raw, learner.density(obs, raw), learner.values(obs), reward)
        return (state, touched, sums), made

    zero = jnp.zeros(())
    begin = (state, jnp.zeros(task.n_drones, bool), Episode(zero, zero, zero, zero))
    noise = jax.random.split(jax.random.fold_in(key, EXPLORED), task.horizon)
    (state, _, sums), steps = jax.lax.scan(step, begin, (jnp.arange(task.horizon), noise))
    obs = task.observe(TaskState(reality.sensed(state), goal, jnp.asarray(task.horizon)))
    return steps, learner.values(obs), sums


def prepared(steps: Steps, last: Float[Array, "worlds drones"], settings: PPO) -> Steps:
    """Steps as samples, their rewards replaced by advantages; `last` are the final values."""
    following = jnp.concatenate([steps.value[1:], last[None]])
    rewards = (1.0 - settings.discount) * steps.reward
    errors = rewards + settings.discount * following - steps.value

    def back(later: Array, error: Array) -> tuple[Array, Array]:
        advantage = error + settings.discount * settings.trace * later
        return advantage, advantage

    _, advantages = jax.lax.scan(back, jnp.zeros_like(last), errors, reverse=True)
    made = eqx.tree_at(lambda s: s.reward, steps, advantages)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), made)


def loss(learner: Learner, part: Steps, settings: PPO) -> Float[Array, ""]:
    """The clipped objective of a minibatch, and the critic's error."""
    advantage = (part.reward - jnp.mean(part.reward)) / (jnp.std(part.reward) + 1e-8)
    ratio = jnp.exp(learner.density(part.obs, part.raw) - part.density)
    limited = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    gain = jnp.mean(jnp.minimum(ratio * advantage, limited * advantage))
    error = learner.values(part.obs) - (part.reward + part.value)
    return settings.value_weight * jnp.mean(error**2) - gain
