"""States at which a system's equations do not determine its motion, refused clearly."""

from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..codegen.tracing import running_once
from ..integration.integrate import tolerances
from ..validation.checks import FieldError, is_traced
from .affinity import Samples, refuse_curved, sampled
from .configuration import Held, held, refuse_bound, refuse_free, refuse_violated
from .dependent_speeds import NEAR
from .equations import Reduced, reduced
from .implied_rows import Followed, followed_along, refuse_lost
from .linear_solves import SINGULAR
from .system import KaneState, KaneSystem
from .system_arguments import refuse_all


class Examined(NamedTuple):
    """What is asked of a system at a state; no more, so that no more is compiled.

    Attributes:
        mass_matrix: Of the independent speeds, shape (i, i).
        u: All speeds, shape (m,).
        q_dot: Rates of the coordinates, shape (n,).
        samples: Of what has to be affine in the speeds.
        by_speeds: Derivatives of the constraints by all speeds, shape (k, m); None
            without any.
        held: What becomes of the configuration; None without one.
        implied: What becomes of rows that follow from others; None without any.
    """

    mass_matrix: Float[Array, "i i"]
    u: Float[Array, " m"]
    q_dot: Float[Array, " n"]
    samples: Samples
    by_speeds: Float[Array, "k m"] | None
    held: Held | None
    implied: Followed | None


def refuse_start(
    system: KaneSystem,
    t: float | Array | np.ndarray,
    state: KaneState,
    rtol: float | Array | None = None,
) -> Examined | None:
    """Refuse a start from which the equations do not determine the motion, and say why.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
        rtol: Relative tolerance of the motion [1]; None for the default.

    Returns:
        What was looked at; None: numbers that are traced, or are none.

    Raises:
        FieldError: what ``refuse`` raises. Nothing is said of numbers that are still
            traced.
    """
    if is_traced(system, t, state):
        return None
    if not all(np.isfinite(x).all() for x in (state.q, state.u)):
        return None  # the run says it
    known = np.asarray(t, np.asarray(state.q).dtype)  # by JAX it could be traced
    found = _examined(system, cast(Array, known), state)
    refuse(system, t, state, found, rtol)
    return found


@for_one_call
@running_once()
def _examined(system: KaneSystem, t: Array, state: KaneState) -> Examined:
    return examined(system, t, state, reduced(system, t, state))


def examined(
    system: KaneSystem, t: Array, state: KaneState, equations: Reduced
) -> Examined:
    """What ``refuse`` looks at.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
        equations: At that state.
    """
    q_dot, implied = equations.of_all.q_dot, None
    if system.implied is not None:
        u_dot = equations.T @ equations.u_dot + equations.bias
        implied = followed_along(system, t, state.q, equations.u, q_dot, u_dot)
    return Examined(
        equations.mass_matrix,
        equations.u,
        q_dot,
        sampled(system, t, state),
        equations.partials.by_speeds.constraints,
        held(system, t, state, equations.partials),
        implied,
    )


@np.errstate(all="ignore")  # numbers that are not finite are asked for
def refuse(
    system: KaneSystem,
    t: float | Array | np.ndarray,
    state: KaneState,
    found: Examined,
    rtol: float | Array | None = None,
    eliminated: bool = False,
) -> None:
    """Refuse equations that do not determine the motion, and say why.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
        found: What was found there.
        rtol: Relative tolerance of the motion [1], if it is known; the default counts
            where it is smaller.
        eliminated: Whether the configuration has to determine the dependent
            coordinates.

    Raises:
        FieldError: velocities that are not affine in the speeds, coordinates that
            violate the configuration, kinematics that are not finite, constraints that
            depend on each other or do not keep the configuration, or that follow from
            others there alone, a mass matrix that is not positive definite.
    """
    where = f" at t = {float(t):g}, q = {np.asarray(state.q).tolist()}"
    loose = tolerances(None, None, np.asarray(state.q).dtype)[0]
    loose = loose if rtol is None or is_traced(rtol) else max(loose, float(rtol))
    refuse_curved(system, found.samples, where)
    refuse_violated(system, state, found.held, loose, where)
    if eliminated:
        refuse_bound(system, found.held, where)
    _refuse_undetermined(system, found, where)
    refuse_all(system.dependent, system.speeds)
    _refuse_parallel(system, found, where)
    _refuse_singular(system, found, where)
    refuse_lost(system, found.implied, loose, where)
    refuse_free(system, found.held, loose, where)


def _refuse_undetermined(system: KaneSystem, found: Examined, where: str) -> None:
    """Constraints from which the dependent speeds do not follow."""
    if found.by_speeds is None or system.by_multipliers:
        return
    C = np.asarray(found.by_speeds, float)
    rows = C / np.linalg.norm(C, axis=1, keepdims=True)
    bound = rows[:, list(system.dependent)]
    if not (np.isfinite(bound).all() and np.linalg.svd(bound)[1][-1] > NEAR):
        raise FieldError(
            "KaneSystem.constraints",
            system.dependent,
            "do not determine the dependent speeds" + where,
            "choose other dependent speeds, or leave out constraints that follow from "
            "others",
        )


def _refuse_parallel(system: KaneSystem, found: Examined, where: str) -> None:
    """Constraints by multipliers that follow from each other, or nearly so."""
    if found.by_speeds is None or not system.by_multipliers:
        return
    M = np.asarray(found.mass_matrix, float)
    if not _least_moment(M) > 0.0:
        return  # is refused for that
    C = np.asarray(found.by_speeds, float)[:, : M.shape[0]]
    many = C.shape[0] > C.shape[1]  # which cannot all be independent
    by_mass = np.linalg.solve(np.linalg.cholesky(M), C.T)
    rows = by_mass / np.linalg.norm(by_mass, axis=0)
    finite = np.isfinite(rows).all()
    if finite and not many and np.linalg.svd(rows)[1][-1] > NEAR:
        return
    raise FieldError(
        "KaneSystem.constraints",
        C.tolist(),
        "follow from each other, or nearly so" + where,
        "leave out those that follow from others",
    )


def _refuse_singular(system: KaneSystem, found: Examined, where: str) -> None:
    q_dot = np.asarray(found.q_dot)
    if not np.isfinite(q_dot).all():
        raise FieldError(
            "KaneSystem.kinematics",
            q_dot,
            "are singular" + where,
            "choose other coordinates (Euler parameters have no singular place)",
        )
    M = np.asarray(found.mass_matrix)
    if not _least_moment(M) > SINGULAR:
        raise FieldError(
            "KaneSystem.parts",
            M,
            "make a mass matrix that is not positive definite" + where,
            "let every independent speed move a mass",
        )


def _least_moment(M: np.ndarray) -> float:
    """The least eigenvalue of a mass matrix, of the largest; NaN of no numbers."""
    if not np.isfinite(M).all():
        return np.nan
    moments = np.linalg.eigvalsh(M)
    return float(moments[0] / abs(moments[-1]))
