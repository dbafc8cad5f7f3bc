"""What a simulator must keep to: the flight contract, its doors, and no world but its own."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bench.conformance import flights, replays
from bench.conformance.suite import (
    Check,
    close,
    declaration_checks,
    demand,
    equal,
    finite,
)
from simulators import registry
from simulators.contract import AbstractSimulator, Replayable, with_effects
from simulators.effects.card import load_cards
from simulators.effects.contract import DOORS
from simulators.vehicle import CONTROL_DT

VECTORS = ("pos", "vel", "quat", "ang_vel", "thrust", "torque")
"""Parts of a flight with a row for each drone."""


def declarations(cls: type[Any]) -> list[Check]:
    """Checks of what the class says of itself; the others need them."""
    return [
        *declaration_checks(cls, AbstractSimulator),
        Check("it has a name, and doors that effects know", lambda: _doors(cls)),
    ]


def behaviour(cls: type[Any]) -> list[Check]:
    """Checks of resets, steps, restores, physics and doors."""
    sentences = {
        "a flight has one row per drone": _shapes,
        "a step and a restore keep the structure of the state": lambda s: flights.demand_structure(
            s, "the state"
        ),
        "a reset puts the team at rest and level": _rest,
        "a restore starts at the measured flight": _restores,
        "a step is the command of its action held for 20 ms, compiled or not": _step,
        "time counts what was flown": _time,
        "hover thrust carries the vehicle": _hover,
        "tilt accelerates as in the paper": _tilt,
        "quaternions stay unit and flights finite": _finite,
        "the same flight twice is the same": _repeats,
        "many worlds at once equal one by one": flights.demand_worlds,
        "renumbering the drones renumbers the flight": lambda s: flights.demand_renumbering(
            s, flights.apart(), VECTORS
        ),
        "the final position can be differentiated by the commands": _gradient,
        "a duration of 0 s is refused": _duration,
    }
    found = [Check(text, functools.partial(check, cls())) for text, check in sentences.items()]
    found += [
        Check(f"its door '{door}' reaches the flight", functools.partial(_door, cls(), door))
        for door in cls.doors
    ]
    return found + (replays.behaviour(cls) if issubclass(cls, Replayable) else [])


def _doors(cls: type[Any]) -> None:
    demand(isinstance(cls.name, str) and cls.name, f"`name` must be a text, got {cls.name!r:.40}")
    known = {n for n in registry.names("simulator") if registry.load("simulator", n) is cls}
    demand(
        not known or cls.name in known,
        f"`name` is '{cls.name}', but it is registered as {', '.join(sorted(known))}; rows are "
        "told apart by that name",
    )
    demand(
        isinstance(cls.doors, tuple) and set(cls.doors) <= set(DOORS),
        f"`doors` must be a tuple of doors among {', '.join(DOORS)}, got {cls.doors!r:.80}",
    )


def _flight(simulator: AbstractSimulator) -> object:
    return flights.fly(simulator, flights.apart(), flights.wild_cmds(simulator))


def _shapes(simulator: AbstractSimulator) -> None:
    for n in (1, 2, 5):
        reset = jax.eval_shape(lambda n=n: simulator.reset(flights.apart(n), flights.KEY))
        stepped = jax.eval_shape(lambda s, n=n: simulator.step(s, jnp.zeros((n, 3))), reset)
        wanted = {"t": (), "pos": (n, 3), "vel": (n, 3), "quat": (n, 4), "ang_vel": (n, 3)}
        wanted |= {"thrust": (n,), "torque": (n, 3)}
        for done, state in (("reset", reset), ("step", stepped)):
            flight = jax.eval_shape(simulator.flight, state)
            for name, shape in wanted.items():
                got = getattr(flight, name).shape
                demand(
                    got == shape,
                    f"after a {done} `flight().{name}` must have shape {shape} for N = {n}, "
                    f"got {got}",
                )


def _rest(simulator: AbstractSimulator) -> None:
    flight = simulator.flight(simulator.reset(flights.apart(), flights.KEY))
    demand(close(flight.pos, flights.apart()), "after a reset the team is not where it was put")
    for name in ("t", "vel", "ang_vel", "thrust", "torque"):
        value = np.asarray(getattr(flight, name))
        demand(
            not value.any(), f"after a reset `flight().{name}` must be 0, got {value.ravel()[:3]}"
        )
    level = np.asarray(flight.quat) == [0.0, 0.0, 0.0, 1.0]
    demand(
        level.all(), "after a reset the attitude must be level: quat = (0, 0, 0, 1), scalar last"
    )


def _restores(simulator: AbstractSimulator) -> None:
    pos = flights.apart()
    flight = simulator.flight(flights.hovering(simulator, pos))
    wanted = flights.hover_flight(simulator, pos)
    for name in ("pos", "vel", "quat", "ang_vel"):
        demand(
            close(getattr(flight, name), getattr(wanted, name)),
            f"`flight().{name}` right after `restore` is not what was restored",
        )
    demand(
        close(flight.thrust, wanted.thrust, 1e-3, 1e-4),
        "after a restore with a history of hover commands the thrust is not that of hover; warm "
        "the rotors up with `cmd_history`",
    )


def _step(simulator: AbstractSimulator) -> None:
    action = jnp.asarray([[0.3, -0.2, 0.1], [0.0, 0.5, -0.1], [-1.0, 1.0, 0.4]])
    state = flights.hovering(simulator, flights.apart())
    stepped = simulator.flight(simulator.step(state, action))
    held = simulator.flight(
        simulator.step_cmd(state, simulator.action_space.to_cmd(action), CONTROL_DT)
    )
    demand(close(stepped, held), "`step` must be `step_cmd` of `action_space.to_cmd(action)`")
    compiled = jax.jit(lambda s: simulator.flight(simulator.step(s, action)))(state)
    demand(close(compiled, stepped), "compiled, a step gives other numbers than eager")


def _time(simulator: AbstractSimulator) -> None:
    t = np.asarray(_flight(simulator).t)  # pyright: ignore[reportAttributeAccessIssue]
    wanted = CONTROL_DT * np.arange(1, len(t) + 1)
    demand(np.allclose(t, wanted, rtol=1e-5), f"after steps of 0.02 s `t` is {t[:3]}, ...")


def _hover(simulator: AbstractSimulator) -> None:
    hover = jnp.asarray([0.0, 0.0, 0.0, flights.hover_thrust(simulator)])
    pos = flights.apart()
    cmds = jnp.broadcast_to(hover, (flights.STEPS, len(pos), 4))
    lost = jnp.abs(flights.fly(simulator, pos, cmds).pos[-1] - pos).max()
    demand(
        float(lost) < 0.02,
        f"half a second of thrust m g moves a hovering drone by {float(lost):.3f} m; `spec.mass` "
        "must be the mass that flies",
    )


def _tilt(simulator: AbstractSimulator) -> None:
    for axis, cmd, words in (
        (0, (0.0, 0.1), "positive pitch must fly to +x"),
        (1, (0.1, 0.0), "positive roll must fly to -y"),
    ):
        held = jnp.asarray([*cmd, 0.0, flights.hover_thrust(simulator)])
        pos = flights.apart()
        cmds = jnp.broadcast_to(held, (flights.STEPS, len(pos), 4))
        vel = np.asarray(flights.fly(simulator, pos, cmds).vel[-1, 0])
        sign = 1.0 if axis == 0 else -1.0
        demand(sign * vel[axis] > 0.1, f"{words}, got the velocity {vel} m/s")
        demand(
            abs(vel[1 - axis]) < 0.2 * abs(vel[axis]), f"{words} and not sideways, got {vel} m/s"
        )


def _finite(simulator: AbstractSimulator) -> None:
    flight = _flight(simulator)
    demand(finite(flight), "a flight of half a second around hover becomes NaN or infinite")
    norm = np.linalg.norm(np.asarray(flight.quat), axis=-1)  # pyright: ignore[reportAttributeAccessIssue]
    demand(np.allclose(norm, 1.0, atol=1e-5), f"quaternions must stay unit, got {norm.max():g}")


def _repeats(simulator: AbstractSimulator) -> None:
    demand(equal(_flight(simulator), _flight(simulator)), "two equal flights differ")


def _gradient(simulator: AbstractSimulator) -> None:
    pos, cmds = flights.apart(), flights.wild_cmds(simulator)

    @eqx.filter_jit
    def slope(cmds: jax.Array) -> jax.Array:
        return jax.grad(lambda c: jnp.sum(flights.flown(simulator, pos, c).pos[-1]))(cmds)

    found = slope(cmds)
    demand(finite(found), "the gradient of the final position by the commands is not finite")
    demand(
        bool(jnp.any(found[..., 3] != 0.0)),
        "the final position does not depend on the commanded thrust; a policy cannot be trained",
    )


def _duration(simulator: AbstractSimulator) -> None:
    state, cmd = flights.hovering(simulator, flights.apart()), flights.wild_cmds(simulator)[0]
    try:
        simulator.step_cmd(state, cmd, 0.0)
    except ValueError:
        return
    demand(
        False, "`step_cmd` accepts a duration of 0 s; raise a ValueError that says what it allows"
    )


def _door(simulator: AbstractSimulator, door: str) -> None:
    name, probe = next(
        (name, card.probe)
        for name, card in load_cards().items()
        if card.probe is not None and card.probe.door == door
    )
    cls, values = registry.load("effect", name), probe.values
    if not {cls.door, *cls.needs} <= set(simulator.doors):
        return
    effect = cls(**{key: jnp.asarray(value) for key, value in values.items()})
    # Low for the floor's sake, sinking and tilted for all others'.
    pos, cmds = flights.crowded(), flights.wild_cmds(simulator)
    plain = flights.fly(simulator, pos, cmds)
    probed = flights.fly(with_effects(simulator, [effect]), pos, cmds)
    demand(
        not equal(plain, probed),
        f"`doors` promises '{door}', but a flight with the effect '{name}' ({values}) is the same "
        "as without; call the hooks of effects at every integration step (effects/chain.py)",
    )
