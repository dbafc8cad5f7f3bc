r"""Pairs of drones that are close, without looking at all pairs (sweep and prune).

Drones are sorted along x. Step s of a sweep compares each with the one s places further on, one
vector operation for the whole team, and the sweep ends where no such two are closer along x than
the reach. The result is that of all pairs, for any positions; what changes is the cost: a
formation of 1,000 drones takes about 100 steps.

Worlds are swept one after another, because each ends at a step of its own.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

Pair = Callable[[Float[Array, " drones"]], Float[Array, " drones"]]
"""A function of squared distances [m^2], zero beyond the reach and at infinity."""
_Best = tuple[list[Array], list[Array]]


def summed(pos: Float[Array, "drones 3"], reach: float, term: Pair) -> Float[Array, " drones"]:
    """Sum of `term` over the others within `reach` [m] of each drone; no gradient."""

    @jax.custom_batching.sequential_vmap
    def sweep(pos: Float[Array, "drones 3"]) -> Float[Array, " drones"]:
        def visit(sums: Array, s: Array, apart: Float[Array, "3 drones"]) -> Array:
            value = term(jnp.sum(apart**2, axis=0))
            return _added(_added(sums, 0, value), s, value)

        return _swept(pos, reach, jnp.zeros((1, 2 * len(pos)), pos.dtype), visit)[:, 0]

    return sweep(pos)


def pulled(
    pos: Float[Array, "drones 3"], weight: Float[Array, " drones"], reach: float, slope: Pair
) -> Float[Array, "drones 3"]:
    """Derivative by `pos` of `summed`, weighted; `slope` is the derivative of its `term`."""

    @jax.custom_batching.sequential_vmap
    def sweep(
        pos: Float[Array, "drones 3"], weight: Float[Array, " drones"]
    ) -> Float[Array, "drones 3"]:
        here = weight[jnp.argsort(pos[:, 0])]
        ahead = jnp.concatenate([here, jnp.zeros_like(here)])

        def visit(sums: Array, s: Array, apart: Float[Array, "3 drones"]) -> Array:
            both = here + jax.lax.dynamic_slice(ahead, (s,), here.shape)
            # A drone that is not there is infinitely far away.
            towards = 2.0 * jnp.where(jnp.isfinite(apart), apart, 0.0)
            force = both * slope(jnp.sum(apart**2, axis=0)) * towards
            return _added(_added(sums, 0, -force), s, force)

        return _swept(pos, reach, jnp.zeros((3, 2 * len(pos)), pos.dtype), visit)

    return sweep(pos, weight)


def nearest(pos: Float[Array, "drones 3"], k: int) -> Int[Array, "drones k"]:
    """Indices of the `k` nearest others of each drone, the nearest first; no gradient."""
    return within(pos, jnp.asarray(jnp.inf, pos.dtype), k)


def within(
    pos: Float[Array, "drones 3"], reach: Float[Array, ""], k: int
) -> Int[Array, "drones k"]:
    """Indices of the nearest others within `reach` [m]; a drone's own index fills the rest."""

    @jax.custom_batching.sequential_vmap
    def search(pos: Float[Array, "drones 3"], reach: Float[Array, ""]) -> Int[Array, "drones k"]:
        n, order = len(pos), jnp.argsort(pos[:, 0])
        here, nobody = pos[order].T, jnp.full((3, len(pos)), jnp.inf, pos.dtype)
        line = jnp.concatenate([nobody, here, nobody], axis=1)
        own = jnp.arange(n, dtype=pos.dtype)

        def to(s: Array) -> Float[Array, "3 drones"]:
            return jax.lax.dynamic_slice(line, (0, n + s), (3, n)) - here

        def unsettled(carry: tuple[Array, _Best]) -> Array:
            s, (squared, _) = carry
            along = jnp.minimum(jnp.abs(to(s)[0]), jnp.abs(to(-s)[0]))
            return (s < n) & jnp.any(along**2 < squared[-1])

        def step(carry: tuple[Array, _Best]) -> tuple[Array, _Best]:
            s, best = carry
            for shift in (s, -s):
                best = _inserted(best, jnp.sum(to(shift) ** 2, axis=0), own + shift)
            return s + 1, best

        begin = [jnp.full(n, reach**2, pos.dtype)] * k, [own] * k
        _, (_, places) = jax.lax.while_loop(unsettled, step, (jnp.asarray(1), begin))
        found = order[jnp.stack(places, axis=1).astype(int)]
        return jnp.zeros_like(found).at[order].set(found)

    return search(pos, reach)


def _inserted(best: _Best, squared: Array, place: Array) -> _Best:
    """The smallest squared distances so far with one more, and whose they are."""
    distances, places = list(best[0]), list(best[1])
    for i in range(len(distances)):
        nearer = squared < distances[i]
        pairs = (distances[i], squared), (places[i], place)
        (distances[i], squared), (places[i], place) = (
            (jnp.where(nearer, new, old), jnp.where(nearer, old, new)) for old, new in pairs
        )
    return distances, places


def _added(sums: Array, start: Array | int, value: Array) -> Array:
    """`sums` with `value` added from `start` on."""
    value = value.reshape(len(sums), -1)
    there = jax.lax.dynamic_slice(sums, (0, start), value.shape)
    return jax.lax.dynamic_update_slice(sums, there + value, (0, start))


def _swept(
    pos: Float[Array, "drones 3"],
    reach: float,
    begin: Float[Array, "sums padded"],
    visit: Callable[[Array, Array, Array], Array],
) -> Float[Array, "drones sums"]:
    """The result of all steps of `visit` from `begin`, in the order of the drones."""
    n, order = len(pos), jnp.argsort(pos[:, 0])
    here = pos[order].T
    ahead = jnp.concatenate([here, jnp.full((3, n), jnp.inf, pos.dtype)], axis=1)

    def apart(s: Array) -> Float[Array, "3 drones"]:
        return jax.lax.dynamic_slice(ahead, (0, s), (3, n)) - here

    def close(carry: tuple[Array, Array]) -> Array:
        return (carry[0] < n) & jnp.any(apart(carry[0])[0] < reach)

    def step(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        return carry[0] + 1, visit(carry[1], carry[0], apart(carry[0]))

    _, sums = jax.lax.while_loop(close, step, (jnp.asarray(1), begin))
    found = sums[:, :n].T
    return jnp.zeros_like(found).at[order].set(found)
