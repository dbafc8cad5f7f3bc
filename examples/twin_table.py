"""Prints how the two simulators answer the same commands, as a Markdown table.

Every number is measured on flights of one drone: steps of pitch and thrust from a hover, coasting
at hover thrust, and take-off from the ground with the rotors standing.

    python examples/twin_table.py
"""

import dataclasses
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from simulators.algebra.rotation import quat_to_rpy
from simulators.contract import AbstractSimulator
from simulators.crazyflow import Crazyflow
from simulators.flight import Flight
from simulators.point_mass import PointMass
from simulators.vehicle import GRAVITY

DT = 0.002
"""Resolution of the flights [s]: crazyflow's physics step."""
KEY = jax.random.key(0)


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the table."""

    symbol: str
    """Name of the number in code and text."""
    meaning: str
    """What was measured, with its unit."""
    lf: float
    """In the point mass."""
    hf: float
    """In crazyflow."""


@eqx.filter_jit
def fly(simulator: AbstractSimulator, start: Flight | None, cmd: jax.Array) -> Flight:
    """One second under a command, from a flight or, if None, from rest on the ground."""
    if start is None:
        state = simulator.reset(jnp.zeros((1, 3)), KEY)
    else:
        weight = simulator.spec.mass * GRAVITY
        hover = jnp.zeros((50, 1, 4)).at[:, :, 3].set(weight)
        state = simulator.restore(start, hover, KEY)

    def step(state: object, _: None) -> tuple[object, Flight]:
        state = simulator.step_cmd(state, cmd[None], DT)
        return state, simulator.flight(state)

    return jax.lax.scan(step, state, None, length=round(1.0 / DT))[1]


def hover(simulator: AbstractSimulator, speed: float) -> Flight:
    """A level flight at hover thrust, moving along x [m/s]."""
    return Flight(
        t=jnp.asarray(0.0),
        pos=jnp.asarray([[0.0, 0.0, 3.0]]),
        vel=jnp.asarray([[speed, 0.0, 0.0]]),
        quat=jnp.asarray([[0.0, 0.0, 0.0, 1.0]]),
        ang_vel=jnp.zeros((1, 3)),
        thrust=jnp.asarray([simulator.spec.mass * GRAVITY]),
        torque=jnp.zeros((1, 3)),
    )


def first(reached: np.ndarray) -> float:
    """Time [s] at which a condition holds for the first time; nan if it never does."""
    return DT * (1 + int(np.argmax(reached))) if np.any(reached) else float("nan")


def measure(simulator: AbstractSimulator) -> dict[str, float]:
    """Every number of the table, for one simulator."""
    weight = simulator.spec.mass * GRAVITY
    still = hover(simulator, 0.0)
    tilted = fly(simulator, still, jnp.asarray([0.0, 0.5, 0.0, weight]))
    pitch = np.asarray(quat_to_rpy(tilted.quat)[:, 0, 1]) / 0.5
    thrust = np.asarray(fly(simulator, still, jnp.asarray([0.0, 0.0, 0.0, 1.2 * weight])).thrust)
    rise = (thrust[:, 0] / weight - 1.0) / 0.2
    coast = fly(simulator, hover(simulator, 1.0), jnp.asarray([0.0, 0.0, 0.0, weight]))
    lift = {
        newtons: np.asarray(fly(simulator, None, jnp.asarray([0.0, 0.0, 0.0, newtons])).pos)
        for newtons in (simulator.spec.thrust_max, 0.44)
    }
    return {
        "weight": weight,
        "pitch_dead": first(pitch > 0.05),
        "pitch_63": first(pitch > 0.632),
        "pitch_end": float(0.5 * pitch[-1]),
        "thrust_63": first(rise > 0.632),
        "drag": -float(np.log(coast.vel[-1, 0, 0])),
        "lift_full": first(lift[simulator.spec.thrust_max][:, 0, 2] > 0.05),
        "lift_slow": first(lift[0.44][:, 0, 2] > 0.05),
    }


MEANING = {
    "weight": "hover thrust [N]",
    "pitch_dead": "time to 5 % of a 0.5 rad pitch step [s]",
    "pitch_63": "time to 63 % of a 0.5 rad pitch step [s]",
    "pitch_end": "pitch 1 s after the step [rad]",
    "thrust_63": "time to 63 % of a 20 % thrust step from hover [s]",
    "drag": "decay rate of horizontal speed [1/s]",
    "lift_full": "time to 0.05 m height at full thrust, from rest [s]",
    "lift_slow": "time to 0.05 m height at 0.44 N, from rest [s]",
}


def table() -> list[Row]:
    """All rows: the point mass at 2 ms resolution beside crazyflow."""
    lf, hf = measure(PointMass(dt=DT)), measure(Crazyflow())
    return [Row(symbol, MEANING[symbol], lf[symbol], hf[symbol]) for symbol in MEANING]


def markdown(rows: list[Row]) -> str:
    """The rows as a Markdown table."""
    lines = ["| symbol | meaning | LF | HF |", "|---|---|---|---|"]
    lines += [f"| `{r.symbol}` | {r.meaning} | {r.lf:.3f} | {r.hf:.3f} |" for r in rows]
    return "\n".join(lines).replace("-0.000", "0.000")


if __name__ == "__main__":
    sys.stdout.write(markdown(table()) + "\n")
