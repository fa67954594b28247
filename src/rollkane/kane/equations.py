"""Kane's equations of a system at one instant: ``F_r + F_r* = 0``.

Velocities are affine in the speeds, so that one derivative at rest gives every partial
velocity; accelerations at constant speeds are derivatives along the motion. What the
functions share is traced twice, however many there are. Source: [B], (1) to
(6); docs/theory.md, section 9.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..geometry.small_linear import cross
from .closure import kept_state, kept_well
from .dependent_speeds import share_by_multipliers, share_of
from .given_states import (
    checked_state,
    coordinates_of,
    known_system,
    time_of,
    with_auxiliary,
)
from .implied_rows import while_they_follow
from .linear_solves import followed, inverse_of, next_to, solved
from .partial_velocities import (
    Partials,
    energy_of,
    evaluation,
    masses_of,
    partials_of,
    turning_parts,
)
from .parts import RigidBody
from .system import KaneState, KaneSystem, Numbers


class KaneEquations(NamedTuple):
    """Kane's equations of all speeds, ``mass_matrix u' = forcing``.

    The auxiliary speeds come last.

    Attributes:
        mass_matrix: [kg], [kg m] or [kg m^2], as the speeds are; shape (m, m).
        forcing: ``F_r`` less the part of ``-F_r*`` without u' [N] or [N m], shape (m,).
        fr: Generalized active forces ``F_r`` [N] or [N m], shape (m,).
        q_dot: Rates of the coordinates [m/s] or [rad/s], shape (n,).
        kinetic_energy: [J].
    """

    mass_matrix: Float[Array, "m m"]
    forcing: Float[Array, " m"]
    fr: Float[Array, " m"]
    q_dot: Float[Array, " n"]
    kinetic_energy: Float[Array, ""]


class Speeds(NamedTuple):
    """All speeds from the independent ones, ``u = T u_i + s``.

    Attributes:
        u: Shape (m,), auxiliary ones (zero) last.
        T: Shape (m, independent).
        follow: What the speeds follow a violation of the constraints with, so that
            ``u' = T u_i' + follow c``, where c is the constraints' rate at constant
            speeds; shape (m, constraints).
    """

    u: Float[Array, " m"]
    T: Float[Array, "m i"]
    follow: Float[Array, "m c"]


class _Rates(NamedTuple):
    """Derivatives along the motion at constant speeds, and loads."""

    points: list[Array]
    turnings: list[Array]
    constraints: Array | None
    loads: list[Array]
    generalized: Array | None


def kane_equations(
    system: KaneSystem, t: ArrayLike, q: Numbers, u: Numbers
) -> KaneEquations:
    """Mass matrix, forcing and generalized active forces.

    Args:
        system: The system.
        t: Time [s].
        q: Generalized coordinates, shape (n,).
        u: All generalized speeds, shape (speeds,) or with the auxiliary ones, which
            are zero.

    Raises:
        FieldError: another number of coordinates or speeds, or known auxiliary ones
            that are not zero.

    Source: [B] (4); docs/theory.md, (9.1), (9.2).
    """
    system = known_system("kane_equations.system", system)
    t = time_of("kane_equations.t", t)
    q = coordinates_of("kane_equations.q", system, q)
    u = with_auxiliary("kane_equations.u", system, u)
    partials = partials_of(system, t, q)
    q_dot = partials.at("kinematics", u)
    rates = _rates(system, t, q, u, q_dot)
    return _assembled(system, partials, rates, u, q_dot)


def kane_derivative(system: KaneSystem, t: ArrayLike, state: KaneState) -> KaneState:
    """Rates of coordinates and independent speeds: the right-hand side itself.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.

    Returns:
        Rates, as a state; NaN where rows that were left out do not follow any more.

    Raises:
        FieldError: a state of another shape.
    """
    system, t, state = _checked("kane_derivative", system, t, state)
    now = reduced(system, t, state)
    if system.implied is None:
        return now.rates()
    moved = now.q - state.q
    return while_they_follow(system, t, now.q, now.u, moved, now.rates())


def reactions(system: KaneSystem, t: ArrayLike, state: KaneState) -> Float[Array, " a"]:
    """Generalized reactions against the auxiliary speeds, shape (auxiliary,).

    What has to act along each auxiliary speed so that it stays zero: with a speed that
    is a velocity of a point in one direction, the force on that point [N]. A constraint
    that names an auxiliary speed holds while that speed moves, by the dependent ones,
    so that its own reaction is no part of the result; one that does not name it gives
    way, and its reaction is. So it is in SymPy.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.

    Raises:
        FieldError: a state of another shape.
    """
    system, t, state = _checked("reactions", system, t, state)
    now = reduced(system, t, state)
    return now.with_auxiliary.T @ now.lacking


def kinetic_energy(
    system: KaneSystem, t: ArrayLike, state: KaneState
) -> Float[Array, ""]:
    """Kinetic energy of a state [J].

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.

    Raises:
        FieldError: a state of another shape.
    """
    system, t, state = _checked("kinetic_energy", system, t, state)
    partials = partials_of(system, t, state.q)
    return energy_of(system, partials, speeds_of(system, partials, state.u).u)


def allowed_state(system: KaneSystem, t: Array, state: KaneState) -> KaneState:
    """The state that the constraints allow next to one: a motion's start.

    Where speeds are chosen as dependent the others are free. Else all are in the state,
    and what of them is not allowed would stay in it, and leak into what is, as the
    constraints turn. Next is by energy, as if the constraints came suddenly.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
    """
    if not system.by_multipliers:
        return state
    state = kept_well(system, t, state)
    partials = partials_of(system, t, state.q)
    follow = speeds_of(system, partials, state.u).follow
    given = jnp.concatenate([state.u, jnp.zeros(system.auxiliary, state.u.dtype)])
    u = given + follow @ partials.at("constraints", given)
    return KaneState(state.q, u[: system.speeds])


def all_speeds(
    system: KaneSystem, t: ArrayLike, state: KaneState
) -> Float[Array, " m"]:
    """All generalized speeds of a state, dependent ones included, shape (speeds,).

    Where constraints depend on each other, the dependent speeds are NaN.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.

    Raises:
        FieldError: a state of another shape.
    """
    system, t, state = _checked("all_speeds", system, t, state)
    partials = partials_of(system, t, state.q)
    return speeds_of(system, partials, state.u).u[: system.speeds]


def _checked(
    function: str, system: object, t: Any, state: object
) -> tuple[KaneSystem, Array, KaneState]:
    """What a function was given, whose name the errors have."""
    known = known_system(f"{function}.system", system)
    time = time_of(f"{function}.t", t)
    return known, time, checked_state(f"{function}.state", known, state)


class Reduced(NamedTuple):
    """Equations of the independent speeds; ``u' = T u_i' + bias`` for all.

    ``with_auxiliary``: how all speeds move with each auxiliary one. ``partials``: what
    all of it was made of. ``q``: coordinates, projected. ``by_multipliers``: u_i' where
    multipliers act beside the forcing; else None.
    """

    mass_matrix: Float[Array, "i i"]
    forcing: Float[Array, " i"]
    u: Float[Array, " m"]
    T: Float[Array, "m i"]
    bias: Float[Array, " m"]
    with_auxiliary: Float[Array, "m a"]
    of_all: KaneEquations
    partials: Partials
    q: Float[Array, " n"]
    by_multipliers: Float[Array, " i"] | None = None

    def rates(self) -> KaneState:
        """Q' and u_i'."""
        return KaneState(self.of_all.q_dot, self.u_dot)

    @property
    def u_dot(self) -> Float[Array, " i"]:
        """Rates of the independent speeds."""
        if self.by_multipliers is not None:
            return self.by_multipliers
        return solved(self.mass_matrix, self.forcing)

    @property
    def lacking(self) -> Float[Array, " m"]:
        """Generalized forces beside the active ones: of constraints, and reactions."""
        u_dot = self.T @ self.u_dot + self.bias
        return self.of_all.mass_matrix @ u_dot - self.of_all.forcing


def reduced(system: KaneSystem, t: Array, state: KaneState) -> Reduced:
    """Equations of the independent speeds alone, where the configuration holds."""
    state = kept_state(system, t, state)
    partials = partials_of(system, t, state.q)
    u, T, follow = speeds_of(system, partials, state.u)
    q_dot = partials.at("kinematics", u)
    rates = _rates(system, t, state.q, u, q_dot)
    of_all = _assembled(system, partials, rates, u, q_dot)
    M, forcing, bias = of_all.mass_matrix, of_all.forcing, jnp.zeros_like(u)
    lifted = _places(u.shape[0], range(system.speeds, u.shape[0]), u.dtype)
    if rates.constraints is not None and system.by_multipliers:
        m = system.speeds
        free = jnp.eye(u.shape[0], m, dtype=u.dtype)
        C = partials.by_speeds.constraints
        along = solved(M[:m, :m], forcing[:m])
        u_dot = along + follow[:m] @ (C[:, :m] @ along + rates.constraints)
        lifted = lifted + follow @ (C @ lifted)
        small = M[:m, :m], forcing[:m], u, free, bias, lifted, of_all, partials
        return Reduced(*small, state.q, u_dot)
    if rates.constraints is not None:
        bias = follow @ rates.constraints
        forcing = forcing - M @ bias
        lifted = lifted + follow @ (partials.by_speeds.constraints @ lifted)
    own = T.T @ M @ T, T.T @ forcing, u, T, bias, lifted, of_all, partials
    return Reduced(*own, state.q)


def _rates(
    system: KaneSystem,
    t: Array,
    q: Float[Array, " n"],
    u: Float[Array, " m"],
    q_dot: Float[Array, " n"],
) -> _Rates:
    def along(t: Array, q: Array) -> tuple[Any, Any]:
        of = evaluation(system, t, q, u)
        velocities = (
            [of(part.velocity) for part in system.parts],
            [of(part.angular_velocity) for part in turning_parts(system)],
            of(system.constraints),
        )
        forces = [of(load.load) for load in system.loads]
        return velocities, (forces, of(system.generalized_forces))

    _, rates, forces = jax.jvp(along, (t, q), (jnp.ones_like(t), q_dot), has_aux=True)
    return _Rates(*rates, *forces)


def speeds_of(
    system: KaneSystem, partials: Partials, u_independent: Float[Array, " i"]
) -> Speeds:
    """Every speed from the independent ones, by the constraints.

    Where all are independent, the allowed ones that are next by squares: what errors of
    steps leave of others then keeps its length, as the projection is orthogonal by a
    metric that does not change. By energy it would grow where the mass matrix changes,
    without bound, and leak into the motion.
    """
    size = system.speeds + system.auxiliary
    free = _places(size, system.independent, u_independent.dtype)
    u = free @ u_independent
    C = partials.by_speeds.constraints
    if C is None:
        return Speeds(u, free, jnp.zeros((size, 0), u.dtype))
    if system.by_multipliers:
        m = system.speeds
        M = masses_of(system, partials)[:m, :m]
        follow = -free @ followed(M, C[:, :m])
        least = next_to(C[:, :m])
        if system.side is not None:  # where they follow from each other motions part
            part = ~(share_by_multipliers(system, least) > 1.0)
            least = jnp.where(part, jnp.nan, least)
        nearest = -free @ least
        u = u + nearest @ partials.at("constraints", u)
        return Speeds(u, free + nearest @ (C @ free), follow)
    bound = _places(size, system.dependent, u.dtype)
    follow = -bound @ inverse_of(C @ bound)
    if system.side is not None:  # beyond where they are determined there is no motion
        follow = jnp.where(share_of(system, C) > 1.0, follow, jnp.nan)
    u = u + follow @ partials.at("constraints", u)
    return Speeds(u, free + follow @ (C @ free), follow)


def _places(size: int, chosen: Iterable[int], dtype: Any) -> Float[Array, "m k"]:
    """Puts chosen speeds into their places among all."""
    return jnp.asarray(np.eye(size)[:, list(chosen)], dtype)


def _assembled(
    system: KaneSystem,
    partials: Partials,
    rates: _Rates,
    u: Float[Array, " m"],
    q_dot: Float[Array, " n"],
) -> KaneEquations:
    """Mass matrix and forces from velocities, their derivatives, and loads."""
    masses = masses_of(system, partials)
    inertia_force = jnp.zeros_like(u)
    turned: list[Array] = partials.at("turnings", u)
    turnings = iter(
        zip(
            turned,
            partials.by_speeds.turnings,
            rates.turnings,
            strict=True,
        )
    )
    for part, v, V, a in zip(
        system.parts,
        partials.at("points", u),
        partials.by_speeds.points,
        rates.points,
        strict=True,
    ):
        if isinstance(part, RigidBody):
            w, W, alpha = next(turnings)
            inertia = system.number(part.inertia)
            moment = inertia @ alpha + cross(w, inertia @ w)
            inertia_force = inertia_force + W.T @ moment
            if part.own_axes:
                a = a + cross(w, v)
        inertia_force = inertia_force + system.number(part.mass) * (V.T @ a)
    fr = jnp.zeros_like(u)
    for by_speeds, load in zip(partials.by_speeds.on_loads, rates.loads, strict=True):
        fr = fr + by_speeds.T @ load
    if rates.generalized is not None:
        fr = fr + rates.generalized
    energy = energy_of(system, partials, u)
    return KaneEquations(masses, fr - inertia_force, fr, q_dot, energy)
