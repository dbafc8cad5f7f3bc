r"""What drones see of themselves: noise, latency with jitter, and observations that are lost.

At every control step k each drone measures its state of a moment ago and keeps what it has if the
measurement is lost:

    age   a_k = clip(latency + jitter u_k, 0, LONGEST_AGE_S),   u_k uniform in [-1, 1)
    seen  y_k = x(t_k - a_k) + noise     with probability 1 - loss
          y_k = y_(k-1)                  otherwise

x is linear between control steps. Noise is white and normal, along each axis: on position, on
velocity, and an angle about each body axis that turns the attitude. Controllers get y, and so do
neighbours, to which every drone tells what it believes; rewards, contacts and logs are those of
the true flight. The draws of a drone are its own, and the same key gives the same ones.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, UInt

from simulators.effects.contract import AbstractEffect, Number, parameter
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT

LONGEST_AGE_S = 0.06
"""Longest age of an observation [s]."""
_SAMPLES = round(LONGEST_AGE_S / CONTROL_DT) + 1


class Sight(eqx.Module):
    """What sensing remembers; each row is position, velocity and attitude of a drone."""

    past: Float[Array, "samples drones 10"]
    """The last true states, `CONTROL_DT` apart, newest first."""
    seen: Float[Array, "drones 10"]
    """What each drone believes now."""
    random: UInt[Array, " words"]
    """Data of the key of the next draws."""


class Sensing(AbstractEffect):
    """Source: noise as of motion capture and of an onboard estimate, radio links; see the bounds.

    It is part of a reality like an effect, but acts on what is seen and not on the flight, so that
    no flight log can show it and no diagnosis considers it.
    """

    pos: Number = parameter("m", 0.0, 0.2, source="motion capture 0.001, UWB 0.1")
    """Standard deviation of the noise on position [m]."""
    vel: Number = parameter("m/s", 0.0, 0.5, source="a guess")
    """That on velocity [m/s]."""
    angle: Number = parameter("rad", 0.0, 0.2, source="a guess")
    """That on the attitude, about each body axis [rad]."""
    latency: Number = parameter("s", 0.0, LONGEST_AGE_S, source="published 0 to 60 ms")
    """Mean age of an observation [s]."""
    jitter: Number = parameter("s", 0.0, LONGEST_AGE_S, source="of the latency's size; a guess")
    """Largest deviation from that age [s]."""
    loss: Number = parameter("-", 0.0, 0.9, source="a guess")
    """Share of observations that are lost [-]."""

    door: ClassVar[str] = "sensing"
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> Sight:
        """An empty memory; `begin` makes that of a flight."""
        rows = jnp.zeros((n_drones, 10))
        random = jax.random.key_data(jax.random.key(0))
        return Sight(jnp.zeros((_SAMPLES, n_drones, 10)), rows, random)

    def begin(self, flight: Flight, key: PRNGKeyArray) -> Sight:
        """The memory at reset: all drones have stood where they are, and know it."""
        now = _rows(flight)
        past = jnp.broadcast_to(now, (_SAMPLES, *now.shape))
        return Sight(past, now, jax.random.key_data(key))

    def sense(self, memory: Sight, flight: Flight) -> Sight:
        """The memory one control step later, at the true `flight`."""
        keys = jax.random.split(jax.random.wrap_key_data(memory.random), 4)
        past = jnp.concatenate([_rows(flight)[None], memory.past[:-1]])
        n_drones = past.shape[1]
        shake = self.jitter * jax.random.uniform(keys[1], (n_drones,), minval=-1.0)
        age = jnp.clip(self.latency + shake, 0.0, LONGEST_AGE_S) / CONTROL_DT
        newer = jnp.clip(jnp.floor(age), 0, _SAMPLES - 2).astype(int)
        part, drones = (age - newer)[:, None], jnp.arange(n_drones)
        rows = (1.0 - part) * past[newer, drones] + part * past[newer + 1, drones]
        measured = self._noisy(rows, jax.random.normal(keys[2], (n_drones, 9)))
        lost = jax.random.uniform(keys[3], (n_drones,)) < self.loss
        seen = jnp.where(lost[:, None], memory.seen, measured)
        return Sight(past, seen, jax.random.key_data(keys[0]))

    def seen(self, memory: Sight, flight: Flight) -> Flight:
        """`flight` as the drones' own estimates show it."""
        pos, vel, quat = jnp.split(memory.seen, (3, 6), axis=1)
        return eqx.tree_at(lambda f: (f.pos, f.vel, f.quat), flight, (pos, vel, quat))

    def _noisy(
        self, rows: Float[Array, "drones 10"], noise: Float[Array, "drones 9"]
    ) -> Float[Array, "drones 10"]:
        (pos, vel, vector), real = jnp.split(rows[:, :9], 3, axis=1), rows[:, 9:]
        on_pos, on_vel, turn = jnp.split(noise, 3, axis=1)
        pos = pos + jnp.expand_dims(self.pos, -1) * on_pos
        vel = vel + jnp.expand_dims(self.vel, -1) * on_vel
        half = 0.5 * jnp.expand_dims(self.angle, -1) * turn  # a small rotation is (half, 1)
        turned = vector + real * half + jnp.cross(vector, half)
        quat = jnp.concatenate([turned, real - jnp.sum(vector * half, axis=1, keepdims=True)], 1)
        return jnp.concatenate([pos, vel, quat / jnp.linalg.norm(quat, axis=1, keepdims=True)], 1)


def _rows(flight: Flight) -> Float[Array, "drones 10"]:
    return jnp.concatenate([flight.pos, flight.vel, flight.quat], axis=1)
