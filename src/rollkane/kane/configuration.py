"""Whether a start fulfils a configuration, and the constraints keep it.

The motion knows nothing of ``F(t, q) = 0``: it keeps it where the start fulfils it and
its rate ``F_q q' + F_t`` vanishes at all speeds that the constraints allow. With
``q' = Y u + Z`` and ``u = T u_i + s`` that is ``F_q Y T = 0`` and
``F_q (Y s + Z) + F_t = 0``. Source: docs/theory.md, (9.4).
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..validation.checks import FieldError
from .equations import speeds_of
from .implied_rows import Followed, followed_along, refuse_lost
from .partial_velocities import Partials, evaluation
from .system import KaneState, KaneSystem

# The end of a run is a start, too. Runs drift by less than three times their relative
# tolerance from a configuration (a spherical pendulum in Cartesian coordinates, rtol
# 1e-4 to 1e-12, up to 7500 steps); thirty times that is left to other systems.
_KEPT = 100.0
# of what a sum has at least: units of q, u and their products, a hundred roundings of
# which are what lengths and angles of order one have where their sum is zero
_ROUNDINGS = 100.0


class Held(NamedTuple):
    """A configuration F at a state, what moves it, and what becomes of it.

    Attributes:
        residual: F, shape (c,).
        by_time: F_t, shape (c,).
        by_place: F_q, shape (c, n).
        Y: ``q' = Y u + Z``, shape (n, m).
        Z: Shape (n,).
        T: ``u = T u_i + s``, shape (m, i).
        s: Shape (m,).
        q_dot: Of a motion with independent speeds of order one, shape (n,).
        q_ddot: At constant independent speeds, shape (n,).
        by_time_dot: Of F_t along that motion, shape (c,).
        by_place_dot: Of F_q, shape (c, n).
        implied: Rows that follow from others, along that motion; None without any.
    """

    residual: Float[Array, " c"]
    by_time: Float[Array, " c"]
    by_place: Float[Array, "c n"]
    Y: Float[Array, "n m"]
    Z: Float[Array, " n"]
    T: Float[Array, "m i"]
    s: Float[Array, " m"]
    q_dot: Float[Array, " n"]
    q_ddot: Float[Array, " n"]
    by_time_dot: Float[Array, " c"]
    by_place_dot: Float[Array, "c n"]
    implied: Followed | None


def held(
    system: KaneSystem, t: Array, state: KaneState, partials: Partials
) -> Held | None:
    """What becomes of a system's configuration; None without one.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
        partials: Partial velocities there.
    """
    if system.configuration is None or not system.dependent_coordinates:
        return None
    q = state.q
    Y, Z = partials.by_speeds.kinematics, partials.at_rest.kinematics
    s, T, follow = speeds_of(system, partials, jnp.zeros_like(state.u))
    # a motion like any other, the same one each time
    drawn = np.random.default_rng(0).standard_normal(state.u.shape)
    u = s + T @ jnp.asarray(drawn, q.dtype)
    moved = jnp.ones_like(t), Y @ u + Z

    def values(t: Array, q: Array) -> tuple[Any, Any]:
        of = evaluation(system, t, q, u)
        F = of(system.configuration)
        return (F, of(system.kinematics), of(system.constraints)), F

    derivatives = cast(
        "Callable[..., Any]", jax.jacfwd(values, argnums=(0, 1), has_aux=True)
    )
    (now, F), (later, _) = jax.jvp(derivatives, (t, q), moved)
    (F_t, F_q), *velocities = now
    (F_t_dot, F_q_dot), *_ = later
    q_ddot, *others = (by[0] + by[1] @ moved[1] for by in velocities if by is not None)
    u_dot = jnp.zeros_like(u)
    for constraints in others:
        u_dot = follow @ constraints
        q_ddot = q_ddot + Y @ u_dot
    implied = followed_along(system, t, q, u, moved[1], u_dot)
    return Held(F, F_t, F_q, Y, Z, T, s, moved[1], q_ddot, F_t_dot, F_q_dot, implied)


def _free(found: Held, rtol: float) -> tuple[np.ndarray, np.ndarray]:
    """Rates of F along motions that the constraints allow, and where they are not zero.

    Columns: by each independent speed; without them; the rate's own rate.
    """
    _, F_t, F_q, Y, Z, T, s, q_dot, q_ddot, *dots = (np.asarray(x) for x in found[:-1])
    turned = dots[0] + dots[1] @ q_dot
    rates = [F_q @ (Y @ T), F_q @ (Y @ s + Z) + F_t, turned + F_q @ q_ddot]
    f, y = np.abs(F_q), np.abs(Y)
    # of the terms that these are sums of
    sizes = [
        f @ (y @ np.abs(T)),
        f @ (y @ np.abs(s) + np.abs(Z)) + np.abs(F_t),
        np.abs(turned) + f @ np.abs(q_ddot),
    ]
    # terms may be zero but for roundings: of coefficients, at speeds of order one
    coefficients = np.hstack([f, f @ y, sizes[0]]).max(axis=1, keepdims=True)
    quick = np.ones(T.shape[1] + 2)
    quick[-1] = (1.0 + np.abs(q_dot).max()) ** 2
    allowed = _KEPT * rtol * np.column_stack(sizes)
    allowed = allowed + _rounding(F_q) * coefficients * quick
    rates = np.column_stack(rates)
    return rates, np.abs(rates) > allowed


def refuse_violated(
    system: KaneSystem, state: KaneState, found: Held | None, rtol: float, where: str
) -> None:
    """Refuse a start that does not fulfil the configuration.

    Args:
        system: The system.
        state: The start.
        found: What ``held`` gives there.
        rtol: Relative tolerance of the motion [1].
        where: State and time, for the error.

    Raises:
        FieldError: it does not, or the equations follow from each other.
    """
    if found is None:
        return
    F, F_q, q = (np.asarray(x) for x in (found.residual, found.by_place, state.q))
    if not (np.isfinite(F).all() and np.isfinite(F_q).all()):
        raise FieldError(
            "KaneSystem.configuration",
            F,
            "has no value and derivatives" + where,
            "start where it has, or write it without singular places",
        )
    size = np.abs(F_q) @ np.abs(q)
    allowed = _KEPT * rtol * size + _rounding(F) * _reach(found)
    if (np.abs(F) > allowed).any():
        raise FieldError(
            "KaneSystem.configuration",
            F,
            f"is not zero{where}: of terms of size {_short(size)}, {_short(allowed)} "
            "might be left",
            "start from coordinates that fulfil it" + _nearer(system, q, F, F_q),
        )
    lengths = np.linalg.norm(F_q, axis=1, keepdims=True)
    spread = np.linalg.svd(F_q / np.where(lengths, lengths, 1.0), compute_uv=False)
    if not spread[-1] > _rounding(F_q):  # zero where a length is
        raise FieldError(
            "KaneSystem.configuration",
            F_q,
            "has derivatives by the coordinates that are zero or follow from each "
            "other" + where,
            "leave out what follows from others, and write equations that change sign "
            "where they are fulfilled",
        )


def _reach(found: Held) -> np.ndarray:
    """What a unit of the coordinates gives F, or less where F bends within a unit."""

    def total(x: Array) -> np.ndarray:
        return np.nan_to_num(np.abs(np.asarray(x, float))).sum(axis=-1)

    slope, quick = total(found.by_place), total(found.q_dot)
    bends = total(found.by_place_dot) / (quick or 1.0)
    return slope * slope / np.maximum(bends, slope + (slope == 0.0))


def _nearer(system: KaneSystem, q: np.ndarray, F: np.ndarray, F_q: np.ndarray) -> str:
    """One step of Newton's towards a configuration, in words."""
    bound = list(system.dependent_coordinates)
    if np.linalg.matrix_rank(F_q[:, bound]) < len(bound):
        return ""
    there = q[bound] - np.linalg.solve(F_q[:, bound], F)
    return f" (to first order, q[{bound}] = {there.tolist()})"


def refuse_free(
    system: KaneSystem, found: Held | None, rtol: float, where: str
) -> None:
    """Refuse constraints that do not keep the configuration.

    Args:
        system: The system.
        found: What ``held`` gives at the start.
        rtol: Relative tolerance of the motion [1].
        where: State and time, for the error.

    Raises:
        FieldError: its rate is not among the velocity constraints.
    """
    if found is None:
        return
    rates, free = _free(found, rtol)
    if free.any():
        # where a row that was left out is what would have kept it
        refuse_lost(system, found.implied, rtol, where)
        row = int(np.argmax(free.any(axis=1)))
        raise FieldError(
            "KaneSystem.configuration",
            rates[row],
            f"is not kept by the velocity constraints{where}: the rate of equation "
            f"{row}, by each independent speed {system.independent}, without speeds, "
            "and how it grows along a motion, has to be zero",
            "put F_q q' + F_t of the configuration among `constraints`, and the speed "
            "that follows from it into `dependent`",
        )


def refuse_bound(system: KaneSystem, found: Held | None, where: str) -> None:
    """Refuse dependent coordinates that the configuration does not determine.

    Args:
        system: The system.
        found: What ``held`` gives at the state.
        where: State and time, for the error.

    Raises:
        FieldError: the derivative of F by them cannot be inverted.
    """
    if found is None:
        return
    slope = np.asarray(found.by_place)
    bound = slope[:, list(system.dependent_coordinates)]
    spread = np.linalg.svd(bound, compute_uv=False)
    if not spread[-1] > _rounding(slope) * np.abs(slope).max():
        raise FieldError(
            "KaneSystem.dependent_coordinates",
            system.dependent_coordinates,
            "are not determined by the configuration" + where,
            "choose others",
        )


def _rounding(numbers: np.ndarray) -> float:
    return _ROUNDINGS * float(np.finfo(numbers.dtype).eps)


def _short(numbers: np.ndarray) -> str:
    return "[" + ", ".join(f"{x:.1e}" for x in numbers) + "]"
