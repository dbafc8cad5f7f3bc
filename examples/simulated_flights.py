"""Writes simulated flight logs of a vehicle whose physics you choose, to try a diagnosis on.

    python examples/simulated_flights.py "crazyflow+mass(e=0.2)" flights/heavy
    bench diagnose flights/heavy

A position controller follows a target that steps to and fro, and adds a small random signal to its
commands. Position, velocity and attitude are logged with noise, beside the commands.
"""

import argparse
import functools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bench.conformance.flights import hovering
from bench.plan.realities import parse_reality
from bench.text.errors import UsageError
from diagnosis.logs.flights import DroneLog, FlightLog, VehicleFile, write_flights
from simulators.algebra.rotation import quat_to_rpy, rpy_to_quat
from simulators.contract import AbstractSimulator, with_effects
from simulators.flight import Flight
from simulators.point_mass import PointMass
from simulators.registry import UnknownPluginError
from simulators.tracking import PDTracker
from simulators.vehicle import CONTROL_DT

NOISE = {"pos": 1e-3, "vel": 1e-2, "attitude": 3e-3}
"""Standard deviations of the noise on position, velocity and attitude [m, m/s, rad]: a guess at
what motion capture has."""
STEP, STEP_S = np.asarray([0.5, 0.5, 0.25]), 1.5
"""Largest step of the target [m], and how long it stays [s]."""
DITHER, DITHER_S = np.asarray([0.12, 0.12, 0.0, 0.03]), 0.2
"""Largest signal on the commands [rad, rad, rad, N], and how long it stays [s]."""


def fly(reality: AbstractSimulator, flights: int, seconds: float, seed: int) -> list[FlightLog]:
    """Logs of so many flights of one drone, each of `seconds` [s]."""
    rng, steps = np.random.default_rng(seed), round(seconds / CONTROL_DT)
    hold = functools.partial(_held, rng, steps)
    logs = []
    for i in range(flights):
        target = np.asarray([0.0, 0.0, 1.5]) + hold(STEP, STEP_S)
        flown, cmd = _flown(reality, jnp.asarray(target), jnp.asarray(hold(DITHER, DITHER_S)))
        rpy = np.asarray(quat_to_rpy(flown.quat))[:, 0]
        noise = {name: size * rng.standard_normal((steps, 3)) for name, size in NOISE.items()}
        drone = DroneLog(
            t=CONTROL_DT * np.arange(steps),
            pos=np.asarray(flown.pos)[:, 0] + noise["pos"],
            vel=np.asarray(flown.vel)[:, 0] + noise["vel"],
            quat=np.asarray(rpy_to_quat(jnp.asarray(rpy + noise["attitude"])), float),
            cmd=np.asarray(cmd, float)[:, 0],
        )
        logs.append(FlightLog(f"flight_{i + 1}", (drone,)))
    return logs


def _held(
    rng: np.random.Generator, steps: int, size: np.ndarray, seconds: float
) -> Float[np.ndarray, "time axes"]:
    """A random signal up to `size` that changes every `seconds`."""
    n = round(seconds / CONTROL_DT)
    drawn = rng.uniform(-1.0, 1.0, (-(-steps // n), len(size)))
    return size * np.repeat(drawn, n, axis=0)[:steps]


@eqx.filter_jit
def _flown(
    reality: AbstractSimulator,
    target: Float[Array, "time 3"],
    dither: Float[Array, "time 4"],
) -> tuple[Flight, Float[Array, "time 1 4"]]:
    """The flight before each command, and the commands."""
    state = hovering(reality, target[:1])
    tracker, still = PDTracker(mass=reality.spec.mass), jnp.zeros((1, 3))

    def step(state: object, inputs: tuple[Array, Array]) -> tuple[object, tuple[Flight, Array]]:
        target, dither = inputs
        now = reality.flight(state)
        cmd = tracker.cmd(now, target[None], still, still) + dither
        return reality.step_cmd(state, cmd, CONTROL_DT), (now, cmd)

    return jax.lax.scan(step, state, (target, dither))[1]


def main() -> None:
    """Writes the folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("reality", help='simulator and effects, such as "crazyflow+mass(e=0.2)"')
    parser.add_argument("folder", type=Path, help="new folder for the logs and vehicle.toml")
    parser.add_argument("--flights", type=int, default=6, help="how many (default: 6)")
    parser.add_argument("--seconds", type=float, default=6.0, help="length of each (default: 6)")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if given.flights < 1 or given.seconds < 1.0:
        parser.error("--flights and --seconds must be at least 1.")
    try:
        reality = parse_reality(given.reality)
        if isinstance(reality, PointMass):  # a diagnosis replays it with shorter steps
            reality = with_effects(PointMass(dt=PointMass.replay_dt), reality.effects)
        logs = fly(reality, given.flights, given.seconds, given.seed)
        vehicle = VehicleFile("simulated", "cf21B_500", reality.spec.mass)
        write_flights(given.folder, vehicle, logs)
    except (OSError, UsageError, UnknownPluginError) as error:
        parser.error(str(error))
    print(f"Written: {given.folder}")  # noqa: T201


if __name__ == "__main__":
    main()
