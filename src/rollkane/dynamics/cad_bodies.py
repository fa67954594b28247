"""A body from the mass properties that CAD systems print."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from ..geometry.rotations import rotation_matrix
from ..geometry.surfaces import AbstractSurface
from ..validation.checks import FieldError, positive, real, refuse
from .bodies import Body, Matrix, Vector, checked_inertia
from .solid_bodies import rounded

_MASSES = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237}
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
_SIGNS = {"tensor": 1.0, "integrals": -1.0}
_ABOUT = ("center of mass", "origin")
_ROUGH = 1e-6  # of a quaternion's length: what six written digits leave
_WRITTEN = 1e-7  # of the largest: a printed zero is no smaller number
_FIELD = "body_from_cad"


def body_from_cad(
    mass: ArrayLike,
    inertia: Matrix,
    surface: AbstractSurface,
    *,
    center_of_mass: Vector,
    about: str,
    products: str,
    units: tuple[str, str] = ("kg", "m"),
    origin: Vector = (0.0, 0.0, 0.0),
    orientation: Vector = (1.0, 0.0, 0.0, 0.0),
) -> Body:
    """A body from mass properties as a CAD system prints them, on the CAD model's axes.

    The library wants the inertia about the centre of mass, on axes of the body's
    surface, with minus the products of inertia off the diagonal. CAD systems print it
    about several points and with either sign: which, has to be said.

    Args:
        mass: [units[0]], positive.
        inertia: Moments and products [units[0] units[1]^2], shape (3, 3), on axes
            parallel to the model's: ``[[Ixx, Ixy, Ixz], [Iyx, ...], ...]``.
        surface: The body's surface [m], on its own axes about its own origin.
        center_of_mass: On the model's axes from the model's origin [units[1]], shape
            (3,).
        about: The point that the inertia is about: ``"center of mass"`` or
            ``"origin"``, the model's.
        products: What ``Ixy`` and the like are: ``"tensor"``, minus the integral of
            ``x y dm`` (most systems; where they are called entries of the tensor, or
            "negative tensor notation"), or ``"integrals"``, plus it ("positive tensor
            notation").
        units: Of mass: kg, g, t, lb; and of length: m, cm, mm, in, ft.
        origin: Where the surface's origin is in the model [units[1]], shape (3,).
        orientation: Unit quaternion, scalar first, that turns components on the
            surface's axes into components on the model's [1], shape (4,); a matrix by
            :func:`rollkane.orientation_from_matrix`.

    Returns:
        The body, in SI units, on the surface's axes.

    Raises:
        FieldError: words or units that are not known; a tensor that is not symmetric,
            not positive definite about the centre of mass, or against the triangle
            inequality there.

    Source: the parallel axis theorem, ``I_C = I_O - m (|c|^2 1 - c c^T)``.
    """
    sign = _SIGNS[_word("products", products, tuple(_SIGNS))]
    _word("about", about, _ABOUT)
    kilograms, metres = _factors(units)
    m = kilograms * jnp.asarray(positive(f"{_FIELD}.mass", mass, (), "the mass"))
    printed = real(f"{_FIELD}.inertia", inertia, (3, 3), "three rows of three numbers")
    lengths = "three lengths on the model's axes"
    c = metres * real(f"{_FIELD}.center_of_mass", center_of_mass, (3,), lengths)
    o = metres * real(f"{_FIELD}.origin", origin, (3,), lengths)
    signs = sign + (1.0 - sign) * np.eye(3)  # products by the sign, moments as they are
    tensor = kilograms * metres**2 * printed * signs
    if about == "origin":
        tensor = tensor - m * (c @ c * np.eye(3) - c[:, None] * c[None, :])
    tensor = checked_inertia(f"{_FIELD}.inertia", _even(tensor))
    turn = _rotation(orientation)
    turned = turn.T @ tensor @ turn
    size = tensor[0, 0] + tensor[1, 1] + tensor[2, 2]
    own = rounded(0.5 * (turned + turned.T), size)
    arm = rounded(turn.T @ (c - o), jnp.sqrt(size / m))
    return Body(m, own, surface, arm)


def _even(tensor: Array) -> Array:
    """A tensor whose pairs of products differ by the last digits that were printed."""

    def differs(t: Any) -> Any:
        return abs(t - t.T).max() > _WRITTEN * abs(t).max()

    field = f"{_FIELD}.inertia"
    remedy = "write entry (i, j) equal to entry (j, i)"
    tensor = refuse(tensor, differs, field, "must be symmetric", remedy)
    return 0.5 * (tensor + tensor.T)


def _word(name: str, given: object, known: tuple[str, ...]) -> str:
    """One of the words that an argument may be."""
    if isinstance(given, str) and given in known:
        return given
    listed = " or ".join(f'"{x}"' for x in known)
    raise FieldError(f"{_FIELD}.{name}", given, "is not known", f"give {listed}")


def _factors(units: object) -> tuple[float, float]:
    """Kilograms and metres that the units are."""
    try:
        mass, length = units  # pyright: ignore
        return _MASSES[mass], _LENGTHS[length]
    except (TypeError, ValueError, KeyError) as error:
        known = f"{', '.join(_MASSES)} and one of {', '.join(_LENGTHS)}"
        remedy = f'give one of {known}, such as ("g", "mm")'
        raise FieldError(f"{_FIELD}.units", units, "are not known", remedy) from error


def _rotation(orientation: Vector) -> Array:
    """Rotation matrix from the surface's to the model's axes."""
    field = f"{_FIELD}.orientation"
    given = real(field, orientation, (4,), "a quaternion, scalar first")

    def wrong(q: Any) -> Any:
        return ~(abs((q * q).sum() - 1.0) < _ROUGH)

    remedy = "divide it by its length"
    q = refuse(given, wrong, field, "must be a quaternion of unit length", remedy)
    return rotation_matrix(jnp.asarray(q))
