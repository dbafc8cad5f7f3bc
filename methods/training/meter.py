"""High-fidelity flight, counted by the simulator that is flown and not by the method that flies it.

The harness hands out `setup.reality` as a `Metered` simulator. Whoever steps it is billed for the
step: by hand, in a loop, under `jit`, `vmap`, `scan` or `grad`. The count is a call from the
running program back into Python, one a control step of a batch, which costs some 50 us.

Code of ours that knows beforehand how much a program flies (the trainer, the calibration flights)
saves that cost: `billed` adds the flight to the meter and gives the simulator without it. The
compiled program is then the one of an unmetered simulator, and seeds that train together share it.
"""

import threading
from collections import Counter
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray

from simulators.contract import AbstractSimulator
from simulators.effects.contract import AbstractEffect
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, ActionSpace, VehicleSpec

Tree = TypeVar("Tree")


class Meter:
    """Counts the flight of one training run; threads may share it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._steps: Counter[float] = Counter()

    def add(self, drone_steps: int, duration: float) -> None:
        """Counts so many steps of `duration` [s], summed over drones and worlds."""
        with self._lock:
            self._steps[duration] += drone_steps

    @property
    def fleet_seconds(self) -> float:
        """Flight until now, summed over drones [s]; programs in flight are waited for."""
        jax.effects_barrier()
        with self._lock:
            return float(sum(steps * duration for duration, steps in self._steps.items()))


class Metered(AbstractSimulator):
    """A simulator whose every step is counted."""

    inner: AbstractSimulator
    """What is flown."""
    meter: Meter = eqx.field(static=True)
    """What counts."""

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The name of what is flown."""
        return self.inner.name

    @property
    def version(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The version of what is flown."""
        return self.inner.version

    @property
    def doors(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The doors of what is flown."""
        return self.inner.doors

    @property
    def spec(self) -> VehicleSpec:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The airframe of what is flown."""
        return self.inner.spec

    @property
    def action_space(self) -> ActionSpace:  # pyright: ignore[reportIncompatibleVariableOverride]
        """How actions become commands of what is flown."""
        return self.inner.action_space

    @property
    def effects(self) -> tuple[AbstractEffect, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The effects of what is flown."""
        return self.inner.effects

    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> Any:
        return self.inner.reset(pos, key)

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> Any:
        return self.inner.restore(flight, cmd_history, key)

    def step_cmd(self, state: Any, cmd: Float[Array, "drones 4"], duration: float) -> Any:
        """Counted each time that it is flown."""
        leaves = [x for x in jax.tree.leaves((self.inner, state, cmd)) if _is_number(x)]
        _count(self.meter, duration, len(cmd), leaves)
        return self.inner.step_cmd(state, cmd, duration)

    def flight(self, state: Any) -> Flight:
        return self.inner.flight(state)

    def sensed(self, state: Any) -> Flight:
        """What controllers see of what is flown."""
        return self.inner.sensed(state)


def metered(simulator: AbstractSimulator, meter: Meter) -> Metered:
    """`simulator`, its flight counted by `meter`."""
    # pyright takes the properties above for fields.
    return Metered(inner=simulator, meter=meter)  # pyright: ignore[reportCallIssue]


def _is_number(x: Any) -> bool:
    return eqx.is_array(x) and not jnp.issubdtype(x.dtype, jax.dtypes.extended)


def _count(meter: Meter, duration: float, n_drones: int, leaves: list[Array]) -> None:
    """A step of `n_drones` drones in each world of a batch; `leaves` show how many worlds."""

    def add(drone_steps: ArrayLike) -> None:
        meter.add(int(np.asarray(drone_steps)), duration)

    @jax.custom_batching.custom_vmap
    def count(drone_steps: ArrayLike, leaves: list[Array]) -> Array:
        jax.debug.callback(add, drone_steps)
        return jnp.asarray(drone_steps)

    @count.def_vmap
    def count_batch(
        size: int, batched: Any, drone_steps: ArrayLike, leaves: Any
    ) -> tuple[Array, bool]:
        one = [x[0] if moving else x for x, moving in zip(leaves, batched[1], strict=True)]
        every = jnp.sum(drone_steps) if batched[0] else size * drone_steps
        return count(every, one), False

    count(jnp.asarray(n_drones), [jax.lax.stop_gradient(x) for x in leaves])


def billed(simulator: Tree, drone_steps: int) -> Tree:
    """`simulator` for a program that flies `drone_steps` control steps, summed over drones.

    A metered simulator, or one inside of another, is billed for them here and comes without its
    meter; any other comes back as it is.
    """

    def paid(node: Any) -> Any:
        if not isinstance(node, Metered):
            return node
        node.meter.add(drone_steps, CONTROL_DT)
        return node.inner

    return jax.tree.map(paid, simulator, is_leaf=lambda node: isinstance(node, Metered))
