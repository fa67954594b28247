"""Surfaces by name: plane, sphere, ellipsoid, rim, torus, cylinder, cone.

Lengths in metres, axes those of the body or of the base. ``inside=True`` turns the
outward side round: the material is outside and the other body touches from within.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..checks import flag, is_traced, positive, real, refuse
from ..geometry import LocalGeometry, from_height
from ..small_linear import components, dot, inverse_sqrt, norm
from .kinds import (
    AbstractNormalSurface,
    AbstractPairSurface,
    PointOfNormal,
    longitude_latitude,
)

Range = tuple[tuple[float, float], tuple[float, float]]


class Plane(AbstractPairSurface):
    """The plane z = 0, material below.

    Coordinates x and y [m]; outward normal +z. Relative to it nothing is curved, so a
    scene on a plane has no term of the base's curvature in its program.
    """

    is_flat: ClassVar[bool] = True

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

    def __init__(self, radius, center=(0.0, 0.0, 0.0), inside: bool = False):
        """Make a sphere.

        Args:
            radius: [m], positive.
            center: [m], owner's axes, shape (3,).
            inside: Whether the other body touches from within.

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

    def __init__(self, semi_axes, center=(0.0, 0.0, 0.0), inside: bool = False):
        """Make an ellipsoid.

        Args:
            semi_axes: [m], positive, along x, y and z, shape (3,).
            center: [m], owner's axes, shape (3,).
            inside: Whether the other body touches from within.

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


def _known(x: Array):
    """A number for comparison, by NumPy where it is known."""
    return x if is_traced(x) else np.asarray(x)


def _around_rim(major: Array, minor: Array | float, normal: Array) -> Array:
    """Point with the given normal on the outer half of a torus; a rim for minor 0.

    Free of trigonometry, and the same code for both (design, section 3).
    """
    n1, n2, n3 = components(normal)
    stretch = major * inverse_sqrt(n1 * n1 + n2 * n2) + minor
    return jnp.stack([n1 * stretch, n2 * stretch, n3 * minor])


class DiscEdge(AbstractNormalSurface):
    """The sharp circular rim of a disc in the plane z = 0, axis z.

    Attributes:
        radius: [m].
    """

    radius: Float[Array, ""]

    def __init__(self, radius):
        """Make a rim.

        Args:
            radius: [m], positive.

        Raises:
            FieldError: a radius that is not positive.
        """
        self.radius = positive("DiscEdge.radius", radius, (), "a length in metres")

    def point_with_normal(self, normal: Float[Array, "3"]) -> Float[Array, "3"]:
        """Rim point below the normal's part in the plane of the disc [m]."""
        n1, n2, _ = components(normal)
        stretch = self.radius * inverse_sqrt(n1 * n1 + n2 * n2)
        return jnp.stack([n1 * stretch, n2 * stretch, jnp.zeros_like(stretch)])

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Normal in the plane of the disc; an edge has a fan of others."""
        flat = point * jnp.array([1.0, 1.0, 0.0], point.dtype)
        return flat / norm(flat)


class Torus(AbstractPairSurface):
    """A torus about the z axis.

    Coordinates: angle about z and angle round the tube [rad], so that no motion meets
    a pole. On a plane only its outer half is touched, and the normal gives the point.

    Attributes:
        major_radius: Radius of the tube's centre line [m].
        minor_radius: Radius of the tube [m].
        inside: Whether the other body touches from within the tube.
    """

    major_radius: Float[Array, ""]
    minor_radius: Float[Array, ""]
    inside: bool = eqx.field(static=True)

    def __init__(self, major_radius, minor_radius, inside: bool = False):
        """Make a torus.

        Args:
            major_radius: [m], positive.
            minor_radius: [m], positive and smaller than the major radius.
            inside: Whether the other body touches from within the tube.

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

    def chart_of_normal(self, normal: Float[Array, "3"]) -> Float[Array, "2"]:
        """Both angles of the outer point with a normal [rad]."""
        return longitude_latitude(normal)

    def normal_map(self, against_plane: bool) -> PointOfNormal | None:
        """On a plane, the outer half by its normal; else None."""
        if not against_plane or self.inside:
            return None
        return lambda normal: _around_rim(self.major_radius, self.minor_radius, normal)


class Cylinder(AbstractPairSurface):
    """A circular cylinder about the z axis, without ends.

    Coordinates: angle about z [rad] and height z [m].

    Attributes:
        radius: [m].
        inside: Whether the other body touches from within.
    """

    radius: Float[Array, ""]
    inside: bool = eqx.field(static=True)

    def __init__(self, radius, inside: bool = False):
        """Make a cylinder.

        Args:
            radius: [m], positive.
            inside: Whether the other body touches from within.

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

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """Angle [rad] and height [m] of the nearest point."""
        x, y, z = components(point)
        return jnp.stack([jnp.arctan2(y, x), z])


class Cone(AbstractPairSurface):
    """The cone z = slope * distance from the z axis; its tip cannot be touched.

    Coordinates x and y [m].

    Attributes:
        slope: Rise over run [1]; negative for a tip that points up.
        inside: True where the other body is above (material below), else it is below.
    """

    slope: Float[Array, ""]
    inside: bool = eqx.field(static=True)

    def __init__(self, slope, inside: bool = False):
        """Make a cone.

        Args:
            slope: Rise over run [1], not zero.
            inside: True where the other body is above.

        Raises:
            FieldError: slope zero, which is a plane.
        """
        slope = real("Cone.slope", slope, (), "rise over run")
        self.slope = refuse(
            slope,
            lambda s: s == 0,
            "Cone.slope",
            "must not be zero",
            "use Plane() for a flat surface",
        )
        self.inside = flag("Cone.inside", inside)

    @property
    def orientation(self) -> float:
        """d1 x d2 points up."""
        return 1.0 if self.inside else -1.0

    @property
    def chart_domain(self) -> Range:
        """A square of two metres round the tip, for searches and drawing [m]."""
        return (-1.0, 1.0), (-1.0, 1.0)

    def geometry(self, u: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry at (x, y), from the derivatives of the height alone."""
        return from_height(lambda q: self.slope * norm(q), u, self.orientation)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point above or below (q1, q2) [m]."""
        return jnp.concatenate([q, self.slope * norm(q)[None]])

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """The point's x and y [m]."""
        return point[:2]
