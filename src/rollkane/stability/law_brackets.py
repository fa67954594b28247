"""Lie brackets of a Kane system's equations with affine laws of its coordinates."""

from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..codegen.compile_effort import for_one_call
from ..kane.equations import kane_derivative
from ..kane.system import KaneState, KaneSystem
from ..kinematics.coordinates import pack
from .configured import configured, misses

_ROWS = 12  # states in one call of the program


class Seen(NamedTuple):
    """At S states, of R rows and L laws.

    Attributes:
        q: Coordinates on the configuration, shape (S, n).
        misses: By what share of what may be left they miss it, shape (S,).
        brackets: Shape (S, R, L).
        terms: Sizes of what these are differences of, shape (S, R, L).
        rates: The right-hand side, shape (S, R).
        in_time: Its rate by time, shape (S, R).
    """

    q: Any
    misses: Any
    brackets: Any
    terms: Any
    rates: Any
    in_time: Any


def affine_laws(n: int) -> np.ndarray:
    """``[M, b]`` with one entry each: shifts first, shape (n + n^2, n, n + 1)."""
    laws = np.zeros((n + n * n, n, n + 1))
    for k in range(n):
        laws[k, k, n] = 1.0
    for k in range(n * n):
        laws[n + k, k // n, k % n] = 1.0
    return laws


def states_of(q: np.ndarray, u: np.ndarray) -> KaneState:
    """As many states as there are rows."""
    return KaneState(cast(Array, q), cast(Array, u))


def looked_at(system: KaneSystem, states: KaneState) -> Seen:
    """What is seen at states, in equal parts, by one program."""
    q, u = (np.asarray(x) for x in (states.q, states.u))
    centre, laws = q[0], affine_laws(q.shape[1])
    count = q.shape[0]
    parts: list[Seen] = []
    for first in range(0, count, _ROWS):
        some = np.minimum(np.arange(first, first + _ROWS), count - 1)
        found = _brackets(system, laws, centre, states_of(q[some], u[some]))
        parts.append(Seen(*(np.asarray(x, float) for x in found)))
    return Seen(*(np.concatenate(x)[:count] for x in zip(*parts, strict=True)))


@for_one_call
def _brackets(
    system: KaneSystem, laws: Array, centre: Array, states: KaneState
) -> Seen:
    """Lie brackets with affine motions about a centre, and how they leave the place."""

    def at(state: KaneState) -> Seen:
        y = KaneState(configured(system, jnp.asarray(state.q)), jnp.asarray(state.u))
        t = jnp.zeros_like(y.q[0])

        def rates(t: Array, y: KaneState) -> KaneState:
            return kane_derivative(system, t, y)

        def leaving(q: Array) -> Array:
            return misses(system, q)

        f, along = cast(tuple[KaneState, Any], jax.linearize(rates, t, y))

        def with_law(law: Array) -> tuple[Array, Array]:
            value = KaneState(law[:, :-1] @ (y.q - centre) + law[:, -1], 0.0 * y.u)
            back = KaneState(law[:, :-1] @ f.q, 0.0 * f.u)
            left = jax.jvp(leaving, (y.q,), (value.q,))[1]
            ahead = pack(cast(KaneState, along(0.0 * t, value)))
            both = jnp.concatenate([ahead, left]), jnp.concatenate([pack(back), left])
            return both[0], both[1].at[ahead.shape[0] :].set(0.0)

        ahead, back = (x.T for x in jax.vmap(with_law)(jnp.asarray(laws)))
        still = KaneState(0.0 * y.q, 0.0 * y.u)
        in_time = pack(cast(KaneState, along(jnp.ones_like(t), still)))
        more = jnp.zeros(ahead.shape[0] - in_time.shape[0], in_time.dtype)
        flow, by_time = (jnp.concatenate([x, more]) for x in (pack(f), in_time))
        terms = jnp.abs(ahead) + jnp.abs(back)
        missed = _missed(system, y.q, centre)
        return Seen(y.q, missed, ahead - back, terms, flow, by_time)

    return jax.vmap(at)(states)


def _missed(system: KaneSystem, q: Array, centre: Array) -> Array:
    """By what share of what may be left coordinates miss the configuration.

    That is 1e-10 of their sizes, to which Newton's method squares what was more, and a
    few hundred roundings of coordinates of order one, which may cancel.
    """
    if system.configuration is None:
        return jnp.zeros_like(q[0])

    def missing(q: Array) -> Array:
        return misses(system, q)

    slope = jnp.abs(cast(Array, jax.jacfwd(missing)(q)))
    allowed = slope @ (1e-10 * (jnp.abs(q) + jnp.abs(q - centre)) + 1e-13)
    missed = jnp.abs(misses(system, q))
    # what no coordinate moves may miss nothing, and by nothing it is no share of it
    return jnp.max(missed / jnp.maximum(allowed, 1e-300), initial=0.0)
