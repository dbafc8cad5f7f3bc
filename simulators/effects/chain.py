"""Runs the effects of one door one after another, each with its own memory.

A simulator keeps the memories of all its effects as one tuple in the order of the effects. With
no effect at a door these functions return their input untouched, so the nominal simulator does
no extra work.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from simulators.distribution import Distribution
from simulators.effects.contract import (
    AbstractEffect,
    AutopilotEffect,
    CommandEffect,
    ListeningEffect,
    PlantEffect,
    RandomEffect,
    ResponseEffect,
    StateEffect,
    StiffEffect,
    WrenchEffect,
)
from simulators.flight import Flight
from simulators.vehicle import AutopilotGains, Vehicle

Effects = tuple[AbstractEffect, ...]
Memories = tuple[Any, ...]


def init(effects: Effects, n_drones: int, dt: float, key: PRNGKeyArray) -> Memories:
    """Memories of all effects at reset, for integration steps of `dt` [s].

    `key` seeds those that draw numbers, each with its own.
    """
    memories = tuple(effect.init(n_drones, dt) for effect in effects)
    for i, effect in enumerate(effects):
        if isinstance(effect, RandomEffect):
            seeded = effect.seeded(memories[i], jax.random.fold_in(key, i))
            memories = _put(memories, i, seeded)
    return memories


def _put(memories: Memories, i: int, memory: Any) -> Memories:
    return (*memories[:i], memory, *memories[i + 1 :])


def command(
    effects: Effects, memories: Memories, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
) -> tuple[Memories, Float[Array, "drones 4"]]:
    """The command after all command effects, one integration step of `dt` [s] on.

    Listening effects get it as it was sent.
    """
    for i, effect in enumerate(effects):
        if isinstance(effect, ListeningEffect):
            memories = _put(memories, i, effect.hear(memories[i], cmd, dt))
    for i, effect in enumerate(effects):
        if isinstance(effect, CommandEffect):
            memory, cmd = effect.command(memories[i], flight, cmd, dt)
            memories = _put(memories, i, memory)
    return memories, cmd


def autopilot(
    effects: Effects, memories: Memories, flight: Flight, gains: AutopilotGains, dt: float
) -> tuple[Memories, AutopilotGains]:
    """The attitude controller's gains after all autopilot effects, one step of `dt` [s] on."""
    for i, effect in enumerate(effects):
        if isinstance(effect, AutopilotEffect):
            memory, gains = effect.autopilot(memories[i], flight, gains, dt)
            memories = _put(memories, i, memory)
    return memories, gains


def plant(
    effects: Effects, memories: Memories, flight: Flight, vehicle: Vehicle, dt: float
) -> tuple[Memories, Vehicle]:
    """The vehicle after all plant effects, one step of `dt` [s] on."""
    for i, effect in enumerate(effects):
        if isinstance(effect, PlantEffect):
            memory, vehicle = effect.plant(memories[i], flight, vehicle, dt)
            memories = _put(memories, i, memory)
    return memories, vehicle


def respond(
    effects: Effects,
    memories: Memories,
    rpy_thrust: Float[Array, "drones 4"],
    cmd: Float[Array, "drones 4"],
    dt: float,
) -> tuple[Memories, Float[Array, "drones 4"]]:
    """Attitude [rad] and thrust [N] after all response effects, one step of `dt` [s] on."""
    for i, effect in enumerate(effects):
        if isinstance(effect, ResponseEffect):
            memory, rpy_thrust = effect.respond(memories[i], rpy_thrust, cmd, dt)
            memories = _put(memories, i, memory)
    return memories, rpy_thrust


def at(effects: Effects, memories: Memories, rpy_thrust: Float[Array, "drones 4"]) -> Memories:
    """Memories with every response effect steady at `rpy_thrust`."""
    for i, effect in enumerate(effects):
        if isinstance(effect, ResponseEffect):
            memories = _put(memories, i, effect.at(memories[i], rpy_thrust))
    return memories


def wrench(
    effects: Effects,
    memories: Memories,
    flight: Flight,
    vehicle: Vehicle,
    dt: float,
    pos_age: float,
) -> tuple[Memories, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
    """Sum of all effects' forces [N] and torques [N m], world frame, over a step of `dt` [s].

    `pos_age` says by how much the integrator's positions are older than its velocities [s]: half a
    step in explicit Euler, minus half a step in semi-implicit Euler, 0 in Runge and Kutta's method.
    """
    force, torque = jnp.zeros_like(flight.pos), jnp.zeros_like(flight.pos)
    aligned = eqx.tree_at(lambda f: f.pos, flight, flight.pos + pos_age * flight.vel)
    for i, effect in enumerate(effects):
        if isinstance(effect, WrenchEffect):
            seen = aligned if isinstance(effect, StiffEffect) else flight
            memory, f, t = effect.wrench(memories[i], seen, vehicle, dt)
            memories, force, torque = _put(memories, i, memory), force + f, torque + t
    return memories, force, torque


def project(effects: Effects, memories: Memories, flight: Flight) -> tuple[Memories, Flight]:
    """The flight after all state effects."""
    for i, effect in enumerate(effects):
        if isinstance(effect, StateEffect):
            memory, flight = effect.project(memories[i], flight)
            memories = _put(memories, i, memory)
    return memories, flight


def warm_up(
    effects: Effects,
    memories: Memories,
    flight: Flight,
    cmd_history: Float[Array, "time drones 4"],
    repeats: int,
    dt: float,
) -> tuple[Memories, Float[Array, "time drones 4"]]:
    """Memories and effective commands after a history, each held for `repeats` steps of `dt` [s].

    The flight stands still meanwhile: it is known only at the end of the history.
    """

    def held(memories: Memories, cmd: Array) -> tuple[Memories, Array]:
        def once(memories: Memories, _: None) -> tuple[Memories, Array]:
            return command(effects, memories, flight, cmd, dt)

        memories, cmds = jax.lax.scan(once, memories, None, length=repeats)
        return memories, cmds[-1]

    if not has(effects, CommandEffect, ListeningEffect):
        return memories, cmd_history
    return jax.lax.scan(held, memories, cmd_history)


def has(effects: Effects, *kinds: type[AbstractEffect]) -> bool:
    """Whether any effect is of one of these kinds."""
    return any(isinstance(effect, kinds) for effect in effects)


def canonical(effects: Effects, digits: int = 12) -> str:
    """Effects as text, sorted by name, parameters with so many digits; empty for none.

    A parameter that is drawn stands there with its distribution: `Mass(e~normal(0, 0.05))`.
    """
    texts = []
    for effect in effects:
        values = (_value(effect, name, digits) for name in type(effect).parameters)
        texts.append(f"{type(effect).__name__}({', '.join(values)})")
    return "; ".join(sorted(texts))


def _value(effect: AbstractEffect, name: str, digits: int) -> str:
    value = getattr(effect, name)
    if isinstance(value, Distribution):
        return f"{name}~{value.text(digits)}"
    # The shortest text that is this number in its own precision: 0.2 is not 0.200000003.
    return f"{name}={float(str(np.asarray(value))):.{digits}g}"
