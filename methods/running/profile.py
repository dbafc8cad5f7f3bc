"""Where an epoch of back-propagation goes, and how far it is from the machine's matrix rate.

Parts are differences between programs that do more and more of an epoch: fly a constant action
(physics), observe and reward as well (task), act by the policy (policy), and differentiate and
update (backward). Each is the shortest of several calls.

The limit is what matrix products need: six operations for each weight of the policy, drone and step
(two forward, four backward) and two for each weight of a frozen residual, at the rate that the
policy's products, one after another and nothing else, reach in this process. Products that a
program repeats do not count.
"""

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.residuals.contract import blank
from methods.residuals.mlp import MLPEnsemble
from methods.training.bptt import BPTT, Training, optimizer, update
from methods.training.policy import Policy, PolicyController, make_policy
from simulators.contract import AbstractSimulator
from simulators.effects.contract import FrozenEffect
from tasks.contract import AbstractTask, TaskState
from tasks.rollout import episode
from tasks.rollout import start as begin

ROUNDS = 7
"""Number of timed calls; the shortest counts."""
_KEY = jax.random.key(0)


class NoTrainerError(ValueError):
    """A method that does not train by `BPTT` cannot be profiled."""


@dataclasses.dataclass(frozen=True)
class Profile:
    """One epoch of a method on a task."""

    n_drones: int
    """Team size."""
    n_worlds: int
    """Episodes of an epoch."""
    seconds: Mapping[str, float]
    """Time of `epoch` and of its parts `physics`, `task`, `policy` and `backward` [s]."""
    compile_seconds: float
    """Tracing and compiling an epoch [s]."""
    memory: float
    """Memory beside the policy's, per drone and episode [byte]."""
    flops: float
    """Operations that the matrix products of policy and frozen residual need."""
    rate: float
    """Attainable rate of those products [1/s]."""

    @property
    def share(self) -> float:
        """Time that the products need at the attainable rate, over the epoch's."""
        return self.flops / self.rate / self.seconds["epoch"]

    @property
    def ratio(self) -> float:
        """Time of an epoch over that of its forward part."""
        forward = sum(self.seconds[part] for part in ("physics", "task", "policy"))
        return self.seconds["epoch"] / forward


class _FoundError(Exception):
    """Carries the simulator in which a method would train."""


class _Finder(BPTT):
    """Stops a method where its training would begin."""

    def train(self, task: Any, simulator: Any, *args: Any, **kwargs: Any) -> Training:
        raise _FoundError(simulator)


def trained_in(method: AbstractMethod, setup: Setup) -> AbstractSimulator:
    """The simulator in which `method` would train; calibration and fit before it are done.

    Raises:
        NoTrainerError: It never calls a `BPTT` trainer of its own.
    """
    trainer = getattr(method, "trainer", None)
    if not isinstance(trainer, BPTT):
        raise NoTrainerError(f"Method {type(method).__name__} has no `trainer` that is a BPTT.")
    settings = {f.name: getattr(trainer, f.name) for f in dataclasses.fields(trainer)}
    finder = eqx.tree_at(
        lambda m: m.trainer, method, _Finder(**settings), is_leaf=lambda x: x is trainer
    )
    policy = make_policy(setup.task, setup.nominal.spec, setup.nominal.action_space, _KEY)
    parents = untrained_parents(type(method), [policy] * len(method.parents))
    try:
        finder.train(dataclasses.replace(setup, parents=parents), _KEY)
    except _FoundError as found:
        return found.args[0]
    raise NoTrainerError(f"Method {type(method).__name__} does not train by its `trainer`.")


def untrained_parents(
    method: type[AbstractMethod], policies: Iterable[Policy]
) -> dict[str, Trained]:
    """What a method can be called with in the place of its trained parents.

    Their policies are given; whose residual it starts from has one of zeros.
    """
    return {
        name: Trained(
            policy,
            Ledger(),
            {},
            residual=blank(MLPEnsemble()) if name in method.resumes_from else None,
        )
        for name, policy in zip(method.parents, policies, strict=True)
    }


def profile(task: AbstractTask, simulator: AbstractSimulator, trainer: BPTT) -> Profile:
    """The parts of one epoch of `trainer`."""
    policy = make_policy(task, simulator.spec, simulator.action_space, _KEY)
    state = optimizer(trainer.clip).init(eqx.filter(policy, eqx.is_inexact_array))
    n_worlds, n_drones = trainer.worlds(task.n_drones), task.n_drones
    rates = (trainer.learning_rate(0), _KEY)
    given = (trainer.rule(n_drones), task, simulator, policy, state, *rates)
    kept = trainer.room(policy, task)
    compile_seconds, memory = _compiled(given, kept)
    whole = {name: shortest(call) for name, call in _programs(trainer, given, kept).items()}
    rows = n_worlds * n_drones
    flops, rate = attainable(policy, rows, task.horizon)
    flops += 2.0 * rows * task.horizon * frozen_weights(simulator)
    return Profile(
        n_drones=n_drones,
        n_worlds=n_worlds,
        seconds={
            "epoch": whole["epoch"],
            "physics": whole["physics"],
            "task": max(whole["task"] - whole["physics"], 0.0),
            "policy": max(whole["policy"] - whole["task"], 0.0),
            "backward": max(whole["epoch"] - whole["policy"], 0.0),
        },
        compile_seconds=compile_seconds,
        memory=memory / rows,
        flops=flops,
        rate=rate,
    )


def _compiled(given: tuple, kept: Sequence[Array] | None) -> tuple[float, int]:
    """Time of tracing and compiling an epoch [s], and its memory beside the policy's [byte]."""
    start = time.perf_counter()
    lowered = update.lower(given, kept)  # pyright: ignore[reportFunctionMemberAccess]
    compiled = lowered.compile()
    seconds = time.perf_counter() - start
    memory = compiled.compiled.memory_analysis().temp_size_in_bytes
    return seconds, memory + sum(x.nbytes for x in kept or ())


def _programs(
    trainer: BPTT, given: tuple, kept: Sequence[Array] | None
) -> dict[str, Callable[[], Any]]:
    """Calls that do more and more of an epoch, the last one all of it."""
    _, task, simulator, policy, *_ = given
    keys = jax.random.split(_KEY, trainer.worlds(task.n_drones))
    hover = jnp.zeros((task.n_drones, 3))
    hover = hover.at[:, 2].set(simulator.action_space.hover(simulator.spec.mass))

    def still(state: TaskState) -> Float[Array, "drones 3"]:
        # An observation that is not used would not be computed.
        return hover + 1e-9 * jnp.sum(task.observe(state), axis=-1, keepdims=True)

    def physics(key: Array) -> Any:
        first, _ = begin(task, simulator, key)
        # Under one and the same action, what does not depend on position is flown only once.
        own = hover + 1e-3 * jax.random.normal(key, hover.shape)
        return jax.lax.fori_loop(0, task.horizon, lambda _, s: simulator.step(s, own), first)

    def forward(policy: Policy, key: Array) -> Any:
        controller = PolicyController(task, policy)
        return episode(task, simulator, controller, key, trainer.decay, trainer.limit)

    def epoch() -> Any:
        nonlocal kept
        *found, kept = update(given, kept)
        return found

    fly = eqx.filter_jit(jax.vmap(physics))
    idle = eqx.filter_jit(jax.vmap(lambda key: episode(task, simulator, still, key)))
    act = eqx.filter_jit(lambda policy: jax.vmap(lambda key: forward(policy, key))(keys))
    return {
        "physics": lambda: fly(keys),
        "task": lambda: idle(keys),
        "policy": lambda: act(policy),
        "epoch": epoch,
    }


def attainable(policy: Policy, rows: int, steps: int) -> tuple[float, float]:
    """Operations of an epoch's products, and the rate [1/s] that they alone reach.

    `rows` is the number of drones in all worlds, `steps` that of an episode.
    """
    weights = [layer.weight for layer in policy.net.layers]

    def once(_: Array, carry: tuple[Array, list[Array]]) -> tuple[Array, list[Array]]:
        x, slopes = carry
        inputs = [x]
        for weight in weights:
            inputs.append(inputs[-1] @ weight.T)
        back, new = inputs.pop(), []
        for weight, given, slope in zip(
            reversed(weights), reversed(inputs), reversed(slopes), strict=True
        ):
            new.append(0.1 * slope + back.T @ given)
            back = back @ weight
        return 1e-3 * back, new[::-1]

    start = jnp.ones((rows, weights[0].shape[1])), [jnp.zeros_like(w) for w in weights]
    chain = jax.jit(lambda start: jax.lax.fori_loop(0, steps, once, start))
    flops = 6.0 * rows * steps * sum(weight.size for weight in weights)
    return flops, flops / shortest(lambda: chain(start))


def frozen_weights(simulator: AbstractSimulator) -> int:
    """Weights of matrices in effects that nobody differentiates, those of what it varies, too."""
    is_frozen = lambda x: isinstance(x, FrozenEffect)  # noqa: E731
    frozen = [x for x in jax.tree.leaves(simulator, is_leaf=is_frozen) if is_frozen(x)]
    return sum(x.size for x in jax.tree.leaves(frozen) if eqx.is_inexact_array(x) and x.ndim > 1)


def shortest(call: Callable[[], Any]) -> float:
    """Time of the shortest of `ROUNDS` calls after the first one [s]."""
    jax.block_until_ready(eqx.filter(call(), eqx.is_array))
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        jax.block_until_ready(eqx.filter(call(), eqx.is_array))
        times.append(time.perf_counter() - start)
    return min(times)
