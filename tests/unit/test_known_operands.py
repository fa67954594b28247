"""Operations of which the operands are known where a program is written in C.

A user's function may hold a Fourier series from its constant term on, or a turn of a
loop whose number is zero: what is then known is worked out at once, in values, tangents
and cotangents alike, as XLA would do it.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from rollkane.codegen import in_one_program
from rollkane.codegen.derivatives import jvp, pulled
from rollkane.codegen.known_numbers import of_known
from rollkane.codegen.scalar_program import ELEMENTWISE
from rollkane.kane import KaneState, KaneSystem, Load, Particle, simulate

from ..quick import slow_but

# one operation and its slope, by two libraries of functions
ROUNDING = 1e-14
X = jnp.array([0.6, -0.5, 0.8])
KNOWN = np.array([0.0, 1.0, 0.37])
OTHER = np.full(3, 0.81)
WHOLE = jnp.int64(5)


def truths(function):
    """Floats of what operates on truth values or whole numbers."""
    return lambda *x: jnp.asarray(function(*x), float)


OF_ONE = {
    name: getattr(lax, name)
    for name in """
    abs acos acosh asin asinh atan atanh cbrt ceil cos cosh erf erfc exp exp2 expm1
    floor log log1p logistic neg round rsqrt sign sin sinh sqrt square
    stop_gradient tan tanh
    """.split()  # noqa: SIM905 -- words read better than a column of strings
} | {
    "copy": jnp.copy,
    "lgamma": lambda x: lax.lgamma(lax.stop_gradient(x)),  # C has no digamma
    "convert_element_type": lambda x: lax.convert_element_type(
        lax.convert_element_type(3.6 * x, int), float
    ),
    "round to even": lambda x: lax.round(2.5 * x, lax.RoundingMethod.TO_NEAREST_EVEN),
    "integer_pow": lambda x: lax.integer_pow(x, 3),
    "integer_pow below zero": lambda x: lax.integer_pow(1.0 + x, -2),
    "is_finite": truths(lax.is_finite),
    "not": truths(lambda x: ~(x > 0.5)),
    "and": truths(lambda x: (x > 0.5) & (x < 0.9)),
    "or": truths(lambda x: (x > 0.5) | (x < 0.2)),
    "xor": truths(lambda x: (x > 0.5) ^ (x < 0.2)),
    "clamp": lambda x: lax.clamp(0.2, x, 0.8),
    "select_n": lambda x: jnp.where(x > 0.3, 2.0 * x, 3.0 * x),
    "shift_left": truths(lambda x: WHOLE << x.astype(int)),
    "shift_right_arithmetic": truths(lambda x: WHOLE >> x.astype(int)),
    "shift_right_logical": truths(
        lambda x: lax.shift_right_logical(WHOLE, x.astype(int))
    ),
}
OF_TWO = {
    name: getattr(lax, name)
    for name in "add atan2 div max min mul pow rem sub".split()  # noqa: SIM905
} | {name: truths(getattr(lax, name)) for name in "eq ge gt le lt ne".split()}  # noqa: SIM905
# JAX has no rule of its own
OF_TWO["nextafter"] = lambda x, y: lax.nextafter(*map(lax.stop_gradient, (x, y)))
BY_TWO = {f"{n} {k}": f for n, f in OF_TWO.items() for k in ("first", "second")}
# what only derivatives and sorting hold
INNER = {"add_any", "le_to", "lt_to", "one_minus_square"}


def moving(x, numbers):
    """Known numbers that have tangents and cotangents, as far as JAX can see."""
    return lax.select_n(True, x, jnp.asarray(numbers))


def times_nothing(x, numbers):
    """Known numbers of which the tangents are written zeros: as of k x at k = 0."""
    return 0.0 * x + numbers


def applied(name, known):
    """An operation on known numbers, or on these beside other ones."""
    if name in OF_ONE:
        return lambda x: OF_ONE[name](known(x, KNOWN)) + x
    first, function = name.endswith("first"), BY_TWO[name]

    def run(x):
        pair = known(x, KNOWN), known(x, OTHER)
        return function(*(pair if first else pair[::-1])) + x

    return run


def test_every_operation_on_numbers_is_here():
    names = {x.split()[0] for x in (*OF_ONE, *BY_TWO)}
    assert set(ELEMENTWISE) == names | INNER
    half = np.float64(0.5)
    assert of_known("one_minus_square", {}, [half], half.dtype) == 0.75


@pytest.mark.parametrize("known", [moving, times_nothing])
def test_known_operands_in_values_and_derivatives(known):
    """Was: "_sin_lowering() missing 1 required positional argument"."""

    ones = jnp.ones(3)

    def all_of(jvp, pulled):
        def run(x):
            found = {}
            for name in (*OF_ONE, *BY_TWO):
                function = applied(name, known)
                both = jvp(function, (x,), (ones,))
                found[name] = *both, *pulled(function, (x,), ones)
            return found

        return run

    in_c = all_of(jvp, pulled)
    by_jax = all_of(jax.jvp, lambda f, x, g: jax.vjp(f, *x)[1](g))
    found = jax.jit(lambda x: in_one_program(in_c, x))(X)
    wanted = jax.jit(by_jax)(X)
    for name, each in wanted.items():
        for a, b in zip(found[name], each, strict=True):
            # zero times what is not finite is zero here, not so in JAX
            good = np.isfinite(b)
            a, b = np.asarray(a)[good], np.asarray(b)[good]
            np.testing.assert_allclose(a, b, ROUNDING, ROUNDING, err_msg=name)


def of_a_loop(x):
    return lax.fori_loop(0, 5, lambda i, v: v + 0.2 * jnp.sin(v * i), x)


def of_a_series(x):
    return 0.3 * sum(jnp.cos(k * x) for k in range(3))


@pytest.mark.parametrize("push", [of_a_loop, of_a_series])
@pytest.mark.parametrize("method", slow_but(["native"], ["native", "diffrax"]))
def test_derivatives_of_runs(push, method):
    """Was: a TypeError of JAX's, of a series from k = 0 and of a loop from i = 0."""
    system = KaneSystem(
        coordinates=1,
        speeds=1,
        kinematics=lambda t, q, u: u,
        parts=[Particle(2.0, lambda t, q, u: [u[0], 0.0, 0.0])],
        loads=[
            Load(
                lambda t, q, u: [u[0], 0.0, 0.0],
                lambda t, q, u: [push(q[0]) - 0.5 * q[0], 0.0 * t, 0.0 * t],
            )
        ],
    )

    def end(q):
        start = KaneState(q[None], jnp.array([0.8]))
        return simulate(system, start, (0.0, 0.4), rtol=1e-11, method=method).q[-1, 0]

    at, step = jnp.asarray(-0.35), 1e-3
    near, far = (end(at + k * step) - end(at - k * step) for k in (1, 2))
    slope = (8.0 * near - far) / (12.0 * step)
    # differences: step^4 = 1e-12, and the tolerance of runs / step = 1e-8
    np.testing.assert_allclose(jax.grad(end)(at), slope, rtol=1e-8)
    np.testing.assert_allclose(jax.jvp(end, (at,), (1.0,))[1], slope, rtol=1e-8)
