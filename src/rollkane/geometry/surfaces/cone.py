"""The circular cone."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ...validation.checks import flag, is_traced, real, refuse
from ..local_geometry import LocalGeometry
from ..small_linear import components, inverse_sqrt, norm
from .directions import Range, grid_of, grid_spacing
from .kinds import AbstractPointSurface


class Cone(AbstractPointSurface):
    """The cone z = slope * distance from the z axis, without its tip.

    Coordinates: the distance from the axis [m] and the direction from it, a pair of any
    length. A contact that comes to the tip, where every direction is a normal, ends a
    run with ``Code.SURFACE_EDGE``. Chart: distance from the axis and angle about it.

    Attributes:
        slope: Rise over run [1]; negative for a tip that points up.
        inside: True where the other body is above (material below), else it is below.
    """

    coordinate_count = 3
    is_bounded: ClassVar[bool] = False
    is_height: ClassVar[bool] = True
    slope: Float[Array, ""]
    inside: bool = eqx.field(static=True)

    def __init__(self, slope: ArrayLike, inside: bool = False):
        """Make a cone.

        Args:
            slope: Rise over run [1], not zero.
            inside: True where the other body is above, else false.

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

    def _at(self, distance: Array, c: Array, s: Array) -> LocalGeometry:
        """Local geometry, in distance from the axis and angle about it."""
        up = 1.0 if self.inside else -1.0
        zero, m = jnp.zeros_like(distance), self.slope
        steep = inverse_sqrt(1.0 + m * m)
        frame = [
            [steep * c, -up * s, -up * steep * m * c],
            [steep * s, up * c, -up * steep * m * s],
            [steep * m, zero, up * steep + zero],
        ]
        lengths = [[1.0 / steep + zero, zero], [zero, up * distance]]
        frame_rates = [[zero, zero], [zero, steep * m + zero]]
        return LocalGeometry(
            position=jnp.stack([distance * c, distance * s, m * distance]),
            frame=jnp.stack([jnp.stack(row) for row in frame]),
            lengths=jnp.stack([jnp.stack(row) for row in lengths]),
            frame_rates=jnp.stack([jnp.stack(row) for row in frame_rates]),
            spin_rates=jnp.stack([zero, up * steep + zero]),
        )

    def geometry(self, u: Float[Array, "3"]) -> LocalGeometry:
        """Local geometry at a distance from the axis, in a direction."""
        distance, x, y = components(u)
        inverse = inverse_sqrt(x * x + y * y)
        return self._at(distance, x * inverse, y * inverse)

    def coordinate_rates(
        self, u: Float[Array, "3"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, "3"]:
        """Rates of the distance and of the direction, which turns about the axis."""
        del geometry
        (_, a, b), (along, around) = components(u), components(x)
        return jnp.stack([along, -b * around, a * around])

    @property
    def directions(self) -> tuple[tuple[int, int], ...]:
        """That from the axis."""
        return ((1, 3),)

    def extent(self, u: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the axis [m]: zero at the tip."""
        return u[0]

    def units(self, u: Float[Array, "3"]) -> Float[Array, "2"]:
        """The distance by itself [m], the angle by radians."""
        return jnp.stack([u[0], jnp.ones_like(u[0])])

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """The surface point above or below a point."""
        distance = norm(point[:2])
        return jnp.concatenate([distance[None], point[:2] / distance])

    def find_normal(
        self, normal: Float[Array, "3"], near: Float[Array, "3"] | None = None
    ) -> Float[Array, "3"]:
        """The point on the generator whose normals have the direction of a normal.

        As far from the axis as ``near`` [m], or half a metre.
        """
        outwards = -normal[:2] if self.inside else normal[:2]
        along = jnp.sign(self.slope) * outwards
        distance = jnp.full((), 0.5, normal.dtype)
        if near is not None:
            distance = norm(near[:2])
        return jnp.concatenate([distance[None], along / norm(along)])

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the surface [m]."""
        above = point[2] - self.slope * norm(point[:2])
        above = above * inverse_sqrt(1.0 + self.slope * self.slope)
        return above if self.inside else -above

    @property
    def is_convex(self) -> bool:
        """Whether the material is on the side of the axis that makes it convex."""
        if is_traced(self.slope):
            return False
        return bool(np.asarray(self.slope) < 0) == self.inside

    def samples(self) -> np.ndarray:
        """Coordinates over a disc of one metre round the tip."""
        distance, angle = grid_of(self.chart_domain).T
        return np.stack([distance, np.cos(angle), np.sin(angle)], axis=1)

    @property
    def spacing(self) -> tuple[float, float]:
        """Of distance [m] and angle [rad]."""
        return grid_spacing(self.chart_domain)

    @property
    def chart_domain(self) -> Range:
        """A metre from the axis [m] and once round [rad]; it goes on beyond."""
        return (0.0, 1.0), (-np.pi, np.pi)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point at distance q1 from the axis and angle q2 about it [m]."""
        return self.chart_geometry(q).position

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in the chart, with ``spin_rates``."""
        return self._at(q[0], jnp.cos(q[1]), jnp.sin(q[1]))

    def chart_coordinates(self, u: Float[Array, "3"]) -> Float[Array, "2"]:
        """Distance from the axis [m] and angle about it [rad]."""
        distance, x, y = components(u)
        return jnp.stack([distance, jnp.arctan2(y, x)])

    def chart_inverse(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """The point at a distance and an angle."""
        return jnp.stack([q[0], jnp.cos(q[1]), jnp.sin(q[1])])
