r"""Turbulence: gusts by Dryden's spectra at low altitude, the same for all drones of a team.

Air that moves at w pushes a drone as linear drag does, f = m c w. The mean wind V blows along world
x and carries the turbulence past the drones, which count as hovering in it:

    u (x):       H_u(s) = s_u sqrt(2 L_u / (pi V)) / (1 + T_u s)                       T_u = L_u / V
    v (y), w (z): H(s)  = s sqrt(L / (pi V)) (1 + sqrt(3) T s) / (1 + T s)^2            T = L / V

At the height h [ft] above ground, from 10 to 1000 ft, and with the wind V at 20 ft:

    L_w = h,  L_u = L_v = h / (0.177 + 0.000823 h)^1.2         scale lengths [ft]
    s_w = 0.1 V,  s_u = s_v = s_w / (0.177 + 0.000823 h)^0.4   intensities [m/s]

Teams fly below 10 ft, for which the specification says nothing; its lowest height is taken.

Steps of dt are exact: with r = dt / T and independent standard normal n, and e = exp(-r),

    u'      = e u + sqrt(1 - e^2) n                               u = s_u times that
    (x, y)' = e [[1 + r, r], [-r, 1 - r]] (x, y) + chol(Q) n      v = s (x + sqrt(3) y) / 2

where y = T dx/dt and Q = 1 - (transition) (transition)' keeps the stationary covariance 1, from
which every flight starts. Q_xx is 4/3 r^3 for small r, far below rounding of the difference that it
is; it is summed as the power series of e^2 (exp(2 r) - 1 - 2 r - 2 r^2).

Source: MIL-F-8785C (1980), Sec. 3.7.2 (spectra) and 3.7.3.4 (low altitude).
"""

import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, UInt

from simulators.effects.card import EffectCard, Shown
from simulators.effects.contract import Number, RandomEffect, WrenchEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle

HEIGHT_FT = 10.0
"""Height for which lengths and intensities are taken [ft]."""
FOOT = 0.3048
"""Metres per foot."""
_SHAPE = 0.177 + 0.000823 * HEIGHT_FT
LENGTHS = (FOOT * HEIGHT_FT / _SHAPE**1.2, FOOT * HEIGHT_FT / _SHAPE**1.2, FOOT * HEIGHT_FT)
"""Scale lengths of u, v and w [m]."""
INTENSITIES = (0.1 / _SHAPE**0.4, 0.1 / _SHAPE**0.4, 0.1)
"""Standard deviations of u, v and w over the wind at 20 ft [-]."""
_TERMS = 12


class Air(eqx.Module):
    """The gusts now, over their standard deviations."""

    along: Float[Array, ""]
    """u."""
    across: Float[Array, "2 2"]
    """x and y of v, then of w."""
    random: UInt[Array, " words"]
    """Data of the key of the next draws."""


class Turbulence(WrenchEffect, RandomEffect):
    """Gusts in a mean wind, whose own steady push is the effect `wind`. Source: MIL-F-8785C."""

    wind: Number = parameter("m/s", 0.0, 15.0, source="MIL-F-8785C: light is 7.7")
    """Mean wind at 20 ft, which carries and scales the turbulence [m/s]."""
    response: Number = parameter(
        "1/s",
        0.0,
        2.0,
        0.4,
        source="linear drag in real logs of small quadrotors 0.33 to 0.44; the bounds a guess",
    )
    """Specific force of air that moves at 1 m/s [1/s]; without effect while there is no wind."""

    order: ClassVar[int] = 2
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="turbulence",
        noun="turbulence",
        physics="The air moves at random, with the spectrum of gusts near the ground.",
        shown={"wind": Shown("mean wind"), "response": Shown("push per speed")},
        no_candidate="its gusts are drawn anew in every flight; no slope tells which they were",
    )

    def init(self, n_drones: int, dt: float) -> Air:
        return self._stationary(jax.random.key(0))

    def seeded(self, memory: Air, key: PRNGKeyArray) -> Air:
        return self._stationary(key)

    def wrench(
        self, memory: Air, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[Air, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        after = self._step(memory, dt)
        gust = self.wind * jnp.asarray(INTENSITIES) * _velocities(after)
        force = vehicle.believed_mass * self.response * gust
        return after, jnp.broadcast_to(force, flight.pos.shape), jnp.zeros_like(flight.pos)

    def _stationary(self, key: PRNGKeyArray) -> Air:
        key, draw_key = jax.random.split(key)
        drawn = jax.random.normal(draw_key, (5,))
        return Air(drawn[0], drawn[1:].reshape(2, 2), jax.random.key_data(key))

    def _step(self, air: Air, dt: float) -> Air:
        key, draw_key = jax.random.split(jax.random.wrap_key_data(air.random))
        drawn = jax.random.normal(draw_key, (5,))
        r = self.wind * dt / jnp.asarray(LENGTHS)
        # Without wind the air stands; the root has no slope there.
        along = jnp.exp(-r[0]) * air.along + _root(-jnp.expm1(-2.0 * r[0])) * drawn[0]
        r, (x, y), e = r[1:], air.across.T, jnp.exp(-r[1:])
        first, second = drawn[1:].reshape(2, 2)
        xx, xy, yy = innovation(r)
        to_y = _root(yy)
        to_x = xy / jnp.where(to_y > 0.0, to_y, 1.0)
        new_x = e * ((1.0 + r) * x + r * y) + to_x * first + _root(xx - to_x**2) * second
        new_y = e * ((1.0 - r) * y - r * x) + to_y * first
        return Air(along, jnp.stack([new_x, new_y], axis=1), jax.random.key_data(key))


def innovation(
    r: Float[Array, "*n"],
) -> tuple[Float[Array, "*n"], Float[Array, "*n"], Float[Array, "*n"]]:
    """Covariance that a step of r = dt / T adds to (x, y): its xx, xy and yy."""
    e2 = jnp.exp(-2.0 * r)
    series = sum((2.0 * r) ** k / float(math.factorial(k)) for k in range(3, 3 + _TERMS))
    direct = jnp.exp(2.0 * jnp.minimum(r, 30.0)) - 1.0 - 2.0 * r - 2.0 * r**2
    xx = e2 * jnp.where(r < 1.0, series, direct)
    return xx, 2.0 * r**2 * e2, -jnp.expm1(-2.0 * r) + e2 * (2.0 * r - 2.0 * r**2)


def _velocities(air: Air) -> Float[Array, " 3"]:
    """u, v and w over their standard deviations."""
    across = 0.5 * (air.across[:, 0] + math.sqrt(3.0) * air.across[:, 1])
    return jnp.concatenate([air.along[None], across])


def _root(square: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Its square root; 0, with a slope of 0, where it is not above 0."""
    return jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)
