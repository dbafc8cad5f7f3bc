r"""Pairs of drones that are close, without looking at all pairs (sweep and prune).

Drones are sorted along x. Step s of a sweep compares each with the one s places further on, one
vector operation for the whole team, and the sweep ends where no such two are closer along x than
the reach. The result is that of all pairs for any positions; what changes is the cost: a formation
of 1,000 drones takes about 100 steps.

Worlds are swept one after another, because each ends at a step of its own.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

Pair = Callable[[Float[Array, " drones"]], Float[Array, " drones"]]
"""A function of squared distances [m^2], zero beyond the reach and at infinity."""


def summed(pos: Float[Array, "drones 3"], reach: float, term: Pair) -> Float[Array, " drones"]:
    """Sum of `term` over the squared distances to all others within `reach` [m]; no gradient."""

    def visit(carry: Array, s: Array, apart: Float[Array, "3 drones"]) -> Array:
        return _both(carry, s, term(jnp.sum(apart**2, axis=0)))

    return _swept(pos, reach, jnp.zeros(2 * len(pos)), visit)


def pulled(
    pos: Float[Array, "drones 3"], weight: Float[Array, " drones"], reach: float, slope: Pair
) -> Float[Array, "drones 3"]:
    """Derivative by `pos` of `summed` weighted by `weight`; `slope` is the derivative of `term`."""
    order = jnp.argsort(pos[:, 0])
    ahead = jnp.concatenate([weight[order], jnp.zeros_like(weight)])

    def visit(carry: Array, s: Array, apart: Float[Array, "3 drones"]) -> Array:
        share = weight[order] + jax.lax.dynamic_slice(ahead, (s,), weight.shape)
        factor = share * slope(jnp.sum(apart**2, axis=0))
        # A drone that is not there is infinitely far away.
        force = 2.0 * factor * jnp.where(jnp.isfinite(apart), apart, 0.0)
        here = carry.at[:, : len(pos)].add(-force)
        there = jax.lax.dynamic_slice(here, (0, s), force.shape) + force
        return jax.lax.dynamic_update_slice(here, there, (0, s))

    return _swept(pos, reach, jnp.zeros((3, 2 * len(pos))), visit)


@functools.partial(jax.jit, static_argnums=1)
def nearest(pos: Float[Array, "drones 3"], k: int) -> Int[Array, "drones k"]:
    """Indices of the `k` nearest others of each drone, the nearest first; no gradient."""

    @jax.custom_batching.sequential_vmap
    def search(pos: Float[Array, "drones 3"]) -> Int[Array, "drones k"]:
        n = len(pos)
        order = jnp.argsort(pos[:, 0])
        here = pos[order].T
        nobody = jnp.full((3, n), jnp.inf)
        line = jnp.concatenate([nobody, here, nobody], axis=1)
        Found = tuple[list[Array], list[Array]]

        def at(s: Array) -> Float[Array, "3 drones"]:
            return jax.lax.dynamic_slice(line, (0, n + s), (3, n)) - here

        def insert(found: Found, s: Array) -> Found:
            """The best so far with the drone `s` places further on, its place as a float."""
            far, index = jnp.sum(at(s) ** 2, axis=0), jnp.arange(n, dtype=pos.dtype) + s
            squared, places = list(found[0]), list(found[1])
            for i in range(k):
                nearer = far < squared[i]
                squared[i], far = (
                    jnp.where(nearer, far, squared[i]),
                    jnp.where(nearer, squared[i], far),
                )
                places[i], index = (
                    jnp.where(nearer, index, places[i]),
                    jnp.where(nearer, places[i], index),
                )
            return squared, places

        def unsettled(carry: tuple[Array, Found]) -> Array:
            s, (squared, _) = carry
            along = jnp.minimum(jnp.abs(at(s)[0]), jnp.abs(at(-s)[0]))
            return (s < n) & jnp.any(along**2 < squared[-1])

        def step(carry: tuple[Array, Found]) -> tuple[Array, Found]:
            s, found = carry
            return s + 1, insert(insert(found, s), -s)

        begin = ([jnp.full(n, jnp.inf)] * k, [jnp.zeros(n)] * k)
        _, (_, places) = jax.lax.while_loop(unsettled, step, (jnp.asarray(1), begin))
        found = order[jnp.stack(places, axis=1).astype(int)]
        return jnp.zeros_like(found).at[order].set(found)

    return search(pos)


def _both(carry: Array, s: Array, value: Float[Array, " drones"]) -> Array:
    """`value` added to each drone's sum and to that of the one `s` places further on."""
    here = carry.at[: len(value)].add(value)
    there = jax.lax.dynamic_slice(here, (s,), value.shape) + value
    return jax.lax.dynamic_update_slice(here, there, (s,))


def _swept(
    pos: Float[Array, "drones 3"],
    reach: float,
    begin: Array,
    visit: Callable[[Array, Array, Array], Array],
) -> Array:
    """What `visit` makes of `begin` over all steps, put back into the drones' order."""
    n, order = len(pos), jnp.argsort(pos[:, 0])
    here = pos[order].T
    ahead = jnp.concatenate([here, jnp.full((3, n), jnp.inf)], axis=1)

    def apart(s: Array) -> Float[Array, "3 drones"]:
        return jax.lax.dynamic_slice(ahead, (0, s), (3, n)) - here

    def close(carry: tuple[Array, Array]) -> Array:
        return (carry[0] < n) & jnp.any(apart(carry[0])[0] < reach)

    def step(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        s, sums = carry
        return s + 1, visit(sums, s, apart(s))

    _, sums = jax.lax.while_loop(close, step, (jnp.asarray(1), begin))
    own = jnp.moveaxis(sums, -1, 0)[:n]
    return jnp.zeros_like(own).at[order].set(own)
