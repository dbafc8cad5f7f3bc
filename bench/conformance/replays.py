"""What a replayable simulator must keep to: its states can be set to what a log says."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bench.conformance import flights
from bench.conformance.suite import Check, close, demand, equal, shapes
from simulators.algebra.rotation import rpy_to_quat
from simulators.contract import Replayable
from simulators.vehicle import CONTROL_DT

CHOSEN: Bool[Array, " drones"] = jnp.asarray([True, False, True])
"""The drones that are set; the others must stay as they are."""
FASTER = 0.1
"""Share by which rotors are made faster [-]; thrust grows by its square, 21 %."""


def behaviour(cls: type[Any]) -> list[Check]:
    """Checks of the methods of `Replayable`."""
    sentences = {
        "a team can be placed without changing anything else": _with_motion,
        "chosen drones can be turned": _with_attitude,
        "rotors of chosen drones can be made faster": _with_faster_rotors,
        "rotors can be set to a thrust": _with_thrust,
        "a repeated step is the step": _repeating,
    }
    return [Check(text, functools.partial(check, cls())) for text, check in sentences.items()]


def _begun(simulator: Replayable) -> Any:
    """The state of a team that has just flown a wild command."""
    state = flights.hovering(simulator, flights.apart())
    cmd = flights.wild_cmds(simulator)[0]
    return jax.jit(lambda s: simulator.step_cmd(s, cmd, CONTROL_DT))(state)


def _same_structure(name: str, before: Any, after: Any) -> None:
    demand(
        shapes(before) == shapes(after),
        f"`{name}` changes the structure of the state; change numbers only",
    )


def _stay(name: str, before: Float[Array, "..."], after: Float[Array, "..."]) -> None:
    """Demands that the drones that were not chosen stay as they are."""
    demand(
        close(before[~CHOSEN], after[~CHOSEN]),
        f"`{name}` changes drones that were not chosen",
    )


def _with_motion(simulator: Replayable) -> None:
    state = _begun(simulator)
    pos, vel = flights.apart() + 0.5, jnp.asarray([[0.3, -0.2, 0.1]] * flights.N_DRONES)
    set_state = simulator.with_motion(state, pos, vel)
    _same_structure("with_motion", state, set_state)
    before, after = simulator.flight(state), simulator.flight(set_state)
    demand(
        close((after.pos, after.vel), (pos, vel)),
        "after `with_motion` the team is not at the position and velocity that were asked for",
    )
    kept, rest = ((f.quat, f.ang_vel, f.thrust) for f in (before, after))
    demand(
        close(kept, rest), "`with_motion` changes attitude, angular velocity or thrust; keep them"
    )


def _with_attitude(simulator: Replayable) -> None:
    state = _begun(simulator)
    quat = rpy_to_quat(jnp.asarray([[0.2, -0.1, 0.3]] * flights.N_DRONES))
    ang_vel = jnp.asarray([[0.5, -0.4, 0.3]] * flights.N_DRONES)
    set_state = simulator.with_attitude(state, quat, ang_vel, CHOSEN)
    _same_structure("with_attitude", state, set_state)
    before, after = simulator.flight(state), simulator.flight(set_state)
    demand(
        close(after.quat[CHOSEN], quat[CHOSEN]),
        "after `with_attitude` the chosen drones have not the attitude that was asked for",
    )
    if "rotation" in simulator.doors:
        demand(
            close(after.ang_vel[CHOSEN], ang_vel[CHOSEN]),
            "after `with_attitude` the chosen drones do not turn at the angular velocity asked for",
        )
    _stay("with_attitude", before.quat, after.quat)
    _stay("with_attitude", before.ang_vel, after.ang_vel)


def _with_faster_rotors(simulator: Replayable) -> None:
    state = _begun(simulator)
    faster = jnp.full((flights.N_DRONES, 4), FASTER)
    set_state = simulator.with_faster_rotors(state, faster, CHOSEN)
    _same_structure("with_faster_rotors", state, set_state)
    if equal(state, set_state):
        return  # no rotors
    before, after = simulator.flight(state).thrust, simulator.flight(set_state).thrust
    _stay("with_faster_rotors", before, after)
    grown = np.asarray(after / before)[np.asarray(CHOSEN)]
    demand(
        bool((abs(grown - (1.0 + FASTER) ** 2) < 0.05).all()),
        f"rotors that `with_faster_rotors` makes {100 * FASTER:g} % faster must give about 21 % "
        f"more thrust, got {100 * (grown - 1.0).min():.0f} to {100 * (grown - 1.0).max():.0f} %",
    )


def _with_thrust(simulator: Replayable) -> None:
    state, hover = _begun(simulator), flights.hover_thrust(simulator)
    thrust = hover * jnp.linspace(0.8, 1.2, flights.N_DRONES)
    set_state = simulator.with_thrust(state, thrust)
    _same_structure("with_thrust", state, set_state)
    if equal(state, set_state):
        return  # no rotors
    found = simulator.flight(set_state).thrust
    demand(
        close(found, thrust, 0.01, 0.0),
        f"after `with_thrust` the thrust must be {np.asarray(thrust)} N, got {np.asarray(found)} N",
    )


def _repeating(simulator: Replayable) -> None:
    state, action = _begun(simulator), jnp.zeros((flights.N_DRONES, 3))
    after = jax.jit(lambda s: simulator.step(s, action))(state)
    again = jax.jit(lambda s: simulator.repeating(after).step(s, action))(state)
    demand(
        close(simulator.flight(after), simulator.flight(again)),
        "a step of `repeating(after)` does not end in `after`; repeat what the step did",
    )
