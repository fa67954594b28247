"""Surfaces by name: plane, sphere, ellipsoid, torus, cylinder.

Lengths in metres, axes those of the body or of the base. ``inside=True`` turns the
outward side round: the material is outside and the other body touches from within.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ...validation.checks import flag, is_traced, positive, real, refuse
from ..local_geometry import LocalGeometry
from ..small_linear import components, dot, inverse_sqrt, norm
from .directions import NormalHeading, PointOfNormal, Range
from .edges import in_plane
from .kinds import AbstractNormalSurface, AbstractPairSurface


class Plane(AbstractPairSurface):
    """The plane z = 0, material below.

    Coordinates x and y [m]; outward normal +z. Relative to it nothing is curved, so a
    scene on a plane has no term of the base's curvature in its program.
    """

    is_regular: ClassVar[bool] = True
    is_flat: ClassVar[bool] = True
    is_height: ClassVar[bool] = True
    is_bounded: ClassVar[bool] = False

    def __init__(self):
        """A plane has no parameters; place and tilt it by its owner's axes."""

    @property
    def orientation(self) -> float:
        """+1: the normal of (x, y) points up, out of the material."""
        return 1.0

    @property
    def chart_domain(self) -> Range:
        """A square of two metres, for drawing only."""
        return (-1.0, 1.0), (-1.0, 1.0)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point (x, y, 0) [m]."""
        return jnp.concatenate([q, jnp.zeros(1, q.dtype)])

    def geometry(self, u: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry: constant frame, no curvature."""
        return LocalGeometry(
            position=self.chart(u),
            frame=jnp.eye(3, dtype=u.dtype),
            lengths=jnp.eye(2, dtype=u.dtype),
            frame_rates=jnp.zeros((2, 2), u.dtype),
        )

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in (x, y), with spin rates of zero."""
        flat = self.geometry(q)
        return LocalGeometry(
            flat.position, flat.frame, flat.lengths, flat.frame_rates, jnp.zeros_like(q)
        )

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """The point's x and y [m]."""
        return point[:2]

    @property
    def is_convex(self) -> bool:
        """True: a half-space."""
        return True

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """The point's height [m]."""
        return point[2]


class Sphere(AbstractNormalSurface):
    """A sphere; ``inside=True`` is a spherical cavity.

    Attributes:
        radius: [m].
        center: [m], owner's axes, shape (3,).
        inside: Whether the other body touches from within.
    """

    radius: Float[Array, ""]
    center: Float[Array, "3"]
    inside: bool = eqx.field(static=True)

    def __init__(
        self,
        radius: ArrayLike,
        center: ArrayLike | Sequence[ArrayLike] = (0.0, 0.0, 0.0),
        inside: bool = False,
    ):
        """Make a sphere.

        Args:
            radius: The radius [m], positive.
            center: Its centre, three lengths in its owner's axes [m].
            inside: True where the other body touches from within, else false.

        Raises:
            FieldError: a radius that is not positive, a centre of another shape.
        """
        self.radius = positive("Sphere.radius", radius, (), "a length in metres")
        self.center = real("Sphere.center", center, (3,), "three lengths in metres")
        self.inside = flag("Sphere.inside", inside)

    def point_with_normal(self, normal: Float[Array, "3"]) -> Float[Array, "3"]:
        """``center + radius * normal`` (minus, where the material is outside) [m]."""
        return self.center + (-self.radius if self.inside else self.radius) * normal

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Outward normal at the nearest point [1]."""
        offset = point - self.center
        return (-offset if self.inside else offset) / norm(offset)

    @property
    def is_convex(self) -> bool:
        """Whether it is solid."""
        return not self.inside

    @property
    def hull(self) -> Callable[[np.ndarray], bool] | None:
        """Whether a point is in the sphere, if that may be the whole body."""
        if self.inside or np.any(np.asarray(self.center)):
            return None
        return lambda x: bool(np.linalg.norm(x) <= float(self.radius))

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the surface [m]."""
        out = norm(point - self.center) - self.radius
        return -out if self.inside else out


class Ellipsoid(AbstractNormalSurface):
    """An ellipsoid with its axes along the owner's; ``inside=True`` is a cavity.

    Attributes:
        semi_axes: [m], along x, y and z, shape (3,).
        center: [m], owner's axes, shape (3,).
        inside: Whether the other body touches from within.
    """

    semi_axes: Float[Array, "3"]
    center: Float[Array, "3"]
    inside: bool = eqx.field(static=True)

    def __init__(
        self,
        semi_axes: ArrayLike | Sequence[ArrayLike],
        center: ArrayLike | Sequence[ArrayLike] = (0.0, 0.0, 0.0),
        inside: bool = False,
    ):
        """Make an ellipsoid.

        Args:
            semi_axes: Three positive lengths along x, y and z [m].
            center: Its centre, three lengths in its owner's axes [m].
            inside: True where the other body touches from within, else false.

        Raises:
            FieldError: semi-axes that are not three positive lengths.
        """
        meaning = "three lengths in metres"
        self.semi_axes = positive("Ellipsoid.semi_axes", semi_axes, (3,), meaning)
        self.center = real("Ellipsoid.center", center, (3,), meaning)
        self.inside = flag("Ellipsoid.inside", inside)

    def point_with_normal(self, normal: Float[Array, "3"]) -> Float[Array, "3"]:
        """Gradient of the support function sqrt(n . A n), A = diag(semi_axes^2) [m]."""
        stretched = self.semi_axes * self.semi_axes * normal
        inverse = inverse_sqrt(dot(normal, stretched))
        return self.center + stretched * (-inverse if self.inside else inverse)

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Outward normal of the ellipsoid through the point with the same axes [1]."""
        gradient = (point - self.center) / self.semi_axes**2
        return (-gradient if self.inside else gradient) / norm(gradient)

    @property
    def is_convex(self) -> bool:
        """Whether it is solid."""
        return not self.inside

    @property
    def hull(self) -> Callable[[np.ndarray], bool] | None:
        """Whether a point is in the ellipsoid, if that may be the whole body."""
        if self.inside or np.any(np.asarray(self.center)):
            return None
        return lambda x: bool(np.linalg.norm(x / np.asarray(self.semi_axes)) <= 1.0)

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the surface, of first order [m]."""
        scaled = (point - self.center) / self.semi_axes
        size, steepness = norm(scaled), norm(scaled / self.semi_axes)
        at_center = steepness == 0.0
        out = size * (size - 1.0) / jnp.where(at_center, 1.0, steepness)
        out = jnp.where(at_center, -jnp.min(self.semi_axes), out)
        return -out if self.inside else out


def _known(x: Array) -> Any:
    """A number for comparison, by NumPy where it is known."""
    return x if is_traced(x) else np.asarray(x)


class Torus(AbstractPairSurface):
    """A torus about the z axis.

    Coordinates: angle about z and angle round the tube [rad], so that no motion meets
    a pole. On a plane only its outer half is touched, and the normal gives the point.

    Attributes:
        major_radius: Radius of the tube's centre line [m].
        minor_radius: Radius of the tube [m].
        inside: Whether the other body touches from within the tube.
    """

    is_regular: ClassVar[bool] = True
    major_radius: Float[Array, ""]
    minor_radius: Float[Array, ""]
    inside: bool = eqx.field(static=True)

    def __init__(
        self, major_radius: ArrayLike, minor_radius: ArrayLike, inside: bool = False
    ):
        """Make a torus.

        Args:
            major_radius: The radius of the tube's centre line [m], positive.
            minor_radius: The radius of the tube [m], positive, less than major_radius.
            inside: True where the other body touches from within, else false.

        Raises:
            FieldError: radii that make no ring; a rim without thickness is DiscEdge.
        """
        metres = "a length in metres"
        self.major_radius = positive("Torus.major_radius", major_radius, (), metres)
        minor = positive(
            "Torus.minor_radius", minor_radius, (), metres + " (a sharp rim: DiscEdge)"
        )
        self.minor_radius = refuse(
            minor,
            ~(_known(minor) < _known(self.major_radius)),
            "Torus.minor_radius",
            "must be smaller than the major radius",
            "make the tube thinner or the ring larger",
        )
        self.inside = flag("Torus.inside", inside)

    @property
    def orientation(self) -> float:
        """d1 x d2 points away from the centre line."""
        return -1.0 if self.inside else 1.0

    @property
    def chart_domain(self) -> Range:
        """Both angles once round [rad]."""
        return (-np.pi, np.pi), (-np.pi, np.pi)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point at angle q1 about z and q2 round the tube [m]."""
        r = self.major_radius + self.minor_radius * jnp.cos(q[1])
        return jnp.stack(
            [r * jnp.cos(q[0]), r * jnp.sin(q[0]), self.minor_radius * jnp.sin(q[1])]
        )

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """Both angles of the nearest point [rad]."""
        x, y, z = components(point)
        return jnp.stack(
            [
                jnp.arctan2(y, x),
                jnp.arctan2(z, jnp.sqrt(x * x + y * y) - self.major_radius),
            ]
        )

    @property
    def is_convex_on_plane(self) -> bool:
        """Whether it is solid: its outer half is its convex hull's."""
        return not self.inside

    def normal_map(self, against_plane: bool) -> PointOfNormal | None:
        """On a plane, the outer half by its normal; else None."""
        if not against_plane or self.inside:
            return None
        return self._outer_point

    def _outer_point(self, normal: Float[Array, "3"]) -> Float[Array, "3"]:
        """Point with a normal on the outer half [m]; free of trigonometry."""
        n1, n2, n3 = components(normal)
        along = inverse_sqrt(n1 * n1 + n2 * n2)
        stretch = self.major_radius * along + self.minor_radius
        return jnp.stack([n1 * stretch, n2 * stretch, n3 * self.minor_radius])

    def normal_heading(self, against_plane: bool) -> NormalHeading | None:
        """On a plane, the normal's part in the plane of the ring; else None."""
        return None if self.normal_map(against_plane) is None else in_plane

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the surface [m]."""
        x, y, z = components(point)
        across = jnp.sqrt(x * x + y * y) - self.major_radius
        out = jnp.sqrt(across * across + z * z) - self.minor_radius
        return -out if self.inside else out


class Cylinder(AbstractPairSurface):
    """A circular cylinder about the z axis, without ends.

    Coordinates: angle about z [rad] and height z [m].

    Attributes:
        radius: [m].
        inside: Whether the other body touches from within.
    """

    is_regular: ClassVar[bool] = True
    is_bounded: ClassVar[bool] = False
    radius: Float[Array, ""]
    inside: bool = eqx.field(static=True)

    def __init__(self, radius: ArrayLike, inside: bool = False):
        """Make a cylinder.

        Args:
            radius: The radius [m], positive.
            inside: True where the other body touches from within, else false.

        Raises:
            FieldError: a radius that is not positive.
        """
        self.radius = positive("Cylinder.radius", radius, (), "a length in metres")
        self.inside = flag("Cylinder.inside", inside)

    @property
    def orientation(self) -> float:
        """d1 x d2 points away from the axis."""
        return -1.0 if self.inside else 1.0

    @property
    def chart_domain(self) -> Range:
        """Once round [rad], and one metre to each side [m]; it goes on beyond."""
        return (-np.pi, np.pi), (-1.0, 1.0)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point at angle q1 and height q2 [m]."""
        return jnp.stack(
            [self.radius * jnp.cos(q[0]), self.radius * jnp.sin(q[0]), q[1]]
        )

    def units(self, u: Float[Array, "2"]) -> Float[Array, "2"]:
        """The angle by radians, the way along the axis by the radius [m]."""
        return jnp.stack([jnp.ones_like(u[0]), self.radius])

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """Angle [rad] and height [m] of the nearest point."""
        x, y, z = components(point)
        return jnp.stack([jnp.arctan2(y, x), z])

    @property
    def is_convex(self) -> bool:
        """Whether it is solid."""
        return not self.inside

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the surface [m]."""
        out = norm(point[:2]) - self.radius
        return -out if self.inside else out
