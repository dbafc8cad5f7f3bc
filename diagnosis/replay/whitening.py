"""Whitened residuals without what the start of a window, which nobody knows, may explain."""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.logs.segments import DOUBT, REPLAY_WINDOW_S

TURN = np.asarray([0.02] * 3 + [0.5] * 3 + [0.05] * 4)
"""Errors of a fitted attitude [rad], of angular velocity [rad/s] and of rotor speeds [-] with a
drone in any motion; wide, so that a window says of its own start what it can."""

SHOWN = round(DOUBT / REPLAY_WINDOW_S)
"""Windows in which what a fresh start was off may still show: as long as a command that was unknown
may. With slow rotors the attitude rings."""


def unit(x: np.ndarray) -> np.ndarray:
    """`x` with length one over (position/velocity, nodes), or zero where it vanishes."""
    norm = np.sqrt(np.sum(x**2, axis=(0, 4), keepdims=True))
    return np.divide(x, norm, out=np.zeros_like(x), where=norm > 0)


def projected(x: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """`x` (leading, segments, windows, drones, nodes, 9) without its part along `basis`."""
    pos, vel = x[..., :3], x[..., 3:6]
    for unit in basis:
        along = np.sum(unit[0] * pos + unit[1] * vel, axis=-2, keepdims=True)
        pos, vel = pos - along * unit[0], vel - along * unit[1]
    return np.concatenate([pos, vel, x[..., 6:]], axis=-1)


@dataclasses.dataclass(frozen=True)
class Turns:
    """What errors of fresh starts take from a batch of windows."""

    turned: Bool[np.ndarray, "segments windows drones"]
    """Where a measured attitude still shows."""
    along: Float[np.ndarray, "lines numbers errors"]
    """Orthonormal directions of those windows."""
    less: Float[np.ndarray, "lines errors"]
    """Share that each direction loses."""
    spent: Float[np.ndarray, "segments windows drones"]
    """How many numbers that takes of each window."""

    def taken(self, x: Float[np.ndarray, "k segments windows drones nodes 9"]) -> np.ndarray:
        """`x`, in place, multiplied by (I + A A')^(-1/2)."""
        lines = x[:, self.turned]
        flat = np.moveaxis(lines, 0, -1).reshape(*self.along.shape[:2], len(x))
        flat = flat - self.along @ (self.less[..., None] * (self.along.swapaxes(1, 2) @ flat))
        x[:, self.turned] = np.moveaxis(flat.reshape(*lines.shape[1:], len(x)), -1, 0)
        return x


def shaken(
    t: Float[np.ndarray, "*n nodes 1"], seconds: float, noise: float
) -> Float[np.ndarray, "6 *n nodes 9"]:
    """What white noise of the acceleration along x and y does within a window.

    `t` is the time since its start [s], `seconds` its length, `noise` the standard deviation of
    its mean acceleration [m/s^2]. The noise is taken along the first three Legendre polynomials,
    which are independent; velocities [m/s] and positions [m] are their integrals.
    """
    s = t[..., 0] / seconds
    vel = [s, np.sqrt(3.0) * (s**2 - s), np.sqrt(5.0) * (2.0 * s**3 - 3.0 * s**2 + s)]
    pos = [
        s**2 / 2.0,
        np.sqrt(3.0) * (s**3 / 3.0 - s**2 / 2.0),
        np.sqrt(5.0) * (s**4 / 2.0 - s**3 + s**2 / 2.0),
    ]
    columns = np.zeros((6, *s.shape, 9))
    for i, axis in itertools.product(range(3), range(2)):
        columns[2 * i + axis, ..., axis] = noise * seconds**2 * pos[i]
        columns[2 * i + axis, ..., 3 + axis] = noise * seconds * vel[i]
    return columns


def shown(fresh: Bool[np.ndarray, "segments windows *drones"]) -> Bool[np.ndarray, "..."]:
    """Scored windows, all but the first, that begin `fresh` or less than `SHOWN` after one."""
    late = fresh[:, 1:].copy()
    for ago in range(1, SHOWN):
        late[:, ago - 1 :] |= fresh[:, :-ago]
    return late


def make_turns(
    A: Float[np.ndarray, "errors lines nodes 9"], turned: Bool[np.ndarray, "..."]
) -> Turns:
    """What errors take from the windows at which `turned`; `A` is what each does, one sigma."""
    columns = np.moveaxis(A, 0, -1)
    columns = columns.reshape(len(columns), A.shape[2] * A.shape[3], len(A))
    # A window that cannot be flown at that vector may be at another: its attitude is believed.
    columns = np.where(np.isfinite(columns).all(axis=(1, 2), keepdims=True), columns, 0.0)
    squares, vectors = np.linalg.eigh(columns.swapaxes(1, 2) @ columns)
    squares = np.clip(squares, 1e-12, None)
    along = columns @ (vectors / np.sqrt(squares)[:, None, :])
    spent = np.zeros(turned.shape)
    spent[turned] = np.sum(squares / (1.0 + squares), axis=1)
    return Turns(turned, along, 1.0 - 1.0 / np.sqrt(1.0 + squares), spent)


def residual(
    row: Float[np.ndarray, "*n 9"], value: Float[np.ndarray, "*n 9"]
) -> Float[np.ndarray, "*n 9"]:
    """Measured minus predicted, angles within +-pi."""
    difference = row - np.asarray(value, float)
    angles = (difference[..., 6:] + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([difference[..., :6], angles], axis=-1)
