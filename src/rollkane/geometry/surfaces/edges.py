"""Sharp edges: the rim of a solid disc, and a ring of wire.

Both are the circle z = 0 about the z axis. They differ where the disc's plane touches
the other surface: the contact of a ring goes on round the wire, that of a disc passes
on to its face.
"""

from typing import ClassVar, cast

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ...validation.checks import positive
from ..local_geometry import LocalGeometry
from ..small_linear import components, dot, inverse_sqrt, norm
from .directions import NormalHeading, PointOfNormal, Range
from .kinds import AbstractNormalSurface, AbstractPointSurface

_AROUND = 128  # samples of a ring: a twentieth of its radius apart
_ON_FACE = 416  # of a disc: a twelfth of its radius


def in_plane(normal: Float[Array, "3"]) -> Float[Array, "2"]:
    """The part of a normal in the plane of a ring; it vanishes where that lies flat."""
    return normal[:2]


def _rim_point(radius: Array, normal: Float[Array, "3"]) -> Float[Array, "3"]:
    """Point of a rim below the normal's part in its plane; free of trigonometry."""
    n1, n2, _ = components(normal)
    stretch = radius * inverse_sqrt(n1 * n1 + n2 * n2)
    return jnp.stack([n1 * stretch, n2 * stretch, jnp.zeros_like(stretch)])


def _on_wire(
    radius: Float[Array, ""], along: Float[Array, "2"], across: Float[Array, "2"]
) -> LocalGeometry:
    """Geometry of a wire without thickness.

    Args:
        radius: Of the circle [m].
        along: Direction of the point from the centre, (cos, sin).
        across: Direction of the normal round the wire: its parts away from the centre
            and along z, (cos, sin).
    """
    (c, s), (out, up) = components(along), components(across)
    zero, one = jnp.zeros_like(c), jnp.ones_like(c)
    frame = [[-s, -up * c, out * c], [c, -up * s, out * s], [zero, out, up]]
    return LocalGeometry(
        position=jnp.stack([radius * c, radius * s, zero]),
        frame=jnp.stack([jnp.stack(row) for row in frame]),
        lengths=jnp.stack([jnp.stack([radius * one, zero]), jnp.stack([zero, zero])]),
        frame_rates=jnp.stack([jnp.stack([-out, zero]), jnp.stack([zero, -one])]),
        spin_rates=jnp.stack([up, zero]),
    )


def _unit(pair: Float[Array, "2"]) -> Float[Array, "2"]:
    return pair * inverse_sqrt(dot(pair, pair))


def _of_angle(angle: Float[Array, ""]) -> Float[Array, "2"]:
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])


class DiscEdge(AbstractNormalSurface):
    """The sharp circular rim of a thin solid disc in the plane z = 0, axis z.

    Its normals point out of the disc, never along z: where the disc comes to lie on its
    face, the contact leaves the rim and a run ends with ``Code.SURFACE_EDGE``, and so
    does a flight that ends on the face. A wire, whose contact goes round and through
    which a base may come, is a :class:`Ring`.

    Attributes:
        radius: [m].
    """

    is_edge: ClassVar[bool] = True
    has_face: ClassVar[bool] = True
    radius: Float[Array, ""]

    def __init__(self, radius: ArrayLike):
        """Make a rim.

        Args:
            radius: The radius of the rim [m], positive.

        Raises:
            FieldError: a radius that is not positive.
        """
        self.radius = positive("DiscEdge.radius", radius, (), "a length in metres")

    @property
    def is_convex(self) -> bool:
        """True: the disc is."""
        return True

    def point_with_normal(self, normal: Float[Array, "3"]) -> Float[Array, "3"]:
        """Rim point below the normal's part in the plane of the disc [m]."""
        return _rim_point(self.radius, normal)

    def normal_heading(self, against_plane: bool) -> NormalHeading:
        """The normal's part in the plane of the disc."""
        del against_plane
        return in_plane

    def face_rim(self) -> "Ring":
        """The rim as a wire: its points have normals inwards, too."""
        return Ring(self.radius)

    def face_samples(self) -> np.ndarray:
        """Points of a disc of radius one, each once: along a spiral, as seeds grow."""
        count = np.arange(_ON_FACE)
        radius, angle = np.sqrt((count + 0.5) / _ON_FACE), np.pi * (3 - 5**0.5) * count
        flat = [radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle]
        return np.stack(flat, axis=-1)

    def face_point(self, sample: Float[Array, "3"]) -> Float[Array, "3"]:
        """The point of the disc itself [m]."""
        return self.radius * sample

    def face_extent(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Squared length that is left to the rim [m^2]."""
        return self.radius**2 - dot(point[:2], point[:2])

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Normal in the plane of the disc; an edge has a fan of others."""
        flat = point * jnp.array([1.0, 1.0, 0.0], point.dtype)
        return flat / norm(flat)

    def at_edge(
        self, point: Float[Array, "3"], normal: Float[Array, "3"]
    ) -> Float[Array, "3"]:
        """Coordinates where the outward normal is the given one."""
        del point
        return normal / norm(normal)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Rim point at longitude q1 [rad], whatever the latitude of the normal [m]."""
        return self.chart_geometry(q).position

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Geometry in longitude and latitude of the normal."""
        return _on_wire(self.radius, _of_angle(q[0]), _of_angle(q[1]))

    def chart_extent(self, q: Float[Array, "2"]) -> Float[Array, ""]:
        """Cosine of the latitude: zero where the normal is the face's."""
        return jnp.cos(q[1])


class Ring(AbstractPointSurface):
    """A ring of thin wire in the plane z = 0, axis z.

    Every point of it has a full circle of normals, so that its contact with a curved
    base goes on round the wire. Coordinates, on a curved base: the direction of the
    point from the centre, and that of the normal round the wire, each a pair of any
    length. On a plane the normal gives the point, as of :class:`DiscEdge`.

    Attributes:
        radius: [m].
    """

    coordinate_count = 4
    is_edge: ClassVar[bool] = True
    is_wire: ClassVar[bool] = True
    radius: Float[Array, ""]

    def __init__(self, radius: ArrayLike):
        """Make a ring.

        Args:
            radius: The radius of the ring [m], positive.

        Raises:
            FieldError: a radius that is not positive.
        """
        self.radius = positive("Ring.radius", radius, (), "a length in metres")

    @property
    def is_convex_on_plane(self) -> bool:
        """True: the lowest point is that of the disc which the ring encloses."""
        return True

    def normal_map(self, against_plane: bool) -> PointOfNormal | None:
        """On a plane, the lowest point by the normal; else None."""
        if not against_plane:
            return None
        return lambda normal: _rim_point(self.radius, normal)

    def normal_heading(self, against_plane: bool) -> NormalHeading | None:
        """On a plane, the normal's part in the plane of the ring."""
        return in_plane if against_plane else None

    def geometry(self, u: Float[Array, "4"]) -> LocalGeometry:
        """Local geometry, in the angles along the ring and round the wire."""
        return _on_wire(self.radius, _unit(u[:2]), _unit(u[2:]))

    @property
    def directions(self) -> tuple[tuple[int, int], ...]:
        """From the centre, and of the normal."""
        return (0, 2), (2, 4)

    def coordinate_rates(
        self, u: Float[Array, "4"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, "4"]:
        """Rates of both pairs, turning by ``x``."""
        del geometry
        (a, b, c, d), (along, across) = components(u), components(x)
        return jnp.stack([-b * along, a * along, -d * across, c * across])

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "4"]:
        """The point next to a point, with the normal away from the centre."""
        out = jnp.array([1.0, 0.0], point.dtype)
        return jnp.concatenate([_unit(point[:2]), out])

    def at_edge(
        self, point: Float[Array, "3"], normal: Float[Array, "3"]
    ) -> Float[Array, "4"]:
        """Coordinates of the point next to a point, with the given normal."""
        along = _unit(point[:2])
        across = jnp.stack([dot(along, normal[:2]), normal[2]])
        return jnp.concatenate([along, _unit(across)])

    def find_normal(
        self, normal: Float[Array, "3"], near: Float[Array, "3"] | None = None
    ) -> Float[Array, "4"]:
        """The point with an outward normal: of the two the outer, or the nearer one.

        Where the ring lies flat every point has the normal, and ``near`` chooses.
        """
        flat = in_plane(normal)
        size = dot(flat, flat)
        # a ring that lies flat but for rounding
        lies = size < (100 * cast(float, jnp.finfo(normal.dtype).eps)) ** 2
        along = flat * inverse_sqrt(jnp.where(lies, jnp.nan, size))
        if near is not None:
            chosen = _unit(near[:2])
            along = jnp.where(dot(along, chosen) < 0.0, -along, along)
            along = jnp.where(lies, chosen, along)
        return self.at_edge(along, normal)

    def samples(self) -> np.ndarray:
        """Points along the ring, each once, with the normal away from the centre."""
        angle = np.linspace(-np.pi, np.pi, _AROUND, endpoint=False)
        out, none = np.ones(_AROUND), np.zeros(_AROUND)
        return np.stack([np.cos(angle), np.sin(angle), out, none], axis=1)

    @property
    def spacing(self) -> tuple[float, float]:
        """Of both angles [rad]."""
        return 2.0 * np.pi / _AROUND, 2.0 * np.pi / _AROUND

    @property
    def chart_domain(self) -> Range:
        """Both angles once round [rad]."""
        return (-np.pi, np.pi), (-np.pi, np.pi)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """The point at angle q1 about z [m]."""
        return self.chart_geometry(q).position

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in both angles, with ``spin_rates``."""
        return _on_wire(self.radius, _of_angle(q[0]), _of_angle(q[1]))

    def chart_coordinates(self, u: Float[Array, "4"]) -> Float[Array, "2"]:
        """Angles along the ring and round the wire [rad]."""
        return jnp.arctan2(u[1::2], u[::2])

    def chart_inverse(self, q: Float[Array, "2"]) -> Float[Array, "4"]:
        """Both pairs at these angles."""
        return jnp.concatenate([_of_angle(q[0]), _of_angle(q[1])])

    def chart_of_normal(self, normal: Float[Array, "3"]) -> Float[Array, "2"]:
        """Angles of the outer point with a normal [rad]."""
        return self.chart_coordinates(self.find_normal(normal))
