"""Two surfaces that roll on each other at one instant, and what drives them."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.local_geometry import LocalGeometry
from ..geometry.rotations import quaternion_rates, rotation_matrix
from ..geometry.small_linear import cross, dot, matvec, matvec_transposed
from ..geometry.surfaces import AbstractSurface
from ..validation.checks import FieldError
from .contact import Contact, rolling_contact

# orientation, contact on B, contact on A: what changes as A rolls; the last of shape
# (0,) where the normal determines the point
Place: TypeAlias = tuple[Array, Array, Array]


class RollingKinematics(eqx.Module):
    """A surface A that rolls on a surface B, at one instant.

    Vectors are on A's axes or on B's, as said; rates are those seen from B. What is of
    second order is None where no acceleration was given.

    Attributes:
        surface_a: What rolls.
        surface_b: What it rolls on.
        orientation: Quaternion, scalar first, A's axes to B's [1], shape (4,).
        contact_on_a: Coordinates of the contact on A; of a surface parametrized by its
            normal that normal, shape (k,).
        contact_on_b: On B, shape (m,).
        position: Origin of A [m], B's axes, shape (3,).
        point_on_a: Contact point [m], A's axes, shape (3,).
        point_on_b: The same point [m], B's axes, shape (3,).
        normal: Unit normal out of A [1], A's axes, shape (3,).
        angular_velocity: Of A against B [rad/s], A's axes, shape (3,).
        velocity: Of A's origin [m/s], B's axes, shape (3,).
        contact_velocity: Of the contact point along B [m/s], B's axes, shape (3,).
        slip: Of A's material point over B [m/s], B's axes, shape (3,).
        orientation_rate: [1/s], shape (4,).
        contact_on_a_rate: [1/s], shape (k,).
        contact_on_b_rate: [1/s], shape (m,).
        angular_acceleration: [rad/s^2], A's axes, shape (3,).
        acceleration: Of A's origin [m/s^2], B's axes, shape (3,).
        contact_acceleration: Rate of ``contact_velocity`` [m/s^2], shape (3,).
        contact_on_a_acceleration: [1/s^2], shape (k,).
        contact_on_b_acceleration: [1/s^2], shape (m,).

    Source: docs/theory.md, (1.3), (3.4), (3.5), (11.1).
    """

    surface_a: AbstractSurface
    surface_b: AbstractSurface
    orientation: Float[Array, "4"]
    contact_on_a: Float[Array, " k"]
    contact_on_b: Float[Array, " m"]
    position: Float[Array, "3"]
    point_on_a: Float[Array, "3"]
    point_on_b: Float[Array, "3"]
    normal: Float[Array, "3"]
    angular_velocity: Float[Array, "3"]
    velocity: Float[Array, "3"]
    contact_velocity: Float[Array, "3"]
    slip: Float[Array, "3"]
    orientation_rate: Float[Array, "4"]
    contact_on_a_rate: Float[Array, " k"]
    contact_on_b_rate: Float[Array, " m"]
    angular_acceleration: Float[Array, "3"] | None = None
    acceleration: Float[Array, "3"] | None = None
    contact_acceleration: Float[Array, "3"] | None = None
    contact_on_a_acceleration: Float[Array, " k"] | None = None
    contact_on_b_acceleration: Float[Array, " m"] | None = None

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        """``R_BA``, A's axes to B's [1], shape (3, 3)."""
        return _each(lambda now: rotation_matrix(now.orientation), self)

    @property
    def position_of_b(self) -> Float[Array, "3"]:
        """Origin of B [m], A's axes, shape (3,)."""
        return _each(lambda now: -matvec_transposed(now.rotation, now.position), self)

    @property
    def spin(self) -> Float[Array, ""]:
        """Angular velocity about the normal out of A [rad/s]."""
        return _each(lambda now: dot(now.normal, now.angular_velocity), self)

    @property
    def in_charts(self) -> "ContactCharts":
        """Montana's coordinates: both charts, the contact angle, and their rates."""
        return _each(_in_charts, self)


def _each(function: Callable[[RollingKinematics], Any], now: RollingKinematics) -> Any:
    """Of one instant, or of each of those along leading axes."""
    for _ in range(now.orientation.ndim - 1):
        function = jax.vmap(function)
    return function(now)


class ContactCharts(NamedTuple):
    """Contact coordinates in the charts of both surfaces.

    Attributes:
        on_a: Chart coordinates on A, shape (2,).
        on_b: On B, shape (2,).
        angle: ``theta``, in the tangent plane between e1 of A and e2 of B [rad].
        on_a_rate: [1/s], shape (2,).
        on_b_rate: [1/s], shape (2,).
        angle_rate: [rad/s].

    Source: docs/theory.md, (1.1), (3.1) to (3.3) with s = -1.
    """

    on_a: Float[Array, "2"]
    on_b: Float[Array, "2"]
    angle: Float[Array, ""]
    on_a_rate: Float[Array, "2"]
    on_b_rate: Float[Array, "2"]
    angle_rate: Float[Array, ""]


def _in_charts(now: RollingKinematics) -> ContactCharts:
    a, b = now.surface_a, now.surface_b

    def one(on_a: Array, on_b: Array, q: Array) -> tuple[Array, Array, Array]:
        chart_a, chart_b = a.chart_coordinates(on_a), b.chart_coordinates(on_b)
        E, E_b = a.chart_geometry(chart_a).frame, b.chart_geometry(chart_b).frame
        seen = matvec_transposed(rotation_matrix(q), E_b[:, 1])
        angle = jnp.arctan2(dot(seen, E[:, 1]), dot(seen, E[:, 0]))
        return chart_a, chart_b, angle

    at = now.contact_on_a, now.contact_on_b, now.orientation
    rates = now.contact_on_a_rate, now.contact_on_b_rate, now.orientation_rate
    found = cast("tuple[Any, Any]", jax.jvp(one, at, rates))
    return ContactCharts(*found[0], *found[1])


class Turned(eqx.Module):
    """A pair whose angular velocity and slip are given."""

    a: AbstractSurface
    b: AbstractSurface
    without_spin: bool = eqx.field(static=True)

    def contact(self, at: Place, drive: tuple[Array, Array]) -> Contact:
        """The contact at a place, for (w, U)."""
        (orientation, on_b, on_a), (w, slip) = at, drive
        free = self.without_spin
        return rolling_contact(
            *(self.a, self.b, orientation, w, on_b, on_a, None, slip, free)
        )


class Driven(eqx.Module):
    """A pair whose contact moves at a given rate on one of the surfaces."""

    a: AbstractSurface
    b: AbstractSurface
    on_b: bool = eqx.field(static=True)

    def angular_velocity(self, at: Place, rate: Array, spin: Array) -> Array:
        """Of A against B, A's axes; ``rate``: of the contact coordinates."""
        orientation, u_b, u_a = at
        R = rotation_matrix(orientation)
        if self.a.normal_map(self.b.is_flat) is not None:
            normal = -matvec_transposed(R, self.b.geometry(u_b).normal)
            u_a = _Completed(self.a, self.b)(normal)
        given, u, other, v = self.a, u_a, self.b, u_b
        if self.on_b:
            given, u, other, v = self.b, u_b, self.a, u_a

        def seen(u: Array) -> tuple[Array, Array]:
            found = given.geometry(u)
            return found.position, found.normal

        _, (travel, turn) = jax.jvp(seen, (u,), (rate,))
        travel = matvec_transposed(R, travel) if self.on_b else matvec(R, travel)
        opposite = turn_along(other.geometry(v), travel)
        n_a, n_b = (opposite, turn) if self.on_b else (turn, opposite)
        normal = self.a.geometry(u_a).normal
        # N' = Om x N + n_a' on A, -R^T n_b' on B: (3.4)
        lacking = -matvec_transposed(R, n_b) - n_a
        return cross(normal, lacking) + spin * normal

    def contact(self, at: Place, drive: tuple[Array, Array]) -> Contact:
        """The contact at a place, for (rate, spin)."""
        w = self.angular_velocity(at, *drive)
        turned = Turned(self.a, self.b, False)
        return turned.contact(at, (w, jnp.zeros_like(w)))


Drive: TypeAlias = Turned | Driven


def driven(
    where: str, surface_a: AbstractSurface, surface_b: AbstractSurface, on: str
) -> Driven:
    """A pair driven along one of its surfaces, or why it cannot be.

    Raises:
        FieldError: ``on`` is neither "a" nor "b", the other surface is an edge.
    """
    if on not in ("a", "b"):
        raise FieldError(f"{where}.on", on, "must be 'a' or 'b'", "name the surface")
    other, name = (surface_a, "surface_a") if on == "b" else (surface_b, "surface_b")
    if other.is_edge:
        raise FieldError(
            f"{where}.{name}",
            other,
            "is a sharp edge: the path of the contact does not say how it turns there",
            f"give the contact's path on it (on='{'a' if on == 'b' else 'b'}'), or a "
            "thin Torus",
        )
    return Driven(surface_a, surface_b, on == "b")


def turn_along(geometry: LocalGeometry, travel: Float[Array, "3"]) -> Array:
    """Rate of a surface's normal where its point moves by ``travel``, owner's axes."""
    pair = geometry.frame[:, :2]
    along = matvec_transposed(pair, travel)
    return -matvec(pair, matvec(geometry.shape_operator, along))


def as_long(quaternion: Float[Array, "4"], like: Float[Array, "4"]) -> Array:
    """A quaternion with the length of another one, of which it is a small turn."""
    return quaternion * jnp.sqrt(dot(like, like) / dot(quaternion, quaternion))


def rolled(drive: Drive, at: Place, given: tuple[Array, Array]) -> RollingKinematics:
    """First order: what :func:`rolling_kinematics` gives without accelerations.

    Args:
        drive: Both surfaces, and what moves them.
        at: Orientation and contact coordinates, on B and on A.
        given: What the drive takes.
    """
    contact = drive.contact(at, given)
    assert contact.orientation is not None
    assert contact.normal_rate is not None
    assert contact.slip is not None
    w, normal = contact.angular_velocity, contact.normal
    on_a, on_a_rate = at[2], contact.body_rates
    if drive.a.normal_map(drive.b.is_flat) is not None:
        own = contact.normal_rate - cross(w, normal)
        complete = _Completed(drive.a, drive.b)
        on_a, on_a_rate = jax.jvp(complete, (normal,), (own,))
    R, q = contact.rotation, as_long(contact.orientation, at[0])
    v = contact.slip - cross(w, contact.body_point)
    return RollingKinematics(
        surface_a=drive.a,
        surface_b=drive.b,
        orientation=q,
        contact_on_a=on_a,
        contact_on_b=at[1],
        position=contact.position,
        point_on_a=contact.body_point,
        point_on_b=contact.base_point,
        normal=normal,
        angular_velocity=w,
        velocity=matvec(R, v),
        contact_velocity=matvec(R, contact.velocity + contact.slip),
        slip=matvec(R, contact.slip),
        orientation_rate=quaternion_rates(q, w),
        contact_on_a_rate=on_a_rate,
        contact_on_b_rate=contact.base_rates,
    )


class _Completed(eqx.Module):
    """Coordinates on a surface whose point the normal determines."""

    a: AbstractSurface
    b: AbstractSurface

    def __call__(self, normal: Float[Array, "3"]) -> Array:
        if self.a.is_by_normal:
            return normal
        point = self.a.normal_map(self.b.is_flat)
        assert point is not None
        return self.a.at_edge(point(normal), normal)
