"""Small matrix products written out as multiplications and sums.

On the CPU XLA compiles a loop into one piece of code, without a call for every operation, only
where no matrix product goes to a library. Products of 3x3 and 4x4 matrices need none, yet for ten
drones and more XLA calls one. What that costs stands in `reports/performance_tried.md`.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal
from jaxtyping import Array, Float

LONGEST_WRITTEN_OUT = 16
"""Longest contraction, and most columns of the smaller factor, that is written out."""


def written_out(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` with its small matrix products written out; the same values up to rounding."""

    def wrapped(*args: Any) -> Any:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        values = _evaluated(closed.jaxpr, closed.consts, jax.tree.leaves(args))
        return jax.tree.unflatten(jax.tree.structure(shape), values)

    return wrapped


def _evaluated(jaxpr: Jaxpr, consts: list, args: list) -> list:
    """The outputs of `jaxpr`."""
    known: dict = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *args), strict=True))

    def value(atom: Any) -> Any:
        return atom.val if isinstance(atom, Literal) else known[atom]

    for eqn in jaxpr.eqns:
        found = [value(x) for x in eqn.invars]
        inner = eqn.params.get("jaxpr")
        if eqn.primitive.name in ("jit", "pjit") and isinstance(inner, ClosedJaxpr):
            out = _evaluated(inner.jaxpr, inner.consts, found)
        elif eqn.primitive.name == "dot_general" and _small(eqn):
            left, right = map(jnp.asarray, found)
            out = [_product(left, right, eqn.params["dimension_numbers"])]
        else:
            primitive: Any = eqn.primitive
            out = primitive.bind(*found, **primitive.get_bind_params(eqn.params))
            out = out if primitive.multiple_results else [out]
        known.update(zip(eqn.outvars, out, strict=True))
    return [value(x) for x in jaxpr.outvars]


def _small(eqn: Any) -> bool:
    (left, _), _ = eqn.params["dimension_numbers"]
    shapes = [x.aval.shape for x in eqn.invars]
    length = math.prod(shapes[0][i] for i in left)
    return (
        length <= LONGEST_WRITTEN_OUT
        and min(math.prod(s) for s in shapes) <= LONGEST_WRITTEN_OUT * length
    )


def _product(left: Array, right: Array, dimension_numbers: Any) -> Array:
    """What `dot_general` returns, summed over an axis of its own."""
    (contract_l, contract_r), (batch_l, batch_r) = dimension_numbers
    free_l = [i for i in range(left.ndim) if i not in (*contract_l, *batch_l)]
    free_r = [i for i in range(right.ndim) if i not in (*contract_r, *batch_r)]
    left = jnp.transpose(left, (*batch_l, *free_l, *contract_l))
    right = jnp.transpose(right, (*batch_r, *free_r, *contract_r))
    n, n_l, n_r = len(batch_l), len(free_l), len(free_r)
    left = jnp.expand_dims(left, tuple(range(n + n_l, n + n_l + n_r)))
    right = jnp.expand_dims(right, tuple(range(n, n + n_l)))
    return jnp.sum(left * right, axis=tuple(range(n + n_l + n_r, left.ndim)))


def opaque(mass: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """`mass`, hidden from the compiler.

    It divides by a constant as x * (1 / mass), which rounds otherwise than a division by the mass
    that an effect computes, so that a neutral effect would not be exactly nominal.
    """
    return jax.lax.optimization_barrier(mass)
