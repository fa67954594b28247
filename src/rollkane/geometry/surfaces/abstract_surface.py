"""What every surface can do.

The two ways in which it can carry a contact point are in :mod:`.kinds`.
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...validation.shown import described
from ..local_geometry import LocalGeometry
from .directions import NormalHeading, PointOfNormal, Range, longitude_latitude


class Ball(NamedTuple):
    """Where points are: its center and its radius [m]."""

    center: Float[Array, "3"]
    radius: Float[Array, ""]


class AbstractSurface(eqx.Module):
    """A surface fixed in its owner's axes, with an outward side.

    Coordinates ``u`` are those of the contact state: without poles, of shape
    (coordinate_count,). Rates ``x`` of shape (2,) are taken in local coordinates at a
    point, those to which the ``L`` and ``W`` of its :class:`LocalGeometry` belong.
    """

    coordinate_count: eqx.AbstractClassVar[int]
    is_flat: ClassVar[bool] = False
    # whether a flat of the body, in the plane z = 0, is left out of the surface
    has_face: ClassVar[bool] = False
    is_bounded: ClassVar[bool] = True  # else it goes on beyond its samples
    is_height: ClassVar[bool] = False  # one height above each x and y, drawn in part
    is_by_normal: ClassVar[bool] = False  # parametrized by its normal, edges included
    is_by_place: ClassVar[bool] = False  # its coordinates are those of the point
    is_edge: ClassVar[bool] = False  # several normals at each point
    is_wire: ClassVar[bool] = False  # an edge all round
    searches_distance: ClassVar[bool] = False  # ``signed_distance`` does, over samples

    def __repr__(self) -> str:
        """Its numbers, with units, in a few lines."""
        return described(self)

    @abc.abstractmethod
    def geometry(self, u: Float[Array, " k"]) -> LocalGeometry:
        """Local geometry at coordinates ``u``; differentiates the surface once."""

    @abc.abstractmethod
    def coordinate_rates(
        self, u: Float[Array, " k"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, " k"]:
        """Rates of ``u`` for local rates ``x``; linear in a direction's length."""

    @property
    def directions(self) -> tuple[tuple[int, int], ...]:
        """Which coordinates are directions, of any length: (first, behind the last).

        Three coordinates are one, but for a point's own.
        """
        return ((0, 3),) if self.coordinate_count == 3 and not self.is_by_place else ()

    def units(self, u: Float[Array, " k"]) -> Float[Array, "2"]:
        """What local coordinates are measured by: metres beside angles by a length."""
        return jnp.ones(2, u.dtype)

    def settled(self, u: Float[Array, " k"]) -> Float[Array, " k"]:
        """Coordinates projected onto their manifold after a finite step."""
        return u

    def point(self, u: Float[Array, " k"]) -> Float[Array, "3"]:
        """The point at coordinates ``u`` [m], without its geometry."""
        return self.geometry(u).position

    def neighbour(self, u: Float[Array, " k"], x: Float[Array, "2"]) -> Array:
        """Coordinates of a point beside, by a finite step in local coordinates."""
        return self.settled(u + self.coordinate_rates(u, self.geometry(u), x))

    @abc.abstractmethod
    def locate(self, point: Float[Array, "3"]) -> Float[Array, " k"]:
        """Coordinates of the surface point at, or near, a point [m]."""

    def at_edge(self, point: Float[Array, "3"], normal: Float[Array, "3"]) -> Array:
        """Coordinates near a point, of an edge where the normal is the given one."""
        del normal
        return self.locate(point)

    @abc.abstractmethod
    def samples(self) -> np.ndarray | Array:
        """Coordinates over the whole surface, shape (n, k): seeds of searches."""

    @abc.abstractmethod
    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Two-parameter chart, for drawing and for Voronets coordinates [m]."""

    @property
    @abc.abstractmethod
    def chart_domain(self) -> Range:
        """Ranges of the chart's two parameters that cover the surface once."""

    @abc.abstractmethod
    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in the chart, with ``spin_rates``."""

    @abc.abstractmethod
    def chart_coordinates(self, u: Float[Array, " k"]) -> Float[Array, "2"]:
        """Chart coordinates of the point with contact coordinates ``u``."""

    @abc.abstractmethod
    def chart_inverse(self, q: Float[Array, "2"]) -> Float[Array, " k"]:
        """Contact coordinates of the point with chart coordinates ``q``."""

    @property
    def is_convex(self) -> bool:
        """Whether the material is convex: two such bodies touch at one place only."""
        return False

    @property
    def is_convex_on_plane(self) -> bool:
        """Whether a plane touches it where it would touch its convex hull, and once."""
        return self.is_convex

    @property
    def may_turn_over(self) -> bool:
        """Whether the normal is that of a chart that may have a pole, and reverse."""
        return False

    @property
    def hull(self) -> Callable[[np.ndarray], bool] | None:
        """Whether a point [m] is in the body's convex hull, by NumPy.

        None: not known, as of a surface that may be a part of the body only (a foot).
        """
        return None

    @property
    @abc.abstractmethod
    def spacing(self) -> tuple[Any, Any]:
        """Distance of neighbouring samples, in the local coordinates."""

    def lattice(self) -> np.ndarray:
        """Numbers, one row for each sample, of which near ones belong to near samples.

        So that neighbours are known without a value of the surface.
        """
        return np.asarray(self.samples())

    def face_rim(self) -> "AbstractSurface | None":
        """The edge round that flat, as a surface of its own; None: there is none."""

    def face_samples(self) -> np.ndarray | None:
        """Samples over that flat, shape (n, 3); None: there is none."""

    def face_point(self, sample: Float[Array, "3"]) -> Float[Array, "3"]:
        """The point of the flat that a sample stands for [m]."""
        return sample

    def face_extent(self, point: Float[Array, "3"]) -> Float[Array, ""] | None:
        """Positive where a point is over the flat, along z; None: there is none."""
        del point

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""] | None:
        """Distance of a point from the surface [m], negative in the material.

        Of first order near the surface, of the right sign everywhere; infinite where
        the surface does not reach. None: it has no inside (a wire), or none is known.
        """
        del point

    def distances(
        self, dtype: Any, within: Ball | None = None
    ) -> Callable[[Float[Array, "3"]], Float[Array, ""] | None]:
        """:meth:`signed_distance`, of many points.

        Where that searches, what is the same for all points is computed here, once.

        Args:
            dtype: Of places.
            within: Where all of the points are; None: anywhere.
        """
        del dtype, within
        return self.signed_distance

    def beyond_samples(self, u: Float[Array, " k"]) -> Float[Array, " k"] | None:
        """By what :meth:`continued` has samples about a place beyond those there are.

        Zero where the place is among them. None: there is nothing beyond, or the
        distance from the surface takes no search.
        """
        del u

    def continued(self, shift: Float[Array, " k"]) -> "AbstractSurface":
        """The same surface, for searches, with its samples elsewhere.

        Args:
            shift: What its coordinates need to be those of this one.

        Raises:
            TypeError: of a surface that ends with its samples, which is not asked.
        """
        raise TypeError(f"{type(self).__name__} ends with its samples")

    def extent(self, u: Float[Array, " k"]) -> Float[Array, ""] | None:
        """Positive while a contact point is on the surface; None: it has no end.

        A contact that comes to zero has come to a rim, a tip or a face.
        """
        del u

    def chart_extent(self, q: Float[Array, "2"]) -> Float[Array, ""] | None:
        """The same in chart coordinates."""
        return self.extent(self.chart_inverse(q))

    def normal_heading(self, against_plane: bool) -> NormalHeading | None:
        """Part of the normal that must not vanish; of a surface parametrized by it.

        Where it does, the inverse Gauss map jumps: a whole face or circle has that
        normal. No step of a run may reverse it. None: the map is continuous.

        Args:
            against_plane: Whether the other surface is a plane.
        """
        del against_plane

    def chart_of_normal(self, normal: Float[Array, "3"]) -> Float[Array, "2"]:
        """Chart coordinates where the outward normal is the given one.

        Only for surfaces parametrized by their normal.
        """
        return longitude_latitude(normal)

    def normal_map(self, against_plane: bool) -> PointOfNormal | None:
        """The map from outward normal to point, where the normal determines it.

        Args:
            against_plane: Whether the other surface is a plane.
        """
        del against_plane
        return None
