"""Matrix products written out: the same values and derivatives, and none left in a physics step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import SIMULATORS, hovering, positions

from simulators.algebra.products import written_out


def count(function, *args):
    text = str(jax.make_jaxpr(function)(*args))
    return text.count("dot_general")


@pytest.mark.parametrize(
    ("subscripts", "left", "right"),
    [
        ("ij,j->i", (3, 3), (3,)),
        ("ij,njk->nik", (4, 4), (7, 4, 1)),
        ("nij,nj->ni", (5, 3, 3), (5, 3)),
        ("i,i->", (6,), (6,)),
        ("i,j->ij", (3,), (4,)),
        ("ij,ij->", (3, 4), (3, 4)),
        ("bij,bkj->bik", (2, 3, 4), (2, 5, 4)),
    ],
)
def test_small_products_keep_their_values_and_derivatives(subscripts, left, right):
    a = jax.random.normal(jax.random.key(0), left)
    b = jax.random.normal(jax.random.key(1), right)

    def plain(a, b):
        return jnp.sin(jnp.einsum(subscripts, a, b, precision="highest"))

    written = written_out(jax.jit(plain))
    assert count(plain, a, b) > 0
    assert count(written, a, b) == 0
    np.testing.assert_allclose(written(a, b), plain(a, b), rtol=1e-5, atol=1e-6)
    slope = jax.grad(lambda a: jnp.sum(written(a, b)))(a)
    expected = jax.grad(lambda a: jnp.sum(plain(a, b)))(a)
    np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-6)
    many = jnp.stack([a, 2 * a])
    batched = jax.vmap(written, in_axes=(0, None))(many, b)
    np.testing.assert_allclose(batched[1], plain(2 * a, b), rtol=1e-5, atol=1e-6)


def test_large_products_stay():
    x = jnp.ones((40, 128))
    assert count(written_out(lambda x: x @ x.T), x) == 1


def test_functions_with_derivatives_of_their_own_keep_them():
    @jax.custom_vjp
    def odd(x):
        return x @ x

    odd.defvjp(lambda x: (x @ x, x), lambda x, ct: (7.0 * ct * x,))

    @jax.custom_jvp
    def even(x):
        return 2.0 * x

    even.defjvp(lambda primals, tangents: (2.0 * primals[0], 5.0 * tangents[0]))
    x = jnp.asarray([1.0, 2.0])
    np.testing.assert_allclose(jax.grad(written_out(odd))(x), 7.0 * x)
    np.testing.assert_allclose(
        jax.grad(lambda x: jnp.sum(written_out(jax.jit(even))(x)))(x), [5.0, 5.0]
    )


def test_values_that_a_function_closes_over_are_differentiated():
    x, matrix = jnp.asarray([1.0, 2.0]), jnp.asarray([[1.0, 2.0], [3.0, 4.0]])
    slope = jax.grad(lambda m: jnp.sum(written_out(lambda x: m @ x)(x)))(matrix)
    np.testing.assert_allclose(slope, [[1.0, 2.0], [1.0, 2.0]])


def test_no_product_is_left_in_a_physics_step_of_crazyflow():
    simulator = SIMULATORS["crazyflow"]()
    state = hovering(simulator, positions(12))
    cmd = jnp.zeros((12, 4))
    assert count(simulator._physics_step, state, cmd) == 0
