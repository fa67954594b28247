"""States at which a system's equations do not determine its motion, refused clearly."""

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import FieldError, is_traced
from ..one_call import for_one_call
from .equations import (
    SINGULAR,
    Reduced,
    Velocities,
    partials_of,
    reduced,
    values_of,
)
from .system import KaneState, KaneSystem

# roundings of a velocity's sum of products, in single precision, too
_AFFINE = 1e-4


def refuse_singular(system: KaneSystem, t, state: KaneState) -> None:
    """Refuse a state at which the equations do not determine the motion, and say why.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.

    Raises:
        FieldError: what ``refuse`` raises. Nothing is said of numbers that are still
            traced.
    """
    if not is_traced(system, t, state):
        known = np.asarray(t, np.asarray(state.q).dtype)  # by JAX it could be traced
        refuse(system, t, state, *_examined(system, known, state))


@for_one_call
def _examined(system: KaneSystem, t, state: KaneState):
    return reduced(system, t, state), curvature(system, t, state)


def curvature(system: KaneSystem, t, state: KaneState) -> Velocities:
    """By how much each function is not affine in the speeds, of its size [1]."""
    at_rest, by_speeds = partials_of(system, t, state.q)
    size = system.speeds + system.auxiliary
    u = jnp.linspace(1.0, 2.0, size, dtype=state.q.dtype)  # any other than rest

    def of_its_size(v, v0, V):
        return jnp.max(jnp.abs(v - v0 - V @ u) / (1.0 + jnp.abs(v)))

    found = values_of(system, t, state.q, u)
    return jax.tree.map(of_its_size, found, at_rest, by_speeds)


def refuse(
    system: KaneSystem, t, state: KaneState, equations: Reduced, curved: Velocities
) -> None:
    """Refuse equations that do not determine the motion, and say why.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
        equations: At that state.
        curved: ``curvature`` there.

    Raises:
        FieldError: velocities that are not affine in the speeds, kinematics that are
            not finite, constraints that depend on each other, a mass matrix that is
            not positive definite.
    """
    where = f" at t = {float(t):g}, q = {np.asarray(state.q).tolist()}"
    _refuse_curved(curved, where)
    if not np.isfinite(equations.u).all():
        raise FieldError(
            "KaneSystem.constraints",
            system.dependent,
            "do not determine the dependent speeds" + where,
            "choose other dependent speeds, or leave out constraints that follow from "
            "others",
        )
    q_dot = np.asarray(equations.of_all.q_dot)
    if not np.isfinite(q_dot).all():
        raise FieldError(
            "KaneSystem.kinematics",
            q_dot,
            "are singular" + where,
            "choose other coordinates (Euler parameters have no singular place)",
        )
    M = np.asarray(equations.mass_matrix)
    moments = np.linalg.eigvalsh(M) if np.isfinite(M).all() else np.array([np.nan])
    if not moments[0] > SINGULAR * abs(moments[-1]):
        raise FieldError(
            "KaneSystem.parts",
            M,
            "make a mass matrix that is not positive definite" + where,
            "let every independent speed move a mass",
        )


def _refuse_curved(curved: Velocities, where: str) -> None:
    names = {
        "points": "parts[{}].velocity",
        "turnings": "parts' angular_velocity ({} of those that turn)",
        "on_loads": "loads[{}].velocity",
        "constraints": "constraints",
        "kinematics": "kinematics",
    }
    for kind, name in names.items():
        for k, amount in enumerate(jax.tree.leaves(getattr(curved, kind))):
            if float(amount) > _AFFINE:
                raise FieldError(
                    f"KaneSystem.{name.format(k)}",
                    float(amount),
                    "is not affine in the speeds" + where,
                    "let speeds stand alone, times functions of t and q",
                )
