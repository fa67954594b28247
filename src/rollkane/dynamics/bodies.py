"""The rolling body: its mass, its inertia and its surface."""

import warnings
from collections.abc import Sequence
from typing import Any, TypeAlias, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..geometry.small_linear import components, dot
from ..geometry.surfaces import AbstractSurface
from ..validation.checks import FieldError, is_traced, positive, real, refuse
from ..validation.shown import described
from .precision import at_precision

# What a user writes for three numbers, and for three rows of them.
Vector: TypeAlias = ArrayLike | Sequence[ArrayLike]
Matrix: TypeAlias = ArrayLike | Sequence[Vector]
# Numbers whose values are looked at: an array of NumPy's, or one that is traced.
_Known: TypeAlias = np.ndarray | Array


class Body(eqx.Module):
    """A rigid body that rolls by its surface.

    Attributes:
        mass: [kg].
        center_of_mass: From the body origin O, body axes [m], shape (3,).
        inertia: About the CENTRE OF MASS, body axes, tensor entries (off-diagonal
            entries are minus the products of inertia) [kg m^2], shape (3, 3).
        surface: Outer surface, body axes.
    """

    mass: Float[Array, ""]
    center_of_mass: Float[Array, "3"]
    inertia: Float[Array, "3 3"]
    surface: AbstractSurface

    def __init__(
        self,
        mass: ArrayLike,
        inertia: Matrix,
        surface: AbstractSurface,
        center_of_mass: Vector = (0.0, 0.0, 0.0),
    ):
        """Make a body.

        Args:
            mass: The mass [kg], positive.
            inertia: The 3 x 3 tensor about the CENTRE OF MASS, body axes [kg m^2],
                off-diagonal entries minus the products of inertia. Symmetric, positive
                definite, no principal moment larger than the sum of the others.
            surface: Outer surface, body axes.
            center_of_mass: Three lengths from the body origin, body axes [m].

        Raises:
            FieldError: a value that no body can have.

        Warns:
            UserWarning: a mass centre outside of a sphere or an ellipsoid about the
                body origin.
        """
        self.mass = positive("Body.mass", mass, (), "the mass in kg")
        self.center_of_mass = real(
            "Body.center_of_mass", center_of_mass, (3,), "three lengths in metres"
        )
        self.inertia = checked_inertia("Body.inertia", inertia)
        if not isinstance(cast(object, surface), AbstractSurface):
            raise FieldError(
                "Body.surface",
                surface,
                "must be a surface",
                "give one of the catalogue, for example Sphere(radius=0.1)",
            )
        self.surface = surface
        _warn_of_outside(surface, self.center_of_mass)

    def __repr__(self) -> str:
        """Its numbers, with units, in a few lines."""
        return described(self)


def _warn_of_outside(surface: AbstractSurface, center: Array) -> None:
    """Warn of a known mass centre outside of the surface's convex hull."""
    if is_traced(surface, center):
        return
    hull = surface.hull
    if hull is not None and not hull(np.asarray(center, float)):
        warnings.warn(
            f"Body.center_of_mass {np.asarray(center).tolist()} m lies outside of the "
            f"body's {type(surface).__name__}: is it in metres, and from the body's "
            "origin?",
            stacklevel=3,
        )


def checked_inertia(
    field: str, inertia: Matrix, thin: bool = False
) -> Float[Array, "3 3"]:
    """An inertia tensor about a mass centre that some distribution of mass can have.

    Args:
        field: Name used in the error.
        inertia: Tensor [kg m^2], shape (3, 3).
        thin: Whether a moment may be zero: a rod, or a point.

    Raises:
        FieldError: not symmetric, not positive definite, or against the triangle
            inequality.
    """
    tensor = real(field, inertia, (3, 3), "the 3 x 3 tensor in kg m^2")
    # rounding of the user's own arithmetic: 1e-9 of the largest entry is 1e7 ulp
    slack = at_precision(1e-9, tensor)

    def not_symmetric(t: _Known) -> Any:
        return abs(t - t.T).max() > slack * abs(t).max()

    def not_definite(t: _Known) -> Any:
        least = _principal_moments(t)[0]
        return least < -slack * abs(t).max() if thin else least <= 0

    tensor = refuse(
        tensor,
        not_symmetric,
        field,
        "must be symmetric",
        "write entry (i, j) equal to entry (j, i)",
    )
    tensor = refuse(
        tensor,
        not_definite,
        field,
        "must be positive definite",
        "check the signs: off-diagonal tensor entries are minus the products of "
        "inertia",
    )

    def breaks_triangle(t: _Known) -> Any:
        small, middle, large = _principal_moments(t)
        return large - middle - small > slack * abs(t).max()

    return refuse(
        tensor,
        breaks_triangle,
        field,
        "violates the triangle inequality (one principal moment exceeds the sum of "
        "the others), which no distribution of mass can",
        "check the units, and that the tensor is about the centre of mass",
    )


def _principal_moments(tensor: _Known) -> Any:
    library: Any = np if isinstance(tensor, np.ndarray) else jnp
    return library.linalg.eigvalsh(0.5 * (tensor + tensor.T))


def inertia_about(
    mass: Array, arm: Float[Array, "3"], inertia: Float[Array, "3 3"]
) -> list[list[Array]]:
    """Lower triangle of a body's inertia about a point [kg m^2].

    Args:
        mass: [kg].
        arm: Centre of mass from the point [m].
        inertia: About the centre of mass [kg m^2].

    Returns:
        Rows of ``I + m (|c|^2 - c c^T)``, row i with i + 1 entries.

    Source: docs/theory.md, (4.3): the body's part of Th^M.
    """
    weighted = components(mass * arm)
    along = components(arm)
    square = dot(arm, mass * arm)
    rows: list[list[Array]] = []
    for i, row in enumerate(components(inertia)):
        entries = components(row)
        rows.append([entries[j] - weighted[i] * along[j] for j in range(i)])
        rows[i].append(entries[i] + (square - weighted[i] * along[i]))
    return rows
