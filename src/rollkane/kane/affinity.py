"""Whether velocities are affine in the speeds: whether derivatives by them are fixed.

Where a velocity is affine, the code that gives its derivative does not look at the
speeds, and gives the same number at any. So derivatives are compared, not values: their
differences are zero to a few roundings, while values have the roundings of everything
that cancels in them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..validation.checks import FieldError
from .partial_velocities import Velocities, values_of
from .parts import RigidBody
from .system import KaneState, KaneSystem

# A derivative is a sum of products: a hundred roundings of it are 2e-14, 1e-5 in single
# precision; as often as the speeds are large, where their squares cancel in it. c u^2
# beside u changes it by 2 c u: found for c above 1e-14, and 1e-5.
_ROUNDINGS = 100
# values are asked for jumps, which derivatives do not show, to half of the digits
_HALF = 0.5
# what is below a hundredth of a unit per unit of speed is compared with that: the
# velocity of a point at rest is a sum of roundings
_NOTHING = 0.01
# from slow to fast, in units of speed: a function may be affine near zero alone
_MAGNITUDES = 10.0 ** np.arange(-4, 5)
# and not only at the start, where q_1 u^2 may vanish: so far from it, of 1 + |q|
_ASIDE = 1e-3


class Samples(NamedTuple):
    """Functions of the speeds at k places, each at rest, at some speeds, and opposite.

    Attributes:
        speeds: Shape (k, m).
        values: Of every function, shape (k, 3, ...).
        slopes: Their derivatives along the speeds, alike.
    """

    speeds: Float[Array, "k m"]
    values: Velocities
    slopes: Velocities


def sampled(system: KaneSystem, t: Array, state: KaneState) -> Samples:
    """Every function that has to be affine in the speeds, at the state and beside it.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
    """

    def along(t: Array, q: Array, u: Array) -> tuple[Velocities, Velocities]:
        of_speeds: Callable[[Array], Velocities] = lambda u: values_of(system, t, q, u)
        signs = jnp.asarray([0.0, 1.0, -1.0], u.dtype)

        def one(s: Array) -> tuple[Velocities, Velocities]:
            return jax.jvp(of_speeds, (s * u,), (u,))

        return jax.vmap(one)(signs)

    times, places, speeds = _points(system, t, state)
    return Samples(speeds, *jax.vmap(along)(times, places, speeds))


def _points(
    system: KaneSystem, t: Array, state: KaneState
) -> tuple[Array, Array, Array]:
    """Times, coordinates and speeds to look at; the same ones each time."""
    q, u = state.q, state.u
    draw = np.random.default_rng(0)
    count = 2 * _MAGNITUDES.shape[0]
    aside = np.repeat([0.0, _ASIDE], _MAGNITUDES.shape[0])
    shift = aside[:, None] * draw.standard_normal((count, q.shape[0]))
    # none of them small beside the others, where its own curve would not be seen
    wanted = count, system.speeds + system.auxiliary
    speeds = draw.uniform(0.3, 3.0, wanted) * draw.choice([-1.0, 1.0], wanted)
    speeds = speeds * np.tile(_MAGNITUDES, 2)[:, None]
    return (
        t + jnp.asarray(aside, jnp.result_type(t)) * (1.0 + jnp.abs(t)),
        q[None] + jnp.asarray(shift, q.dtype) * (1.0 + jnp.abs(q))[None],
        jnp.asarray(speeds, q.dtype) * (1.0 + jnp.max(jnp.abs(u), initial=0.0)),
    )


def refuse_curved(system: KaneSystem, found: Samples, where: str) -> None:
    """Refuse functions that are not affine in the speeds.

    Args:
        system: The system.
        found: What ``sampled`` gives.
        where: State and time, for the error.

    Raises:
        FieldError: one is not.
    """
    turning = [k for k, part in enumerate(system.parts) if isinstance(part, RigidBody)]
    fields = Velocities(
        [f"parts[{k}].velocity" for k in range(len(system.parts))],
        [f"parts[{k}].angular_velocity" for k in turning],
        [f"loads[{k}].velocity" for k in range(len(system.loads))],
        None if system.constraints is None else "constraints",
        "kinematics",
    )
    leaves = (jax.tree.leaves(x) for x in (fields, found.values, found.slopes))
    for field, v, V in zip(*leaves, strict=True):
        turned, jumped = _bent(np.asarray(v), np.asarray(V), np.asarray(found.speeds))
        eps = float(np.finfo(V.dtype).eps)
        if turned > _ROUNDINGS * eps or jumped > eps**_HALF:
            how = "its derivative by them changes" if turned >= jumped else "it jumps"
            raise FieldError(
                f"KaneSystem.{field}",
                max(turned, jumped),
                f"is not affine in the speeds{where}: {how} by a part of its size",
                "let speeds stand alone, times functions of t and q",
            )


def _bent(values: np.ndarray, slopes: np.ndarray, u: np.ndarray) -> tuple[float, float]:
    """By how much slopes change, and values leave them, of their size [1].

    Slopes: per unit of speed above one. One where a function is finite at some speeds
    alone, zero where it is at none.
    """
    v, w = (x.reshape(*x.shape[:2], -1).astype(float) for x in (values, slopes))
    finite = np.all(np.isfinite(np.concatenate([v, w], axis=2)), axis=2)
    every = np.all(finite, axis=1)
    if (np.any(finite, axis=1) & ~every).any():
        return 1.0, 0.0
    v, w, u = v[every], w[every], u[every]

    def largest(x: np.ndarray) -> np.ndarray:
        return np.abs(x).max(axis=(1, 2), initial=0.0)

    quick = np.abs(u).max(axis=1, initial=0.0)
    size = largest(w) + _NOTHING * quick
    signs = np.array([[1.0], [-1.0]])
    turned = largest(w[:, 1:] - w[:, :1]) / size / np.maximum(1.0, quick)
    jumped = largest(v[:, 1:] - v[:, :1] - signs * w[:, :1]) / (size + largest(v))
    return float(turned.max(initial=0.0)), float(jumped.max(initial=0.0))
