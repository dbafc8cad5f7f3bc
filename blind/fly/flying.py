"""Flies blind cases: one compiled program for all cases with as many drones and flights.

The position controller is the generator's own and flies on the noisy estimates that are logged:

    a = a* + k_p (p* - p) + k_d (v* - v) + k_i int (p* - p) dt + g e_z,  thrust = m |a|,

roll and pitch turn the body axis along a at the measured heading; `dither` is added to the command.
It acts at every 9th, 10th or 11th physics step of 2 ms at random; a row is logged where it acts.
"""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from blind.fly import realities
from blind.fly.realities import DT, HOVER, MASS, AbstractReality, Disturbance
from blind.fly.references import TrackedPath
from diagnosis.logs.columns import GROUPS
from simulators.vehicle import GRAVITY

CHUNK = 5000
"""Physics steps that one call of the compiled program flies."""
DROPPED = 0.02
"""Share of the rows that a log lacks here and there."""
_KP = np.asarray([7.0, 7.0, 12.0], np.float32)
_KD = np.asarray([4.5, 4.5, 6.0], np.float32)
_KI = np.asarray([4.0, 4.0, 12.0], np.float32)
_STEEPEST = 0.6
"""Largest horizontal over vertical acceleration that the controller asks for."""


@dataclasses.dataclass(frozen=True)
class Noise:
    """Standard deviations of white errors of the estimates that are flown on and logged."""

    pos: float = 1e-3
    """Position [m]."""
    vel: float = 1e-2
    """Velocity [m/s]."""
    attitude: float = 3e-3
    """Rotation about each body axis [rad]."""
    ang_vel: float = 2e-2
    """Angular velocity [rad/s]."""

    def scaled(self, factor: float) -> "Noise":
        """All of them times `factor`."""
        return Noise(*(factor * value for value in dataclasses.astuple(self)))

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Errors of position, velocity, attitude and angular velocity, side by side."""
        sizes = np.repeat(dataclasses.astuple(self), 3)
        return (sizes * rng.standard_normal((*shape, 12))).astype(np.float32)


class _Inputs(eqx.Module):
    """What the program is told at each physics step of one flight."""

    tick: Array
    """Whether the controller acts."""
    target: Array
    """`TrackedPath`, side by side."""
    noise: Array
    """Errors of the estimates."""


@dataclasses.dataclass(frozen=True)
class Flown:
    """One flight: what is logged, and what was true at the same instants."""

    logged: pd.DataFrame
    """Columns of the log format, from the noisy estimates."""
    true: pd.DataFrame
    """The same rows and commands, without noise."""


def fly(
    reality: str,
    disturbance: Disturbance,
    references: list[list[TrackedPath]],
    noise: Noise,
    rng: np.random.Generator,
) -> list[Flown]:
    """All flights of a case; `references` by flight and drone, all equally long.

    The parameters of `disturbance` have a leading axis of flights. Every row is there; see
    `drop_rows`.

    Raises:
        ValueError: There is no such `reality`.
    """
    n_steps = len(references[0][0].yaw)
    padded = -(-n_steps // CHUNK) * CHUNK
    ticks = np.stack([_ticks(n_steps, padded, rng) for _ in references])
    targets = np.stack([[_target(ref, padded) for ref in drones] for drones in references])
    noises = noise.draw(rng, (len(references), len(references[0]), padded))
    inputs = _Inputs(*map(jnp.asarray, (ticks, targets.swapaxes(1, 2), noises.swapaxes(1, 2))))
    begin, run = _program(reality)
    carry = begin(disturbance, inputs.target[:, 0])
    parts = []
    for start in range(0, padded, CHUNK):
        chunk = jax.tree.map(lambda x, s=start: x[:, s : s + CHUNK], inputs)
        carry, rows = run(disturbance, carry, chunk)
        parts.append(jax.tree.map(np.asarray, rows))
    rows = jax.tree.map(lambda *xs: np.concatenate(xs, axis=1), *parts)
    return [
        _flown(np.flatnonzero(ticks[i]), jax.tree.map(lambda x, i=i: x[i], rows))
        for i in range(len(references))
    ]


def drop_rows(flown: Flown, rng: np.random.Generator) -> Flown:
    """The flight without `DROPPED` of its rows and without up to two stretches of 0.1 to 0.4 s."""
    times = np.unique(flown.logged["t"].to_numpy())
    kept = rng.random(len(times)) >= DROPPED
    for _ in range(rng.integers(0, 3)):
        start = rng.uniform(times[0] + 0.5, times[-1] - 0.5)
        kept &= ~((times >= start) & (times < start + rng.uniform(0.1, 0.4)))
    rows = np.flatnonzero(np.isin(flown.logged["t"].to_numpy(), times[kept]))
    return Flown(*(t.iloc[rows].reset_index(drop=True) for t in (flown.logged, flown.true)))


def _ticks(n_steps: int, padded: int, rng: np.random.Generator) -> np.ndarray:
    """Where the controller acts: every 18, 20 or 22 ms, the first time at once."""
    at = np.concatenate([[0], np.cumsum(rng.integers(9, 12, n_steps // 9 + 1))])
    ticks = np.zeros(padded, bool)
    ticks[at[at < n_steps]] = True
    return ticks


def _target(reference: TrackedPath, padded: int) -> np.ndarray:
    parts = [reference.pos, reference.vel, reference.acc, reference.yaw[:, None], reference.dither]
    target = np.concatenate(parts, axis=1)
    return np.pad(target, ((0, padded - len(target)), (0, 0)), mode="edge").astype(np.float32)


def control(
    target: Float[Array, "drones 14"], estimate: Float[Array, "drones 13"], integral: Array
) -> tuple[Float[Array, "drones 4"], Array]:
    """Roll, pitch, yaw [rad], thrust [N], and the integral for the next time (20 ms later)."""
    pos, vel, acc, yaw, dither = jnp.split(target, [3, 6, 9, 10], axis=1)
    error = pos - estimate[:, :3]
    x, y, z, w = estimate[:, 6:10].T
    heading = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    wanted = acc + _KP * error + _KD * (vel - estimate[:, 3:6]) + _KI * integral
    up = jnp.maximum(wanted[:, 2] + GRAVITY, 0.3 * GRAVITY)
    flat = jnp.linalg.norm(wanted[:, :2], axis=1) + 1e-9
    shrunk = jnp.minimum(1.0, _STEEPEST * up / flat)
    ax, ay = wanted[:, 0] * shrunk, wanted[:, 1] * shrunk
    forward = jnp.cos(heading) * ax + jnp.sin(heading) * ay
    left = jnp.cos(heading) * ay - jnp.sin(heading) * ax
    size = jnp.sqrt(forward**2 + left**2 + up**2)
    roll, pitch = jnp.arcsin(-left / size), jnp.arctan2(forward, up)
    angles = jnp.stack([roll, pitch, yaw[:, 0]], axis=1) + dither[:, :3]
    thrust = jnp.clip(MASS * size + HOVER * dither[:, 3], 0.1, 0.78)
    integral = jnp.clip(integral + 0.02 * error, -1.0, 1.0)
    return jnp.concatenate([angles, thrust[:, None]], axis=1), integral


def disturbed_estimate(
    truth: Float[Array, "drones 13"], noise: Float[Array, "drones 12"]
) -> Float[Array, "drones 13"]:
    """Position, velocity, quaternion and angular velocity with errors added."""
    half = 0.5 * noise[:, 6:9]
    turn = jnp.concatenate([half, jnp.sqrt(1.0 - jnp.sum(half**2, axis=1, keepdims=True))], axis=1)
    quat = truth[:, 6:10]
    a, b, s, r = quat[:, :3], turn[:, :3], quat[:, 3:], turn[:, 3:]
    turned = jnp.concatenate(
        [s * b + r * a + jnp.cross(a, b), s * r - jnp.sum(a * b, axis=1, keepdims=True)], axis=1
    )
    pos_vel = truth[:, :6] + noise[:, :6]
    return jnp.concatenate([pos_vel, turned, truth[:, 10:] + noise[:, 9:]], axis=1)


@functools.cache
def _program(name: str) -> tuple[Any, Any]:
    """Start and flight, compiled once per number of flights and drones."""
    reality: AbstractReality = realities.load(name)

    def start(disturbance: Disturbance, target: Array) -> tuple:
        cmd = jnp.zeros((len(target), 4)).at[:, 3].set(HOVER)
        return reality.start(disturbance, target[:, :3]), cmd, jnp.zeros((len(target), 3))

    def run(disturbance: Disturbance, carry: tuple, inputs: _Inputs) -> tuple:
        def step(carry: tuple, now: _Inputs) -> tuple:
            state, cmd, integral = carry
            truth = reality.truth(state)
            estimate = disturbed_estimate(truth, now.noise)
            new, summed = control(now.target, estimate, integral)
            cmd = jnp.where(now.tick, new, cmd)
            integral = jnp.where(now.tick, summed, integral)
            return (reality.step(disturbance, state, cmd), cmd, integral), (truth, estimate, cmd)

        return jax.lax.scan(step, carry, inputs)

    return jax.jit(jax.vmap(start)), jax.jit(jax.vmap(run))


def _flown(at: np.ndarray, rows: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Flown:
    truth, estimate, cmd = (x[at].astype(np.float64) for x in rows)
    return Flown(to_frame(at * DT, estimate, cmd), to_frame(at * DT, truth, cmd))


def to_frame(
    t: Float[np.ndarray, " rows"],
    states: Float[np.ndarray, "rows drones 13"],
    cmds: Float[np.ndarray, "rows drones 4"],
) -> pd.DataFrame:
    """A table in the log format; a column `drone` only where several fly."""
    frames = []
    for i in range(states.shape[1]):
        values = np.concatenate([states[:, i], cmds[:, i]], axis=1)
        frame = pd.DataFrame(values, columns=COLUMNS)
        frame.insert(0, "t", t)
        if states.shape[1] > 1:
            frame.insert(1, "drone", i)
        frames.append(frame)
    return pd.concat(frames, ignore_index=True)


COLUMNS = [name for group in ("pos", "vel", "quat", "ang_vel", "cmd") for name in GROUPS[group]]
"""State and command columns of the log format, in order."""
