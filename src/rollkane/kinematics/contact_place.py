"""Where one surface touches another, from what a user gives."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..codegen.compile_effort import for_one_call
from ..geometry.rotations import (
    multiply,
    quaternion_of,
    rotation_matrix,
    shortest_turn,
)
from ..geometry.small_linear import matvec_transposed, norm
from ..geometry.surfaces import AbstractSurface
from ..validation.checks import FieldError, is_traced, real, spoilt
from .rolling_pair import Place, as_long

# of a normal [rad], or of a coordinate beside its size: as much as the stages of an
# integrator's step may leave; it is put right by the smallest turn
_LOOSE = 1e-2


def check_surface(field: str, surface: object) -> None:
    """Refuse what is no surface.

    Raises:
        FieldError: it is none.
    """
    if not isinstance(surface, AbstractSurface):
        raise FieldError(field, surface, "is no surface", "give one of rollkane's")


def placed(
    where: str,
    a: AbstractSurface,
    b: AbstractSurface,
    contact_on_b: Any,
    turned: tuple[Any, Any],
    contact_on_a: Any,
) -> Place:
    """Where A is, from what was given, its normal opposite to B's."""
    for name, surface in (("surface_a", a), ("surface_b", b)):
        check_surface(f"{where}.{name}", surface)
    on_b = on_surface(f"{where}.contact_on_b", b, contact_on_b)
    orientation, angle = turned
    if (orientation is None) == (angle is None):
        raise FieldError(
            f"{where}.orientation",
            orientation,
            "and the angle say the same" if angle is not None else "is not given",
            "give either the orientation or the contact angle",
        )
    by_normal = a.normal_map(b.is_flat) is not None
    if contact_on_a is None:
        if not by_normal or orientation is None:
            raise FieldError(
                f"{where}.contact_on_a",
                None,
                "is not given, and does not follow",
                "give the contact coordinates on A",
            )
        q = real(f"{where}.orientation", orientation, (4,), "a quaternion")
        return q, on_b, jnp.zeros(0, q.dtype)
    on_a = on_surface(f"{where}.contact_on_a", a, contact_on_a)
    if angle is not None:
        turn = number(f"{where}.angle", angle)
        q = _by_angle(a, b, on_a, on_b, turn)
    else:
        q = real(f"{where}.orientation", orientation, (4,), "a quaternion")
        q, gap = aligned(a, b, q, on_a, on_b)
        q = _agreeing(where, q, gap)
    if by_normal and not a.is_by_normal:
        q = _reached(where, a, on_a, q)
    return q, on_b, on_a[:0] if by_normal else on_a


def _reached(where: str, a: AbstractSurface, on_a: Array, q: Array) -> Array:
    """The orientation, unless a plane cannot touch A at its given point."""
    off = _off_plane(a, on_a)
    if is_traced(off):
        return spoilt(q, ~(off < _LOOSE))
    if not float(off) < _LOOSE:
        raise FieldError(
            f"{where}.contact_on_a",
            on_a,
            "is where a plane cannot touch the surface",
            "give a point of its outer half",
        )
    return q


@for_one_call
def _off_plane(a: AbstractSurface, on_a: Array) -> Array:
    """How far a point is from that with its normal which planes touch, by its size."""
    point = a.normal_map(True)
    assert point is not None
    here = a.geometry(on_a)
    gap = jax.lax.stop_gradient(point(here.normal) - here.position)
    return norm(gap) / norm(jax.lax.stop_gradient(here.position))


def _agreeing(where: str, q: Array, gap: Array) -> Array:
    if is_traced(gap):
        return spoilt(q, ~(gap < _LOOSE))
    if not float(gap) < _LOOSE:
        raise FieldError(
            f"{where}.orientation",
            q,
            f"leaves {float(gap):.1e} rad between the normals of A and B, which must "
            "be opposite at the contact",
            "turn A, or give the contact angle in place of the orientation",
        )
    return q


@for_one_call
def aligned(
    a: AbstractSurface, b: AbstractSurface, q: Array, on_a: Array, on_b: Array
) -> tuple[Array, Array]:
    """The orientation, turned until the normals are opposite, and by how much [1]."""
    own = a.geometry(on_a).normal
    wanted = -matvec_transposed(rotation_matrix(q), b.geometry(on_b).normal)
    gap = norm(jax.lax.stop_gradient(own - wanted))
    return as_long(multiply(q, shortest_turn(own, wanted)), q), gap


@for_one_call
def _by_angle(
    a: AbstractSurface, b: AbstractSurface, on_a: Array, on_b: Array, angle: Array
) -> Array:
    """Orientation from the contact angle: docs/theory.md, (1.2) with s = -1."""
    E = a.chart_geometry(a.chart_coordinates(on_a)).frame
    E_b = b.chart_geometry(b.chart_coordinates(on_b)).frame
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    o = jnp.zeros_like(sin)
    rows = [[-sin, cos, o], [cos, sin, o], [o, o, o - 1.0]]
    S = jnp.stack([jnp.stack(row) for row in rows])
    return quaternion_of(E_b @ S @ E.T)


def on_surface(field: str, surface: AbstractSurface, value: Any) -> Array:
    """Contact coordinates, on their surface."""
    count = surface.coordinate_count
    u = real(field, value, (count,), f"{count} contact coordinates")
    u, off, extent = _settled(surface, u)
    bad = ~(off < _LOOSE) | ~(extent > 0.0)
    if is_traced(bad):
        return spoilt(u, bad)
    if bool(np.asarray(bad)):
        raise FieldError(
            field,
            u,
            "is no point of the surface",
            "give coordinates of a point on it (surface.locate finds them)",
        )
    return u


@for_one_call
def _settled(surface: AbstractSurface, u: Array) -> tuple[Array, Array, Array]:
    """Coordinates on their manifold, how far they were from it, and from its end."""
    on = surface.settled(u)
    gap, size = jax.lax.stop_gradient((on - u, u))
    off = jnp.sqrt(jnp.sum(gap * gap) / jnp.sum(size * size + jnp.ones_like(u)))
    end = surface.extent(u)
    return on, off, jnp.ones_like(off) if end is None else end


def number(field: str, value: Any) -> Array:
    """One number."""
    return real(field, value, (), "a number")
