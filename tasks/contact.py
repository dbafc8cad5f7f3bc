r"""Contact, crashes and the collision penalty; the same rule for both fidelities.

An agent is in contact if another is closer than 0.30 m (centres, twice the collision radius), or
if z <= 0 later than 0.5 s after the reset (every task spawns on the ground). A crash is the rising
edge of contact, per agent: a sustained contact counts once, k agents colliding at one step count
as k (paper, Sec. V).

The reported reward pays `PENALTY` per step for every other agent in contact. Its training
surrogate is once differentiable, reaches out to 0.5 m and has a bounded slope:

    s(d) = 0                                   d >= 0.5 m
         = PENALTY (0.5 - d)^2 / (2 0.2^2)     0.3 <= d < 0.5 m
         = PENALTY (0.5 + (0.3 - d) / 0.2)     d < 0.3 m

The paper states neither the penalty nor its gradient; both are choices of this project. Contact
with the floor is a crash but not part of the penalty: "per-collision penalty [...] prevents
spatial overlap" (paper, Sec. IV-B).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from simulators.algebra import sweep
from simulators.vehicle import COLLISION_RADIUS

CONTACT_DISTANCE = 2.0 * COLLISION_RADIUS
"""Distance between centres below which two drones are in contact [m]."""
GRACE = 0.5
"""Time after a reset in which contact with the floor does not count [s]; paper, Sec. V."""
PENALTY = 1.0
"""Penalty per step and agent in contact, in units of reward; a choice, see above."""
MANY = 40
"""Team size from which on close pairs are found by sweeps (`simulators/algebra/sweep.py`):
low-fidelity training costs 1.77 us a drone and step with all pairs, 1.88 with sweeps at N = 32,
2.05 and 1.84 at 48."""
_MARGIN = 0.2
_REACH = CONTACT_DISTANCE + _MARGIN


def _swept(pos: Float[Array, "drones 3"]) -> bool:
    """Whether pairs are found by sweeps, which are faster on a CPU only."""
    return len(pos) >= MANY and jax.default_backend() == "cpu"


def nearest(pos: Float[Array, "drones 3"], k: int) -> Int[Array, "drones k"]:
    """Indices of the `k` nearest others of each drone, the nearest first.

    Raises:
        ValueError: There are fewer others.
    """
    if k >= len(pos):
        raise ValueError(f"`k` must be below the {len(pos)} drones, got {k}.")
    if k and _swept(pos):
        return sweep.nearest(pos, k)
    squared, place, found = _squared(pos), jnp.arange(len(pos)), [jnp.zeros((0, len(pos)), int)]
    for _ in range(k):
        found.append(jnp.argmin(squared, axis=0)[None])
        squared = jnp.where(place[:, None] == found[-1], jnp.inf, squared)
    return jnp.concatenate(found).T


def in_contact(pos: Float[Array, "drones 3"], t: Float[Array, ""]) -> Bool[Array, " drones"]:
    """Which drones touch another or, after the grace time, the floor; `t` since reset [s]."""
    # A time that is summed up in single precision may pass GRACE by rounding alone.
    floor = (pos[:, 2] <= 0.0) & (t > GRACE + 1e-3)
    return (_summed(pos, CONTACT_DISTANCE, _touching) > 0.0) | floor


def onsets(contact: Bool[Array, "*n time drones"]) -> Bool[Array, "*n time drones"]:
    """Where a contact begins: the crashes of flights that start without one."""
    before = jnp.concatenate([jnp.zeros_like(contact[..., :1, :]), contact[..., :-1, :]], axis=-2)
    return contact & ~before


def penalty(pos: Float[Array, "drones 3"]) -> Float[Array, " drones"]:
    """The exact penalty of one step, at least 0; no gradient."""
    return _summed(jax.lax.stop_gradient(pos), CONTACT_DISTANCE, _exact)


@jax.custom_vjp
def soft_penalty(pos: Float[Array, "drones 3"]) -> Float[Array, " drones"]:
    """The differentiable surrogate of one step, at least 0; in reverse mode, once."""
    return _summed(pos, _REACH, _soft)


def surrogate(distance: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """What one other drone at a distance [m] takes off the reward that is trained on."""
    inside = jnp.maximum((_REACH - distance) / _MARGIN, 0.0)
    return PENALTY * jnp.where(inside < 1.0, 0.5 * inside**2, inside - 0.5)


def _squared(pos: Float[Array, "drones 3"]) -> Float[Array, "drones drones"]:
    """Squared distances between all pairs [m^2], infinite on the diagonal."""
    squared = jnp.sum((pos[:, None] - pos[None]) ** 2, axis=-1)
    return jnp.where(jnp.eye(len(pos), dtype=bool), jnp.inf, squared)


def _summed(
    pos: Float[Array, "drones 3"], reach: float, term: sweep.Pair
) -> Float[Array, " drones"]:
    """Sum of `term` over the others within `reach` [m]; without a gradient in large teams."""
    if _swept(pos):
        return sweep.summed(pos, reach, term)
    return jnp.sum(term(_squared(pos)), axis=-1)


def _length(squared: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return jnp.sqrt(squared + 1e-6)


def _touching(squared: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return (squared < CONTACT_DISTANCE**2).astype(squared.dtype)


def _exact(squared: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return PENALTY * (_length(squared) < CONTACT_DISTANCE).astype(squared.dtype)


def _soft(squared: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return surrogate(_length(squared))


def _slope(squared: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Derivative of `_soft` by the squared distance."""
    length = _length(squared)
    inside = jnp.clip((_REACH - length) / _MARGIN, 0.0, 1.0)
    return -0.5 * PENALTY / _MARGIN * inside / length


def _pushed(
    pos: Float[Array, "drones 3"], weight: Float[Array, " drones"]
) -> tuple[Float[Array, "drones 3"]]:
    """Derivative of the weighted sum of `soft_penalty`.

    All pairs stand with the drone that is moved last: sums over it would not be vectorised.
    """
    if _swept(pos):
        return (sweep.pulled(pos, weight, _REACH, _slope),)
    apart = pos.T[:, None] - pos.T[:, :, None]
    force = (weight + weight[:, None]) * _slope(jnp.sum(apart**2, axis=0))
    return (2.0 * jnp.sum(force * apart, axis=1).T,)


soft_penalty.defvjp(lambda pos: (soft_penalty(pos), pos), _pushed)
