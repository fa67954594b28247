"""Contacts of a system's bodies at one instant: where they are and how they move.

Surfaces A and B with the axes of two bodies, one of which may be the ground. Vectors on
FIXED axes unless said otherwise.
"""

from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.local_geometry import LocalGeometry
from ..geometry.small_linear import (
    cross,
    dot,
    matmul,
    matvec,
    matvec_transposed,
)
from ..geometry.surfaces import AbstractSurface
from ..kinematics.contact import rates_on, rolled_over
from ..validation.user_functions import GivenFunction

# position of a surface's origin, rotation of its axes to fixed axes
Pose: TypeAlias = tuple[Array, Array]
# contact coordinates on B, and on A (of shape (0,) where the normal gives the point)
Places: TypeAlias = tuple[Array, Array]


class Axes(eqx.Module):
    """Functions that place a surface; None: at rest on the fixed axes."""

    position: GivenFunction | None
    rotation: GivenFunction | None

    def pose(self, t: Array, q: Array, u: Array, more: Any) -> Pose:
        """Origin [m] and rotation to fixed axes."""
        place, turn = jnp.zeros(3, q.dtype), jnp.eye(3, dtype=q.dtype)
        if self.position is not None:
            place = self.position(t, q, u, more)
        if self.rotation is not None:
            turn = self.rotation(t, q, u, more)
        return place, turn


class Touching(eqx.Module):
    """A pair of surfaces that touch, on the axes of their bodies."""

    on_a: Axes
    a: AbstractSurface
    on_b: Axes
    b: AbstractSurface
    without_spin: bool = eqx.field(static=True)

    @property
    def by_normal(self) -> bool:
        """Whether B's normal determines the point of A."""
        return self.a.normal_map(self.b.is_flat) is not None

    @property
    def coordinates(self) -> tuple[int, int]:
        """Numbers of contact coordinates, on B and on A."""
        own = 0 if self.by_normal else self.a.coordinate_count
        return self.b.coordinate_count, own


class Gap(NamedTuple):
    """What is left open of a contact.

    Attributes:
        rows: What has to be zero: the gap [m], fixed axes, and, where A has contact
            coordinates, its normal along B's tangents [1]; shape (3,) or (5,).
        to_base: A's axes to B's [1], shape (3, 3).
        normal: Out of A [1], A's axes, shape (3,).
        point_a: Contact point [m], A's axes, shape (3,).
        ground: B's geometry there.
        shell: A's; None where the normal determines the point.
    """

    rows: Array
    to_base: Float[Array, "3 3"]
    normal: Float[Array, "3"]
    point_a: Float[Array, "3"]
    ground: LocalGeometry
    shell: LocalGeometry | None


def gap_of(pair: Touching, poses: tuple[Pose, Pose], places: Places) -> Gap:
    """Where the surfaces of a pair are against each other.

    Args:
        pair: The pair.
        poses: Of A and of B.
        places: Contact coordinates, on B and on A.

    Source: docs/theory.md, (11.4).
    """
    (p_a, R_a), (p_b, R_b) = poses
    on_b, on_a = places
    to_base = matmul(R_b.T, R_a)
    ground = pair.b.geometry(on_b)
    opposite = -matvec_transposed(to_base, ground.normal)
    place_b = p_b + matvec(R_b, ground.position)
    point = pair.a.normal_map(pair.b.is_flat)
    if point is not None:
        point_a = point(opposite)
        rows = p_a + matvec(R_a, point_a) - place_b
        return Gap(rows, to_base, opposite, point_a, ground, None)
    shell = pair.a.geometry(on_a)
    rows = p_a + matvec(R_a, shell.position) - place_b
    turned = matvec(to_base, shell.normal)
    along = matvec_transposed(ground.frame[:, :2], turned)
    rows = jnp.concatenate([rows, along])
    return Gap(rows, to_base, shell.normal, shell.position, ground, shell)


class Moving(NamedTuple):
    """How a contact moves.

    Attributes:
        gap: Where it is.
        slip: Velocity of A's material point over B's [m/s], fixed axes; with
            ``without_spin`` the relative turn about the normal [rad/s] behind it.
        rates: Of the contact coordinates, on B and then on A [1/s].
    """

    gap: Gap
    slip: Array
    rates: Array


def moving(
    pair: Touching,
    poses: tuple[Pose, Pose],
    moved: tuple[Pose, Pose],
    places: Places,
) -> Moving:
    """How the contact of a pair moves.

    Args:
        pair: The pair.
        poses: Of A and of B.
        moved: Their rates.
        places: Contact coordinates, on B and on A.

    Source: docs/theory.md, (11.4), (11.5).
    """
    (_, R_a), (_, R_b) = poses
    (_, R_a_dot), (_, R_b_dot) = moved
    gap = gap_of(pair, poses, places)
    slip = velocity_between(gap, moved)
    base_turn = matvec_transposed(gap.to_base, turn_of(R_b, R_b_dot))
    relative = turn_of(R_a, R_a_dot) - base_turn
    if pair.without_spin:
        slip = jnp.concatenate([slip, dot(gap.normal, relative)[None]])
    turning = cross(gap.normal, relative)
    found = rolled_over(
        pair.a, pair.b, gap.shell, gap.ground, gap.to_base, gap.normal, turning
    )
    rates = [rates_on(pair.b, places[0], gap.ground, found.x_base)]
    if gap.shell is not None:
        assert found.x_body is not None
        rates.append(rates_on(pair.a, places[1], gap.shell, found.x_body))
    return Moving(gap, slip, jnp.concatenate(rates))


def velocity_between(gap: Gap, moved: tuple[Pose, Pose]) -> Float[Array, "3"]:
    """Velocity of A's material point at a contact over B's [m/s], fixed axes."""
    (v_a, R_a_dot), (v_b, R_b_dot) = moved
    point_b = gap.ground.position
    return v_a + matvec(R_a_dot, gap.point_a) - v_b - matvec(R_b_dot, point_b)


def closed(pair: Touching, poses: tuple[Pose, Pose], places: Places) -> Places:
    """Contact coordinates, on B and on A, moved to where the surfaces are nearest.

    One step of Newton's method, which is (3.4) with what is open in the place of
    velocities.

    Args:
        pair: The pair.
        poses: Of A and of B.
        places: Contact coordinates, on B and on A.

    Source: docs/theory.md, (11.6).
    """
    gap = gap_of(pair, poses, places)
    tilt = gap.normal + matvec_transposed(gap.to_base, gap.ground.normal)
    off = matvec_transposed(poses[0][1], gap.rows[:3])
    along = dot(gap.normal, off)
    found = rolled_over(
        *(pair.a, pair.b, gap.shell, gap.ground, gap.to_base, gap.normal, -tilt),
        off - along * gap.normal,
    )
    on_b, on_a = places
    on_b = on_b + rates_on(pair.b, on_b, gap.ground, found.x_base)
    if gap.shell is not None:
        assert found.x_body is not None
        on_a = on_a + rates_on(pair.a, on_a, gap.shell, found.x_body)
    return on_b, on_a


def turn_of(R: Float[Array, "3 3"], R_dot: Float[Array, "3 3"]) -> Array:
    """Angular velocity on the rotated axes [rad/s], of ``R^T R'``."""
    spun = matmul(R.T, R_dot)
    twice = jnp.stack(
        [spun[2, 1] - spun[1, 2], spun[0, 2] - spun[2, 0], spun[1, 0] - spun[0, 1]]
    )
    return 0.5 * twice


def directions_on(pair: Touching, gap: Gap, places: Places) -> list[Array]:
    """How the contact coordinates can be moved, on B and on A: (count, 2) each."""
    found: list[Array] = []
    surfaces = (pair.b, gap.ground, places[0]), (pair.a, gap.shell, places[1])
    for surface, geometry, u in surfaces:
        if geometry is None:
            continue
        known = geometry
        steps = jnp.eye(2, dtype=u.dtype)
        columns = [surface.coordinate_rates(u, known, x) for x in steps]
        found.append(jnp.stack(columns, axis=1))
    return found


def all_poses(
    pairs: tuple[Touching, ...], t: Array, q: Array, u: Array, more: Any
) -> list[tuple[Pose, Pose]]:
    """Poses of both bodies of every pair."""
    at = t, q, u, more
    return [(pair.on_a.pose(*at), pair.on_b.pose(*at)) for pair in pairs]
