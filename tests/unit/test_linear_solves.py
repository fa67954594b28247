"""Solves of a few unknowns: what runs once is solved by libraries, with one result."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen.tracing import becoming_c, running_once
from rollkane.kane.linear_solves import (
    determinant,
    followed,
    inverse_of,
    next_to,
    solved,
)

# condition of what is drawn below a hundred, squared by next_to and by the unrolled
# inverse before two steps bring it back: 1e4 times some tens of roundings
EQUAL = 1e-10


def drawn(size, rows=3):
    """A mass matrix, constraints, a square matrix, a right-hand side."""
    rng = np.random.default_rng(size)
    near_one = lambda n: np.eye(n) + 0.3 * rng.standard_normal((n, n)) / np.sqrt(n)
    A = near_one(size)
    C = np.hstack([near_one(rows), rng.standard_normal((rows, size - rows))])
    return [
        jnp.asarray(x) for x in (A @ A.T, C, near_one(size), rng.uniform(1, 2, size))
    ]


# a mass matrix changes on both sides of its diagonal
SOLVES = {
    "solved": lambda M, C, A, b: solved(0.5 * (M + M.T), b),
    "followed": lambda M, C, A, b: followed(0.5 * (M + M.T), C),
    "next_to": lambda M, C, A, b: next_to(C),
    "inverse_of": lambda M, C, A, b: inverse_of(A),
    "determinant": lambda M, C, A, b: determinant(A),
}


@pytest.mark.parametrize("size", [4, 12])
@pytest.mark.parametrize("name", SOLVES)
def test_once_and_at_every_step_are_the_same(name, size):
    given = drawn(size)
    expected = SOLVES[name](*given)
    with running_once():
        found = SOLVES[name](*given)
        slopes = jax.jacrev(SOLVES[name], argnums=(0, 1, 2))(*given)
    np.testing.assert_allclose(found, expected, rtol=0, atol=EQUAL)
    others = jax.jacfwd(SOLVES[name], argnums=(0, 1, 2))(*given)
    for a, b in zip(slopes, others, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=100 * EQUAL)


def equations_of(function, given):
    """How many a traced function has, those of its parts among them."""

    def count(jaxpr):
        parts = [
            getattr(x, "jaxpr", x)
            for e in jaxpr.eqns
            for x in jax.tree.leaves(list(e.params.values()))
            if hasattr(x, "eqns") or hasattr(x, "jaxpr")
        ]
        return len(jaxpr.eqns) + sum(map(count, parts))

    return count(jax.make_jaxpr(lambda *x: function(*x))(*given).jaxpr)


def test_what_runs_once_is_few_operations_but_in_c():
    """XLA took 3 s to compile twelve unknowns that are written out; C takes them so."""
    given = drawn(12)
    written_out = equations_of(SOLVES["followed"], given)
    with running_once():
        once = equations_of(SOLVES["followed"], given)
        with becoming_c():
            in_c = equations_of(SOLVES["followed"], given)
    assert in_c == written_out
    assert once < written_out / 5
