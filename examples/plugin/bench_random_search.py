r"""Augmented random search on the shared policy, in the nominal point mass.

Source: Mania, Guy and Recht (2018), arXiv:1803.07055, algorithm 2 (V1-t). With weights w, each
update flies `directions` random directions d_i forwards and backwards and climbs the `top` best,

    r_i+, r_i- = returns of w + nu d_i and w - nu d_i,     d_i ~ N(0, I)
    w         <- w + alpha / (top sigma) sum_i (r_i+ - r_i-) d_i

| symbol | name        | meaning                                                         |
|--------|-------------|-----------------------------------------------------------------|
| alpha  | `step_size` | size of an update [weight]                                      |
| nu     | `noise`     | size of a perturbation [weight]                                 |
| sigma  |             | standard deviation of the 2 `top` returns that enter the update |

It climbs the exact return, because it needs no gradient. Departures from the source: the policy
is the benchmark's network instead of linear; all flights of an update share their initial states.
"""

import time
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PRNGKeyArray

from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.training.policy import Policy, PolicyController, make_policy
from simulators.contract import AbstractSimulator
from tasks.contract import AbstractTask
from tasks.rollout import Episode, episode

SMOOTHING = 10
"""Updates over which returns are averaged before two policies are compared."""


class RandomSearch(AbstractMethod):
    """Gradient-free, deployed as it is. Source: Mania et al. (2018), arXiv:1803.07055."""

    iterations: int = eqx.field(static=True, default=300)
    """Updates."""
    directions: int = eqx.field(static=True, default=16)
    """Random directions per update, each flown both ways."""
    top: int = eqx.field(static=True, default=8)
    """How many of them enter the update."""
    step_size: float = eqx.field(static=True, default=0.02)
    """Size of an update [weight]; best of five trials on circle, seed 1000."""
    noise: float = eqx.field(static=True, default=0.02)
    """Size of a perturbation [weight]; from the same trials."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "point_mass"

    def __check_init__(self) -> None:
        for name in ("iterations", "top", "step_size", "noise"):
            if getattr(self, name) <= 0:
                raise ValueError(f"`{name}` must be above 0, got {getattr(self, name)}.")
        if self.directions < self.top:
            raise ValueError(f"`directions` must be at least {self.top}, got {self.directions}.")

    def train(self, setup: Setup, key: PRNGKeyArray, init: Policy | None = None) -> Trained:
        """The policy with the best return, averaged over `SMOOTHING` updates."""
        start = time.perf_counter()
        policy_key, search_key = jax.random.split(key)
        nominal = setup.nominal
        policy = init or make_policy(setup.task, nominal.spec, nominal.action_space, policy_key)
        history, best, best_policy = [], -np.inf, policy
        for k in range(self.iterations):
            update_key = jax.random.fold_in(search_key, k)
            updated, row = _update(self, setup.task, nominal, policy, update_key)
            history.append(jax.tree.map(float, row))
            recent = np.mean([r["reward"] for r in history[-SMOOTHING:]])
            if len(history) >= min(SMOOTHING, self.iterations) and recent > best:
                best, best_policy = recent, policy
            policy = updated
            setup.context.progress("random search", k + 1, self.iterations, history[-1]["reward"])
        curves = {name: np.asarray([r[name] for r in history], np.float32) for name in history[0]}
        skipped = int(curves["skipped"].sum())
        ledger = Ledger(
            lf_collisions=int(curves["crashes"].sum(dtype=float)),
            epochs=self.iterations,
            skipped_updates=skipped,
            train_seconds=time.perf_counter() - start,
        )
        status = "ok" if skipped < self.iterations else "diverged"
        return Trained(policy=best_policy, ledger=ledger, curves=curves, status=status)


@eqx.filter_jit
def _update(
    settings: RandomSearch,
    task: AbstractTask,
    simulator: AbstractSimulator,
    policy: Policy,
    key: PRNGKeyArray,
) -> tuple[Policy, dict[str, Float[Array, ""]]]:
    """The policy after one update, and the history's row on the one before."""
    params, static = eqx.partition(policy, eqx.is_inexact_array)
    w, unravel = ravel_pytree(params)
    direction_key, start_key = jax.random.split(key)

    def fly(w: Float[Array, " params"]) -> Episode:
        controller = PolicyController(task, eqx.combine(unravel(w), static))
        return episode(task, simulator, controller, start_key)

    d = jax.random.normal(direction_key, (settings.directions, w.size))
    steps = jnp.concatenate([jnp.zeros_like(d[:1]), settings.noise * d, -settings.noise * d])
    flown = jax.vmap(fly)(w + steps)
    forward, backward = flown.reward[1:].reshape(2, -1)
    _, best = jax.lax.top_k(jnp.maximum(forward, backward), settings.top)
    forward, backward = forward[best], backward[best]
    sigma = jnp.std(jnp.concatenate([forward, backward]))
    updated = w + settings.step_size / (settings.top * sigma) * (forward - backward) @ d[best]
    finite = jnp.all(jnp.isfinite(updated))
    row = {"reward": flown.reward[0], "smooth_reward": flown.smooth_reward[0] / task.n_drones}
    row |= {"crashes": jnp.sum(flown.crashes), "skipped": ~finite}
    return eqx.combine(unravel(jnp.where(finite, updated, w)), static), row
