"""Predicted and differentiated windows: the commands of a log flown in a simulator.

One compiled program takes a fixed number of segments, the parameters of all effects and a fixed
number of directions in parameter space, and returns the prediction at every node with its
derivative along each direction (forward mode, the directions vectorised). Attitude, rotors and the
memories of the effects run on from window to window, and so do their derivatives; position and
velocity start anew, with derivatives zero. An effect that follows the battery's voltage is told
it at every step.

More derivatives are along what windows start from whose attitude is set to the measured one
(`turn`): attitude, angular velocity and rotor speeds; they, too, run on until they are forgotten.
"""

import dataclasses
import functools
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diagnosis.logs.segments import REPLAY_WINDOW_S, Segments
from diagnosis.replay.library import Library
from diagnosis.replay.programs import cached
from simulators.algebra.rotation import quat_to_rpy, rpy_to_quat
from simulators.contract import AbstractSimulator, Replayable
from simulators.effects.contract import VoltageEffect
from simulators.flight import Flight

LANES = 4
"""Segments per call."""
NARROW = 8
"""Directions of a replay along some parameters only; all of them cost several times as much."""
_INPUTS = ("start", "pos", "vel", "quat", "ang_vel", "fresh", "cmd", "voltage", "place")
TURNS = 10
"""Directions of the attitude, the angular velocity and the rotor speeds at a fresh start."""


@dataclasses.dataclass(frozen=True)
class Prediction:
    """What the simulator says of a batch of segments, at the nodes of its scored windows."""

    value: Float[np.ndarray, "segments windows drones nodes 9"]
    """Position [m], velocity [m/s], roll, pitch, yaw [rad]."""
    slope: Float[np.ndarray, "directions segments windows drones nodes 9"]
    """Its derivative along each direction."""
    turn: Float[np.ndarray, "turns segments windows drones nodes 9"]
    """Its derivative along a rotation [rad] and angular velocity [rad/s], body frame, and the
    relative speed of each rotor, of every drone at the last fresh start; none where they were not
    asked for."""


@dataclasses.dataclass(frozen=True)
class Replay:
    """Replays with one library; programs are compiled for each number of drones on first use."""

    library: Library
    """The effects and the simulator."""
    dt: float
    """Integration step [s]."""
    measured: int = 0
    """Leading columns of commands that were measured and are met at every step: none, the attitude
    (3), the thrust of the rotors as well (4)."""
    programs: dict[tuple, Callable[..., tuple[Array, Array]]] = dataclasses.field(
        default_factory=dict
    )
    """Compiled programs by shapes."""

    @property
    def prescribed(self) -> bool:
        """Whether the attitude comes from measurement."""
        return self.measured >= 3

    def __call__(
        self,
        segments: Segments,
        vectors: Float[np.ndarray, "flights params"],
        directions: Float[np.ndarray, "directions params"],
        turns: bool = True,
    ) -> Iterator[tuple[slice, Prediction]]:
        """Predictions batch by batch, so that memory does not grow with the logs.

        Every flight has a vector of its own. Without `turns`, those slopes are left out. Each core
        flies a batch of its own.
        """
        along = jnp.asarray(directions, float)

        def prepared(begin: int) -> tuple[slice, Callable[..., tuple[Array, Array]], tuple]:
            chosen = slice(begin, min(begin + LANES, len(segments)))
            batch = {name: _padded(getattr(segments, name)[chosen]) for name in _INPUTS}
            args = batch, _padded(vectors[segments.flight[chosen]]), along
            return chosen, self._program(args, turns), args

        def flown(chosen: slice, program: Callable, args: tuple) -> tuple[slice, Prediction]:
            value, slope = program(*args)
            n, k = chosen.stop - chosen.start, len(directions)
            slopes = np.moveaxis(np.asarray(slope[:n]), 1, 0)
            return chosen, Prediction(np.asarray(value[:n]), slopes[:k], slopes[k:])

        with ThreadPoolExecutor(_cores()) as pool:
            flying = deque[Future[tuple[slice, Prediction]]]()
            for begin in range(0, len(segments), LANES):
                flying.append(pool.submit(flown, *prepared(begin)))
                if len(flying) >= _cores():
                    yield flying.popleft().result()
            while flying:
                yield flying.popleft().result()

    def _program(self, args: tuple, turns: bool) -> Callable[..., tuple[Array, Array]]:
        """The program for the shapes of `args`, compiled once a process."""
        shapes = (turns, *(x.shape for x in jax.tree.leaves(args)))
        if shapes not in self.programs:

            def fly(batch: dict[str, Array], theta: Array, along: Array) -> tuple[Array, Array]:
                one = functools.partial(_segment, self, directions=along, turns=turns)
                return jax.vmap(one)(batch, theta)

            settings = f"dt={self.dt} measured={self.measured} turns={turns}"
            program = cached("replay", fly, self.library, settings, args)
            self.programs[shapes] = program.lower(*args).compile()
        return self.programs[shapes]


def directions_along(
    n_params: int, along: Sequence[int] | None
) -> Float[np.ndarray, "directions params"]:
    """One direction a parameter, for all of them (None) or for at most `NARROW`.

    A program belongs to a number of directions, so that few parameters always have `NARROW`, of
    which the last may be zero.
    """
    if along is None:
        return np.eye(n_params)
    directions = np.zeros((NARROW, n_params))
    directions[np.arange(len(along)), list(along)] = 1.0
    return directions


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _padded(x: np.ndarray) -> Array:
    """`x` with its last entry repeated up to `LANES` entries."""
    short = LANES - len(x)
    return jnp.asarray(np.concatenate([x, np.repeat(x[-1:], short, axis=0)]), float)


def _segment(
    replay: Replay, lane: dict[str, Array], theta: Array, directions: Array, turns: bool
) -> tuple[Array, Array]:
    """Prediction and slopes of one segment."""
    library = replay.library
    n_windows = len(lane["pos"])
    cmds, volts = (
        lane[name].reshape(n_windows, -1, *lane[name].shape[1:]) for name in ("cmd", "voltage")
    )

    def start(theta: Array) -> tuple[eqx.Module, eqx.Module]:
        simulator = library.attach(theta)
        flight = Flight(
            t=jnp.maximum(lane["start"], 0.0),
            pos=lane["pos"][0],
            vel=lane["vel"][0],
            quat=lane["quat"][0],
            ang_vel=lane["ang_vel"][0],
            thrust=cmds[0, 0, :, 3],
            torque=jnp.zeros_like(lane["pos"][0]),
        )
        history = jnp.repeat(cmds[0, :1], 3, axis=0)
        state = simulator.restore(flight, history, jax.random.key(0))
        return eqx.partition(state, eqx.is_inexact_array)

    n_drones = lane["pos"].shape[1]
    turning = jnp.repeat(jnp.eye(TURNS)[:, None], n_drones, axis=1)[: TURNS * turns]
    along = jnp.concatenate([directions, jnp.zeros((len(turning), len(theta)))])
    turning = jnp.concatenate([jnp.zeros((len(directions), n_drones, TURNS)), turning])
    moving, slopes, still = jax.vmap(
        lambda direction: jax.jvp(start, (theta,), (direction,), has_aux=True),
        out_axes=(None, 0, None),
    )(along)

    def window(carry: tuple, inputs: dict[str, Array]) -> tuple[tuple, tuple]:
        moving, still, slopes = carry

        def fly(moving: eqx.Module, theta: Array, turn: Array) -> tuple[tuple, eqx.Module]:
            simulator = library.attach(theta)
            state = eqx.combine(moving, still)
            state = simulator.with_motion(state, inputs["pos"], inputs["vel"])
            quat, ang_vel = _turned(inputs["quat"], turn[:, :3]), inputs["ang_vel"] + turn[:, 3:6]
            state = simulator.with_attitude(state, quat, ang_vel, inputs["fresh"] > 0)
            state = simulator.with_faster_rotors(state, turn[:, 6:], inputs["fresh"] > 0)
            state, track = _fly(replay, simulator, state, inputs["cmd"], inputs["voltage"])
            moving, kept = eqx.partition(state, eqx.is_inexact_array)
            return (moving, _at(track, inputs["place"])), kept

        def push(slope: eqx.Module, direction: Array, turn: Array) -> tuple:
            at = (moving, theta, jnp.zeros_like(turn))
            return jax.jvp(fly, at, (slope, direction, turn), has_aux=True)

        (flown, value), (pushed, tangent), kept = jax.vmap(push, out_axes=(None, 0, None))(
            slopes, along, turning
        )
        # Before a flight's first row nothing is known, and nothing moves.
        carry = jax.tree.map(
            lambda old, new: jnp.where(inputs["idle"], old, new), carry, (flown, kept, pushed)
        )
        return carry, (value, tangent)

    names = ("pos", "vel", "quat", "ang_vel", "fresh", "place")
    idle = (lane["start"] < 0) & (jnp.arange(n_windows) == 0)
    inputs = {name: lane[name] for name in names}
    inputs |= {"cmd": cmds, "voltage": volts, "idle": idle}
    _, (value, tangent) = jax.lax.scan(window, (moving, still, slopes), inputs)
    return value[1:], jnp.moveaxis(tangent, 1, 0)[:, 1:]


def _turned(
    quat: Float[Array, "drones 4"], rotation: Float[Array, "drones 3"]
) -> Float[Array, "drones 4"]:
    """`quat` turned by a small rotation [rad] about body axes."""
    xyz, w, half = quat[:, :3], quat[:, 3:], 0.5 * rotation
    vector = xyz + w * half + jnp.cross(xyz, half)
    return jnp.concatenate([vector, w - jnp.sum(xyz * half, axis=1, keepdims=True)], axis=1)


def _fly(
    replay: Replay, simulator: Replayable, state: eqx.Module, cmds: Array, volts: Array
) -> tuple[eqx.Module, Float[Array, "steps drones 9"]]:
    def step(state: eqx.Module, inputs: tuple[Array, Array]) -> tuple[eqx.Module, Array]:
        cmd, voltage = inputs
        state = _at_voltage(simulator, state, voltage)
        if replay.prescribed:
            everyone = jnp.ones(len(cmd), bool)
            still = jnp.zeros_like(cmd[:, :3])
            state = simulator.with_attitude(state, rpy_to_quat(cmd[:, :3]), still, everyone)
        if replay.measured == 4:
            state = simulator.with_thrust(state, cmd[:, 3])
        state = simulator.step_cmd(state, cmd, replay.dt)
        return state, _measured(simulator.flight(state))

    first = _measured(simulator.flight(state))
    state, track = jax.lax.scan(step, state, (cmds, volts))
    return state, jnp.concatenate([first[None], track])


def _at_voltage(simulator: AbstractSimulator, state: Any, voltage: Array) -> Any:
    """The state with the battery's voltage [V] known to the effects that follow it."""
    for i, effect in enumerate(simulator.effects):
        if isinstance(effect, VoltageEffect):
            state = eqx.tree_at(lambda s, i=i: s.memory[i], state, effect.at_voltage(voltage))
    return state


def _measured(flight: Flight) -> Float[Array, "drones 9"]:
    return jnp.concatenate([flight.pos, flight.vel, quat_to_rpy(flight.quat)], axis=-1)


def _at(
    track: Float[Array, "steps drones 9"], place: Float[Array, "drones nodes"]
) -> Float[Array, "drones nodes 9"]:
    """The track between its steps, linearly."""
    low = jnp.clip(jnp.floor(place), 0, len(track) - 2).astype(int)
    part = (place - low)[..., None]
    drone = jnp.arange(track.shape[1])[:, None]
    before, after = track[low, drone], track[low + 1, drone]
    change = after - before
    turn = change[..., 8:]
    turn = turn - 2 * jnp.pi * jnp.round(turn / (2 * jnp.pi))
    return before + part * jnp.concatenate([change[..., :8], turn], axis=-1)


def make_replay(library: Library, dt: float, measured: int = 0) -> Replay:
    """The replay of `library` with integration steps of `dt` [s].

    Raises:
        ValueError: The window is no whole number of steps.
    """
    if abs(REPLAY_WINDOW_S / dt - round(REPLAY_WINDOW_S / dt)) > 1e-6:
        raise ValueError(f"`dt` must divide {REPLAY_WINDOW_S} s, got {dt}.")
    return Replay(library=library, dt=dt, measured=measured)
