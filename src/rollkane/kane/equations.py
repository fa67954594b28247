"""Kane's equations of a system at one instant: ``F_r + F_r* = 0``.

Partial velocities are derivatives of velocities by speeds; accelerations at rest of the
speeds are derivatives of velocities along the motion. Source: the collected equations'
section 8a (document [B], (1) to (6)).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float

from ..checks import FieldError, is_traced
from ..small_linear import components, cross, solve_spd
from .system import KaneState, KaneSystem, RigidBody

# of the scale of a matrix: a thousand roundings of double precision
_SINGULAR = 1e-12
_UNROLLED = 6  # larger systems are solved by lineax


class KaneEquations(NamedTuple):
    """Kane's equations of all speeds, ``mass_matrix u' = forcing``.

    The auxiliary speeds come last.

    Attributes:
        mass_matrix: Shape (m, m).
        forcing: ``F_r`` less the part of ``-F_r*`` without u', shape (m,).
        fr: Generalized active forces ``F_r``, shape (m,).
        q_dot: Rates of the coordinates, shape (n,).
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
        bias: ``T' u_i + s'``, what u' has without u_i', shape (m,).
    """

    u: Float[Array, " m"]
    T: Float[Array, "m i"]
    bias: Float[Array, " m"]


def kane_equations(system: KaneSystem, t, q, u) -> KaneEquations:
    """Mass matrix, forcing and generalized active forces.

    Args:
        system: The system.
        t: Time [s].
        q: Generalized coordinates, shape (n,).
        u: All generalized speeds, shape (speeds,) or with the auxiliary ones.

    Source: [B] (4); theory, section 8a.
    """
    q, u = _arrays(system, q, u)
    q_dot = system.kinematics(t, q, u)
    count = u.shape[0]
    M = jnp.zeros((count, count), u.dtype)
    inertia_force, fr = jnp.zeros_like(u), jnp.zeros_like(u)
    energy = jnp.zeros((), u.dtype)
    for part in system.parts:
        v, V, a = _moving(part.velocity, t, q, u, q_dot)
        w = None
        if isinstance(part, RigidBody):
            w, W, alpha = _moving(part.angular_velocity, t, q, u, q_dot)
            if part.own_axes:
                a = a + cross(w, v)
            H = part.inertia @ w
            M = M + W.T @ part.inertia @ W
            inertia_force = inertia_force + W.T @ (part.inertia @ alpha + cross(w, H))
            energy = energy + 0.5 * jnp.sum(w * H)
        M = M + part.mass * (V.T @ V)
        inertia_force = inertia_force + part.mass * (V.T @ a)
        energy = energy + 0.5 * part.mass * jnp.sum(v * v)
    for load in system.loads:
        V = jax.jacfwd(lambda u, v=load.velocity: v(t, q, u))(u)
        fr = fr + V.T @ load.load(t, q, u)
    if system.generalized_forces is not None:
        fr = fr + system.generalized_forces(t, q, u)
    return KaneEquations(M, fr - inertia_force, fr, q_dot, energy)


def all_speeds(system: KaneSystem, t, q, u_independent) -> Speeds:
    """Every speed from the independent ones, by the constraints.

    Args:
        system: The system.
        t: Time [s].
        q: Generalized coordinates, shape (n,).
        u_independent: Independent speeds.

    Where constraints depend on each other, the dependent speeds are NaN.
    """
    dtype = jnp.result_type(q, u_independent)
    size = system.speeds + system.auxiliary
    free = jnp.asarray(system.independent, int)
    u = jnp.zeros(size, dtype).at[free].set(u_independent)
    T = jnp.zeros((size, free.shape[0]), dtype)
    T = T.at[free, jnp.arange(free.shape[0])].set(1.0)
    constraints = system.constraints
    if constraints is None:
        return Speeds(u, T, jnp.zeros_like(u))
    bound = jnp.asarray(system.dependent, int)
    of = lambda u: constraints(t, q, u)
    C = jax.jacfwd(of)(u)
    C_d = _regular(C[:, bound])
    u = u.at[bound].set(-jnp.linalg.solve(C_d, of(u)))
    T = T.at[bound].set(-jnp.linalg.solve(C_d, C[:, free]))
    q_dot = system.kinematics(t, q, u)
    along = lambda t, q: constraints(t, q, u)
    change = jax.jvp(along, (t, q), (jnp.ones_like(t), q_dot))[1]
    bias = jnp.zeros_like(u).at[bound].set(-jnp.linalg.solve(C_d, change))
    return Speeds(u, T, bias)


def kane_derivative(system: KaneSystem, t, state: KaneState) -> KaneState:
    """Rates of coordinates and independent speeds: the right-hand side itself.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.

    Returns:
        Rates, as a state.
    """
    q_dot, u_dot, _ = _solved(system, t, state)
    free = jnp.asarray(system.independent, int)
    return KaneState(q_dot, u_dot[free])


def reactions(system: KaneSystem, t, state: KaneState) -> Float[Array, " a"]:
    """Generalized reactions against the auxiliary speeds, shape (auxiliary,).

    What has to act along each auxiliary speed so that it stays zero: with a speed that
    is a velocity of a point in one direction, the force on that point [N].
    """
    _, u_dot, equations = _solved(system, t, state)
    needed = equations.mass_matrix @ u_dot - equations.forcing
    return needed[system.speeds :]


def kinetic_energy(system: KaneSystem, t, state: KaneState) -> Float[Array, ""]:
    """Kinetic energy of a state [J]."""
    u = all_speeds(system, as_float(t), state.q, state.u).u
    return kane_equations(system, as_float(t), state.q, u).kinetic_energy


def _solved(system: KaneSystem, t, state: KaneState):
    """q', all u', and the equations they come from."""
    t = as_float(t)
    speeds = all_speeds(system, t, state.q, state.u)
    equations = kane_equations(system, t, state.q, speeds.u)
    M, T = equations.mass_matrix, speeds.T
    reduced = T.T @ M @ T
    forcing = T.T @ (equations.forcing - M @ speeds.bias)
    u_dot = T @ _solve(reduced, forcing) + speeds.bias
    return equations.q_dot, u_dot, equations


def _solve(M: Float[Array, "m m"], rhs: Float[Array, " m"]) -> Float[Array, " m"]:
    """A symmetric positive definite system, unrolled where it is small."""
    size = rhs.shape[0]
    if size <= _UNROLLED:
        rows = [components(M[i, : i + 1]) for i in range(size)]
        return jnp.stack(solve_spd(rows, components(rhs)))
    operator = lx.MatrixLinearOperator(M, lx.positive_semidefinite_tag)
    return lx.linear_solve(operator, rhs, lx.Cholesky(), throw=False).value


def as_float(t) -> Array:
    """A time [s] as an array of floats."""
    return jnp.asarray(t, jnp.result_type(t, float))


def _arrays(system: KaneSystem, q, u) -> tuple[Array, Array]:
    q, u = jnp.asarray(q), jnp.asarray(u)
    if u.shape[0] == system.speeds and system.auxiliary:
        u = jnp.concatenate([u, jnp.zeros(system.auxiliary, u.dtype)])
    return q, u


def _moving(velocity, t, q, u, q_dot):
    """A velocity, its derivative by the speeds, its rate while they are constant."""
    V = jax.jacfwd(lambda u: velocity(t, q, u))(u)
    along = lambda t, q: velocity(t, q, u)
    v, bias = jax.jvp(along, (t, q), (jnp.ones_like(t), q_dot))
    return v, V, bias


def _regular(C: Float[Array, "k k"]) -> Float[Array, "k k"]:
    """NaN where the constraints do not determine the dependent speeds."""
    pivot = jnp.abs(jnp.linalg.det(C))
    scale = jnp.prod(jnp.sqrt(jnp.sum(C * C, axis=1)))
    return jnp.where(pivot > _SINGULAR * scale, C, jnp.nan)


def refuse_singular(system: KaneSystem, t, state: KaneState) -> None:
    """Refuse a state at which the equations do not determine the motion, and say why.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.

    Raises:
        FieldError: kinematics that are not finite, constraints that depend on each
            other, a mass matrix that is not positive definite. Nothing is said of
            numbers that are still traced.
    """
    if is_traced(system, t, state):
        return
    t = as_float(t)
    where = f" at t = {float(t):g}, q = {np.asarray(state.q).tolist()}"
    speeds = all_speeds(system, t, state.q, state.u)
    if not np.isfinite(speeds.u).all():
        raise FieldError(
            "KaneSystem.constraints",
            system.dependent,
            "do not determine the dependent speeds" + where,
            "choose other dependent speeds, or leave out constraints that follow from "
            "others",
        )
    equations = kane_equations(system, t, state.q, speeds.u)
    if not np.isfinite(equations.q_dot).all():
        raise FieldError(
            "KaneSystem.kinematics",
            np.asarray(equations.q_dot),
            "are singular" + where,
            "choose other coordinates (Euler parameters have no singular place)",
        )
    M = np.asarray(speeds.T.T @ equations.mass_matrix @ speeds.T)
    moments = np.linalg.eigvalsh(M) if np.isfinite(M).all() else np.array([np.nan])
    if not moments[0] > _SINGULAR * abs(moments[-1]):
        raise FieldError(
            "KaneSystem.parts",
            M,
            "make a mass matrix that is not positive definite" + where,
            "let every independent speed move a mass",
        )
