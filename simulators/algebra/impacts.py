r"""Forces between balls that touch, and between balls and the floor.

With x the place, v the velocity and w the angular velocity of a ball, n the direction from the
other ball j to the ball i, and m = 1 / (1/m_i + 1/m_j) the pair's reduced mass:

    g   = 2 r - |x_i - x_j|,    g' = -n . (v_i - v_j)                     depth and its rate
    f_n = k g^(3/2) (1 + c g')_+                                          Hunt and Crossley
    a   = r - g / 2                                                       arm of friction
    u   = v_i - v_j + g' n - a (w_i + w_j) x n                            slip
    f_t = -mu f_n u / sqrt(|u|^2 + s^2)
    F_i = f_n n + f_t,    T_i = -a n x f_t

The damping grows with the depth, so that the force starts from zero at touch and depends on the
impact's time smoothly: with a damper that acts in full at touch, derivatives are wrong at any step
size (`docs/contact.md`).

An impact of rate V ends at rate e V, for every k and m, where

    c V - ln(1 + c V) + c e V + ln(1 - c e V) = 0.

| symbol | name | unit |
|---|---|---|
| r | `radius` | m |
| k | `stiffness` | N/m^1.5 |
| c | `damping` | s/m |
| mu | `friction` | - |
| s | `SLIP` | m/s |

Both balls meet friction at the middle between their centres, so that angular momentum is kept. The
floor is a plane at z = 0 that a ball of radius `clearance` around the drone's centre touches; below
the floor the depth stays that at the floor.

Steps: half a step along the velocity, the whole change of velocity, half a step along the new one
(leapfrog). Damping and friction are those in the middle and at the end of the change, as if each
pair were alone; so friction stops a slip but never turns it round.

Sources: Hunt and Crossley (1975), "Coefficient of restitution interpreted as damping in
vibroimpact"; the exponent is that of Hertz (1881).
"""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from simulators.algebra import sweep

SLIP = 0.05
"""Slip at which friction has 71 % of its full strength [m/s]; a guess."""
REFERENCE_RATE = 1.0
"""Rate of the impact of which `damping_of` is given the restitution [m/s]."""
LEAST_RESTITUTION = 0.1
"""Smallest restitution that `damping_of` knows [-]."""
LONGEST_STEP = 0.002
"""Longest step with which an impact is followed [s]. At k = 2,000 N/m^1.5 and 1 m/s two drones of
43 g touch for 33 ms."""
MANY = 64
"""Team size from which on close pairs are found by sweeps on a processor; a guess, not measured."""
NEIGHBOURS = 12
"""Most others that a drone of such a team touches: as many balls as fit around one."""

_Vector = list[Array]
"""Components along x, y and z apart: joined to one array, they would not be compiled into one
loop."""
Law = Callable[[Array, Array, Array, float], Array]
"""Force [N] of depth [m, 0 where nothing touches], its rate [m/s], inverse reduced mass [1/kg] and
step [s]."""


class Surface(eqx.Module):
    """What balls are made of."""

    radius: Float[Array, ""]
    """Radius towards other balls [m]."""
    clearance: Float[Array, ""]
    """Radius towards the floor [m]."""
    stiffness: Float[Array, ""]
    """Force at a depth of 1 m [N/m^1.5]."""
    damping: Float[Array, ""]
    """Increase of the force by the rate of depth [s/m]."""
    friction: Float[Array, ""]
    """Friction over the normal force [-]."""

    def hunt_crossley(self, depth: Array, rate: Array, inverse_mass: Array, step: float) -> Array:
        """The normal force, with the rate in the middle of the step."""
        deep = depth > 0.0
        safe = jnp.where(deep, depth, 1.0)
        spring = jnp.where(deep, self.stiffness * safe * jnp.sqrt(safe), 0.0)
        ahead = 0.5 * step * self.damping * spring * inverse_mass
        return jnp.maximum(spring * (1.0 + self.damping * rate) / (1.0 + ahead), 0.0)


class Balls(eqx.Module):
    """A team of balls at one instant, world frame."""

    pos: Float[Array, "3 drones"]
    """Centre [m]."""
    vel: Float[Array, "3 drones"]
    """Velocity [m/s]."""
    ang_vel: Float[Array, "3 drones"]
    """Angular velocity [rad/s]."""
    inverse_mass: Float[Array, " drones"]
    """1 / mass [1/kg]."""
    inverse_inertia: Float[Array, "3 3 drones"]
    """Inverse moment of inertia [1/(kg m^2)]."""


def push(
    balls: Balls, surface: Surface, dt: float, law: Law | None = None
) -> tuple[Float[Array, "3 drones"], Float[Array, "3 drones"]]:
    """Mean force [N] and torque [N m] of all contacts over `dt` [s] from now on.

    In equal steps of at most `LONGEST_STEP`, in which nothing else acts. `law` stands in the place
    of Hunt and Crossley's.
    """
    law, n_steps = law or surface.hunt_crossley, math.ceil(dt / LONGEST_STEP - 1e-9)
    step = dt / n_steps
    others = _others(balls.pos, surface.radius)

    def once(balls: Balls, _: None) -> tuple[Balls, tuple[Array, Array]]:
        balls = eqx.tree_at(lambda b: b.pos, balls, balls.pos + 0.5 * step * balls.vel)
        force, torque = _touched(balls, surface, others, step, law)
        vel = balls.vel + step * balls.inverse_mass * force
        turning = step * jnp.sum(balls.inverse_inertia * torque, axis=1)
        after = (balls.pos + 0.5 * step * vel, vel, balls.ang_vel + turning)
        balls = eqx.tree_at(lambda b: (b.pos, b.vel, b.ang_vel), balls, after)
        return balls, (force, torque)

    if n_steps == 1:
        return once(balls, None)[1]
    _, sums = jax.lax.scan(once, balls, None, length=n_steps)
    return jnp.mean(sums[0], axis=0), jnp.mean(sums[1], axis=0)


def _others(
    pos: Float[Array, "3 drones"], radius: Float[Array, ""]
) -> Int[Array, "drones others"] | None:
    """Indices of the balls that each ball may touch, its own where unused; None: all."""
    n = pos.shape[1]
    if n < MANY or jax.default_backend() != "cpu":
        return None
    # A quarter more than touch now: balls move during the step.
    pos, radius = jax.lax.stop_gradient((pos, radius))
    return sweep.within(pos.T, 2.5 * radius, NEIGHBOURS)


def _touched(
    balls: Balls,
    surface: Surface,
    others: Int[Array, "drones others"] | None,
    step: float,
    law: Law,
) -> tuple[Float[Array, "3 drones"], Float[Array, "3 drones"]]:
    """Force [N] and torque [N m] of all contacts in the middle of a step."""
    n, radius, clearance = balls.pos.shape[1], surface.radius, surface.clearance
    there = (lambda x: x[None, :]) if others is None else (lambda x: x[others])
    add = lambda x: x[:, None] + there(x)  # noqa: E731
    apart, vel = ([x[:, None] - there(x) for x in v] for v in (balls.pos, balls.vel))
    itself = jnp.eye(n, dtype=bool) if others is None else others == jnp.arange(n)[:, None]
    square = _dot(apart, apart)
    touching = (square < (2.0 * radius) ** 2) & ~itself
    distance = jnp.sqrt(jnp.where(touching, jnp.maximum(square, 1e-12), 1.0))
    depth = jnp.where(touching, 2.0 * radius - distance, 0.0)
    normal = [x / distance for x in apart]
    inverse, turns = balls.inverse_mass, jnp.trace(balls.inverse_inertia)
    mobility = add(inverse), add(inverse + radius**2 * turns)
    arm = 0.5 * (2.0 * radius - depth)
    lever = [arm * add(w) for w in balls.ang_vel]
    force, turning = _contact(normal, depth, vel, lever, mobility, surface, step, law)
    turning = [arm * x for x in turning]

    up = [jnp.asarray(x, balls.pos.dtype) for x in (0.0, 0.0, 1.0)]
    depth = jnp.maximum(clearance - jnp.maximum(balls.pos[2], 0.0), 0.0)
    lever = [(clearance - depth) * w for w in balls.ang_vel]
    mobility = inverse, inverse + clearance**2 * turns
    held, rolling = _contact(up, depth, list(balls.vel), lever, mobility, surface, step, law)
    rolling = [(clearance - depth) * x for x in rolling]

    def total(pairs: _Vector, floor: _Vector) -> Float[Array, "3 drones"]:
        return jnp.stack([jnp.sum(x, axis=-1) + y for x, y in zip(pairs, floor, strict=True)])

    return total(force, held), total(turning, rolling)


def _contact(
    normal: _Vector,
    depth: Float[Array, "*n"],
    vel: _Vector,
    lever: _Vector,
    mobility: tuple[Float[Array, "*n"], Float[Array, "*n"]],
    surface: Surface,
    step: float,
    law: Law,
) -> tuple[_Vector, _Vector]:
    """Force [N] on the first of two balls, and the torque over the arm of friction [N].

    `lever` is the sum of the angular velocities times that arm [m/s], `mobility` the inverse
    masses [1/kg] against which the normal force and, at most, friction works.
    """
    along = _dot(normal, vel)
    size = law(depth, -along, mobility[0], step)
    rolling = _cross(lever, normal)
    slip = [v - along * x - w for v, x, w in zip(vel, normal, rolling, strict=True)]
    limit = surface.friction * size
    speed = jnp.sqrt(_dot(slip, slip) + SLIP**2)
    hold = limit / (speed + step * limit * mobility[1])
    friction = [-hold * x for x in slip]
    force = [size * x + f for x, f in zip(normal, friction, strict=True)]
    return force, _cross(friction, normal)


def _dot(a: _Vector, b: _Vector) -> Float[Array, "*n"]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]


def damping_of(restitution: Float[Array, ""]) -> Float[Array, ""]:
    """Damping [s/m] with which an impact of `REFERENCE_RATE` keeps the share `restitution` [-].

    c V = (1 - e) / e q(e), q a polynomial that fits the law at the top of this module to 2e-5
    between `LEAST_RESTITUTION` and 1.
    """
    place, value = _place(restitution), jnp.zeros_like(restitution)
    for coefficient in _COEFFICIENTS[::-1]:
        value = value * place + coefficient
    return (1.0 - restitution) / restitution * value / REFERENCE_RATE


def _place(restitution: Array) -> Array:
    """-1 at the least restitution, 1 at 1."""
    return (2.0 * restitution - 1.0 - LEAST_RESTITUTION) / (1.0 - LEAST_RESTITUTION)


def _fitted() -> list[float]:
    """Coefficients of q; the law has a closed form by L = ln((1 + c V) / (1 - c e V))."""
    L = np.linspace(0.01, 12.0, 4000)
    above, below = np.expm1(L) - L, L * np.exp(L) - np.expm1(L)
    restitution, damping = above / below, below / np.expm1(L)
    inside = restitution > 0.9 * LEAST_RESTITUTION
    e = np.concatenate([[1.0], restitution[inside]])
    q = np.concatenate([[1.5], (damping * restitution / (1.0 - restitution))[inside]])
    fit = np.polynomial.Chebyshev.fit(e, q, 12, domain=[LEAST_RESTITUTION, 1.0])
    return np.polynomial.chebyshev.cheb2poly(fit.coef).tolist()


_COEFFICIENTS = _fitted()
