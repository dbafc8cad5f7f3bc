"""Flights of known truth: a point mass (or another simulator) under a position controller."""

import dataclasses
import functools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.conformance.flights import hovering
from diagnosis.logs.flights import DroneLog, FlightLog, FlightSet, VehicleFile, load_flights
from diagnosis.replay.library import make_library, with_aliases
from diagnosis.replay.replay import make_replay
from simulators import registry
from simulators.algebra.rotation import quat_to_rpy
from simulators.contract import with_effects
from simulators.point_mass import PointMass
from simulators.tracking import PDTracker
from simulators.vehicle import CONTROL_DT

REAL = Path(__file__).parents[2].parent / "shared" / "flights"


def real(name, n=None):
    """The first flights of a real set; the test is skipped where they are not."""
    if not (REAL / name).is_dir():
        pytest.skip("The real flights are not beside the repository")
    flights = load_flights(REAL / name)
    return dataclasses.replace(flights, flights=flights.flights[:n])


SIGMA = np.repeat([1e-3, 1e-2, 3e-3], 3)
"""Noise of the flights: m, m/s, rad."""
COMMON = ("wind", "mass", "drag", "trim", "voltage_sag")
"""Candidates of tests that are not about which of all is named: they share one program."""


def fly(simulator, n_flights=6, seconds=6.0, seed=0, noise=1.0, rotors_of=None, rows=1):
    """Flights around a point 1 m up, with steps of the target and a dither on the commands.

    With `rotors_of` the logs hold the rotors' speeds instead of commands: those of so much of the
    thrust, which is more than all of it where rotors are weaker than believed. `rows` are logged
    while a command is held.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / CONTROL_DT)
    hold = lambda size, k: np.repeat(rng.uniform(-1, 1, (n // k + 1, size)), k, axis=0)[:n]  # noqa: E731
    flights = []
    for i in range(n_flights):
        target = np.array([0.0, 0.0, 1.5]) + hold(3, 75) * [0.5, 0.5, 0.25]
        dither = hold(4, 10) * [0.12, 0.12, 0.0, 0.03]
        log, cmd = _flown(simulator, jnp.asarray(target), jnp.asarray(dither), rows)
        drone = noisy(log, np.asarray(cmd), rng, noise, CONTROL_DT / rows)
        if rotors_of is not None:
            thrust = rotors_of * np.asarray(log.thrust, float)[:, 0]
            speeds = rotor_speeds(thrust, simulator.spec)
            drone = dataclasses.replace(drone, cmd=None, rotor_vel=speeds)
        flights.append(FlightLog(f"flight_{i}", (drone,)))
    return tuple(flights)


def made_log(seconds=2.0, seed=0, **fields):
    """One drone's log at 100 Hz with smooth made-up columns."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(round(100 * seconds))
    wave = lambda k: np.sin(2 * np.pi * (np.arange(k) + 1) * t[:, None] / 2 + rng.uniform(0, 6, k))  # noqa: E731
    rpy = 0.2 * wave(3)
    cmd = np.concatenate([0.2 * wave(3), 0.4 + 0.05 * wave(1)], axis=1)
    quat = Rotation.from_euler("xyz", rpy).as_quat()
    return DroneLog(**{"t": t, "pos": wave(3), "vel": wave(3), "quat": quat, "cmd": cmd} | fields)


def rotor_speeds(thrust, spec):
    """Speeds [rad/s] of four rotors that share a thrust [N]."""
    c0, c1, c2 = spec.rpm2thrust
    n = (-c1 + np.sqrt(c1**2 - 4.0 * c2 * (c0 - thrust / 4.0))) / (2.0 * c2)
    return np.repeat(n[:, None] * 2.0 * np.pi / 60.0, 4, axis=1)


@eqx.filter_jit
def _flown(simulator, target, dither, rows):
    """A program for each kind of simulator and effects; their numbers are its arguments."""
    tracker = PDTracker(mass=simulator.spec.mass)
    state = hovering(simulator, target[:1])

    def step(state, inputs):
        target, dither = inputs
        now = simulator.flight(state)
        still = jnp.zeros((1, 3))
        cmd = tracker.cmd(now, target[None], still, still) + dither
        # Between two commands the simulator takes its own steps; rows look on from the first.
        later = [simulator.step_cmd(state, cmd, CONTROL_DT * (i + 1) / rows) for i in range(rows)]
        seen = [now, *(simulator.flight(one) for one in later[:-1])]
        return later[-1], (jax.tree.map(lambda *x: jnp.stack(x), *seen), jnp.stack([cmd] * rows))

    _, logged = jax.lax.scan(step, state, (target, dither))
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), logged)


def noisy(flight, cmd, rng, noise=1.0, dt=CONTROL_DT):
    """The log of the first drone of a flight [time, drones, ...], `noise` times `SIGMA` on it."""
    n = len(cmd)
    rpy = np.asarray(quat_to_rpy(flight.quat))[:, 0] + rng.normal(0, noise * 3e-3, (n, 3))
    return DroneLog(
        t=dt * np.arange(n),
        pos=np.asarray(flight.pos)[:, 0] + rng.normal(0, noise * 1e-3, (n, 3)),
        vel=np.asarray(flight.vel)[:, 0] + rng.normal(0, noise * 1e-2, (n, 3)),
        quat=Rotation.from_euler("xyz", rpy).as_quat(),
        ang_vel=None,
        acc=None,
        cmd=cmd[:, 0].astype(float),
        rotor_vel=None,
        pwm=None,
        battery=None,
    )


def flight_set(flights, mass=0.0434, drone="cf21B_500"):
    """The flights as they come from a folder."""
    return FlightSet(Path("flown"), VehicleFile("test", drone, mass), tuple(flights), ())


def some_rows(log, rows):
    """A drone's log with some of its rows: a slice or indices."""
    columns = {f.name: getattr(log, f.name) for f in dataclasses.fields(log)}
    kept = {name: values[rows] for name, values in columns.items() if values is not None}
    return dataclasses.replace(log, **kept)


def thinned(flight, rows):
    """The flight of one drone with some of its rows."""
    (drone,) = flight.drones
    return dataclasses.replace(flight, drones=(some_rows(drone, rows),))


def edited(flown, change):
    """A flight or a set of them; `change` gives new columns of each drone's log."""
    if isinstance(flown, FlightSet):
        return flown.each(lambda log: dataclasses.replace(log, **change(log)))
    drones = tuple(dataclasses.replace(log, **change(log)) for log in flown.drones)
    return dataclasses.replace(flown, drones=drones)


def misled(flight, rng, columns, size):
    """The flight with commands in these columns that are up to `size` off those that were flown."""

    def change(log):
        off = rng.uniform(-size, size, (len(log.cmd) // 15 + 1, len(columns)))
        cmd = log.cmd.copy()
        cmd[:, columns] += np.repeat(off, 15, axis=0)[: len(cmd)]
        return {"cmd": cmd}

    return edited(flight, change)


def sizes(simulator):
    """Attached effects with their parameters."""
    return {
        type(effect).__name__: {p: float(getattr(effect, p)) for p in effect.parameters}
        for effect in simulator.effects
    }


def all_but(*names):
    """What to exclude so that these effects, and those that look like them, are candidates."""
    return [n for n in registry.names("effect") if not with_aliases([n]) & {*names}]


def few_or_all(*names, others=()):
    """Cases of what to exclude: all effects but these and those that look like them, or `others`.

    Without names, all but `COMMON`. A program with all candidates takes half a minute to compile,
    and is another one for each airframe, simulator and number of drones; cases with all are
    therefore exhaustive.
    """
    return pytest.mark.parametrize(
        "exclude",
        [
            pytest.param(all_but(*(names or COMMON)), id="few candidates"),
            pytest.param(others, id="all candidates", marks=pytest.mark.exhaustive),
        ],
    )


@functools.cache
def point_mass_replay():
    """The replay of a point mass with every effect; its compiled programs are shared."""
    return make_replay(make_library(PointMass(dt=0.005)), 0.005)


def point_mass_set(*effects, dt=0.005, n_flights=4, seconds=9.0, **settings):
    """Flights of a point mass with effects, at the step in which it is replayed.

    Each is one segment, and a replay flies four of 10 s at once, however short they are.
    """
    simulator = with_effects(PointMass(dt=dt), effects)
    return flight_set(fly(simulator, n_flights, seconds, **settings))
