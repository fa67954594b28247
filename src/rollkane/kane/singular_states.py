"""States at which a system's equations do not determine its motion, refused clearly."""

from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..integration.integrate import tolerances
from ..validation.checks import FieldError, is_traced
from .affinity import Samples, refuse_curved, sampled
from .configuration import Held, held, refuse_bound, refuse_free, refuse_violated
from .equations import Reduced, reduced
from .implied_rows import Followed, followed_along, refuse_lost
from .linear_solves import SINGULAR
from .system import KaneState, KaneSystem


class Examined(NamedTuple):
    """What is asked of a system at a state; no more, so that no more is compiled.

    Attributes:
        mass_matrix: Of the independent speeds, shape (i, i).
        u: All speeds, shape (m,).
        q_dot: Rates of the coordinates, shape (n,).
        samples: Of what has to be affine in the speeds.
        held: What becomes of the configuration; None without one.
        implied: What becomes of rows that follow from others; None without any.
    """

    mass_matrix: Float[Array, "i i"]
    u: Float[Array, " m"]
    q_dot: Float[Array, " n"]
    samples: Samples
    held: Held | None
    implied: Followed | None


def refuse_start(
    system: KaneSystem,
    t: float | Array | np.ndarray,
    state: KaneState,
    rtol: float | Array | None = None,
) -> None:
    """Refuse a start from which the equations do not determine the motion, and say why.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
        rtol: Relative tolerance of the motion [1]; None for the default.

    Raises:
        FieldError: what ``refuse`` raises. Nothing is said of numbers that are still
            traced.
    """
    if not is_traced(system, t, state):
        known = np.asarray(t, np.asarray(state.q).dtype)  # by JAX it could be traced
        refuse(system, t, state, _examined(system, cast(Array, known), state), rtol)


@for_one_call
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
    _refuse_singular(system, found, where)
    refuse_lost(system, found.implied, loose, where)
    refuse_free(system, found.held, loose, where)


def _refuse_singular(system: KaneSystem, found: Examined, where: str) -> None:
    if not np.isfinite(found.u).all():
        raise FieldError(
            "KaneSystem.constraints",
            system.dependent,
            "do not determine the dependent speeds" + where,
            "choose other dependent speeds, or leave out constraints that follow from "
            "others",
        )
    q_dot = np.asarray(found.q_dot)
    if not np.isfinite(q_dot).all():
        raise FieldError(
            "KaneSystem.kinematics",
            q_dot,
            "are singular" + where,
            "choose other coordinates (Euler parameters have no singular place)",
        )
    M = np.asarray(found.mass_matrix)
    moments = np.linalg.eigvalsh(M) if np.isfinite(M).all() else np.array([np.nan])
    if not moments[0] > SINGULAR * abs(moments[-1]):
        raise FieldError(
            "KaneSystem.parts",
            M,
            "make a mass matrix that is not positive definite" + where,
            "let every independent speed move a mass",
        )
