"""Returns of a team that stays at its spawn: the zero of the score, by task and team size.

Every drone stands where the episode put it, level and at rest, until the horizon; no simulator is
involved. The mean over the evaluation's initial states of `N_SEEDS` seeds is frozen in
`spawn_returns.toml` before methods are compared. `python -m bench.spawn` writes that file again
(minutes); a task whose version or settings change needs that.
"""

import json
import sys
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from bench.scores import FROZEN, NOT_IN_RETURN
from bench.settings import describe_fields
from methods.evaluate import evaluation_keys
from simulators import registry
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT
from tasks.contract import AbstractTask, TaskState

TASKS = ("spread", "circle", "figure8", "pitchandexpand")
"""Tasks in the file."""
TEAM_SIZES = range(2, 21)
"""Team sizes in the file."""
N_SEEDS = 32
"""Seeds whose evaluation episodes are averaged, 32 episodes each."""


def spawn_return(task: AbstractTask, n_seeds: int = N_SEEDS) -> float:
    """Mean return of a team that stays at its spawn."""
    keys = jnp.concatenate([evaluation_keys(seed) for seed in range(n_seeds)])
    return float(_mean_return(task, keys))


@eqx.filter_jit
def _mean_return(task: AbstractTask, keys: Key[Array, " episodes"]) -> Float[Array, ""]:
    def one(key: Key[Array, ""]) -> Float[Array, ""]:
        pos, goal = task.reset(jax.random.split(key)[0])  # as a rollout draws it

        def step(total: Float[Array, ""], k: Array) -> tuple[Float[Array, ""], None]:
            flight = _standing(pos, CONTROL_DT * (k + 1))
            reward, _ = task.rewards(TaskState(flight, goal, k + 1))
            return total + jnp.mean(reward), None

        return jax.lax.scan(step, jnp.zeros(()), jnp.arange(task.horizon))[0]

    return jnp.mean(jax.vmap(one)(keys))


def _standing(pos: Float[Array, "drones 3"], t: Float[Array, ""]) -> Flight:
    zero = jnp.zeros_like(pos)
    level = jnp.zeros((len(pos), 4)).at[:, 3].set(1.0)
    return Flight(t=t, pos=pos, vel=zero, quat=level, ang_vel=zero, thrust=zero[:, 0], torque=zero)


def write(path: Path) -> None:
    """Writes the frozen returns of all tasks and team sizes to `path`."""
    lines = ["# Returns of a team that stays at its spawn (see spawn.py, which writes this file)."]
    for name in TASKS:
        cls: Any = registry.load("task", name)
        fields = describe_fields(cls(n_drones=2), f"Task '{name}'")
        lines += ["", f"[{name}]", f'version = "{cls.version}"', "", f"[{name}.settings]"]
        lines += [f"{k} = {json.dumps(v)}" for k, v in fields.items() if k not in NOT_IN_RETURN]
        lines += ["", f"[{name}.returns]"]
        for n_drones in TEAM_SIZES:
            lines.append(f"{n_drones} = {spawn_return(cls(n_drones=n_drones)):.4f}")
            print(name, lines[-1], file=sys.stderr)  # noqa: T201
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write(FROZEN)
