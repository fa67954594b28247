"""Surfaces by a user's own JAX function of two parameters, or of a direction."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ...validation.checks import flag
from ...validation.user_functions import UserFunction, check_output
from ..local_geometry import LocalGeometry, from_chart
from ..rotations import tangent_pair
from ..small_linear import dot, norm, sign
from .abstract_surface import Ball
from .directions import (
    SPHERE,
    SPHERE_SAMPLES,
    SPHERE_SPACING,
    Range,
    beyond,
    direction_chart,
    direction_of,
    direction_rates,
    domain_of,
    grid_of,
    grid_spacing,
    longitude_latitude,
    sphere_of_directions,
)
from .kinds import AbstractPointSurface
from .moved import MovedFunction


class Parametric(AbstractPointSurface):
    """A surface by its position as a function of two parameters, or of a direction.

    Where two parameters do not count for two (the poles of longitude and latitude, an
    equator over x and y) a motion ends with ``Code.SURFACE_EDGE``; a direction has no
    such place.

    Attributes:
        position: The user's function, with its parameters.
        of_direction: Whether it takes a unit vector (closed surfaces: no poles).
        inside: Whether the outward side is turned round.
        domain: Ranges of the two parameters for searches and drawing; a surface that is
            not closed goes on beyond, for contacts and for what lands there.
    """

    searches_distance: ClassVar[bool] = True
    position: UserFunction
    of_direction: bool = eqx.field(static=True)
    inside: bool = eqx.field(static=True)
    domain: Range = eqx.field(static=True)
    coordinate_count: int = eqx.field(static=True)

    def __init__(
        self,
        position: Callable[..., Any],
        parameters: Any = None,
        domain: ArrayLike | Sequence[Sequence[float]] = SPHERE,
        of_direction: bool = False,
        inside: bool = False,
    ):
        """Make a parametric surface.

        Args:
            position: ``position(q, parameters)``, ``position(q1, q2)`` ... -> (3,) [m],
                written with jax.numpy and twice differentiable. With ``of_direction``
                it takes a unit vector of shape (3,) instead of the pair.
            parameters: Tree of numbers that it depends on; differentiable.
            domain: Ranges of the two parameters for searches and drawing; with
                ``of_direction`` ignored.
            of_direction: Whether position takes a unit vector: closed, without poles.
            inside: False where the normal d1 x d2 points out of the material, else
                true. With ``of_direction``, the normal away from their origin.

        Raises:
            FieldError: position of another signature or result.
        """
        self.of_direction = flag("Parametric.of_direction", of_direction)
        count = 3 if self.of_direction else 2
        self.position = UserFunction("Parametric.position", position, count, parameters)
        self.inside = flag("Parametric.inside", inside)
        self.domain = domain_of("Parametric.domain", domain, 2)
        self.coordinate_count = count
        check_output("Parametric.position", self.position, (count,), (3,))

    @property
    def chart_domain(self) -> Range:
        """Ranges of the two chart parameters."""
        if self.of_direction:
            return SPHERE
        return self.domain

    @property
    def may_turn_over(self) -> bool:
        """Whether it is of a pair: longitude and latitude have poles."""
        return not self.of_direction

    @property
    def _orientation(self) -> float:
        return -1.0 if self.inside else 1.0

    def geometry(self, u: Float[Array, " k"]) -> LocalGeometry:
        """Local geometry at a pair, or at a direction of any length."""
        if self.of_direction:
            return direction_chart(self.position, u, self._orientation)
        return from_chart(self.position, u, self._orientation, spin=False)

    def point(self, u: Float[Array, " k"]) -> Float[Array, "3"]:
        """Position at a pair, or at a direction of any length [m]."""
        return self.position(u / norm(u) if self.of_direction else u)

    def neighbour(self, u: Float[Array, " k"], x: Float[Array, "2"]) -> Array:
        """The pair or the direction beside."""
        if not self.of_direction:
            return u + x
        return u + direction_rates(u, *tangent_pair(u / norm(u)), x)

    def coordinate_rates(
        self, u: Float[Array, " k"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, " k"]:
        """Chart rates, or the rates of the direction."""
        del geometry
        if not self.of_direction:
            return x
        return direction_rates(u, *tangent_pair(u / norm(u)), x)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Position at the pair, or at longitude and latitude of the direction [m]."""
        return self.position(direction_of(q) if self.of_direction else q)

    def chart_coordinates(self, u: Float[Array, " k"]) -> Float[Array, "2"]:
        """The pair, or longitude and latitude of the direction [rad]."""
        return longitude_latitude(u) if self.of_direction else u

    def chart_inverse(self, q: Float[Array, "2"]) -> Float[Array, " k"]:
        """The pair, or the direction with a longitude and a latitude."""
        return direction_of(q) if self.of_direction else q

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in the chart, with ``spin_rates``."""
        return from_chart(self.chart, q, self._orientation)

    def samples(self) -> np.ndarray:
        """A grid of pairs, or directions over the sphere."""
        if self.of_direction:
            return sphere_of_directions(SPHERE_SAMPLES)
        return grid_of(self.domain)

    def lattice(self) -> np.ndarray:
        """The pairs in units of their spacing, or the directions."""
        if self.of_direction:
            return self.samples()
        return grid_of(self.domain) / np.array(grid_spacing(self.domain))

    @property
    def spacing(self) -> tuple[float, float]:
        """Of the pairs, or of the directions [rad]."""
        if self.of_direction:
            return SPHERE_SPACING, SPHERE_SPACING
        return grid_spacing(self.domain)

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the nearest point found from the samples [m].

        Infinite beyond the ends of the domain, where the surface is not closed.
        """
        return self.distances(point.dtype)(point)

    def beyond_samples(self, u: Float[Array, " k"]) -> Float[Array, " k"] | None:
        """From the middle of the domain to a pair beyond."""
        return None if self.of_direction else beyond(u, self.domain)

    def continued(self, shift: Float[Array, " k"]) -> "Parametric":
        """The surface with its domain elsewhere."""
        moved = MovedFunction(self.position, shift)
        return eqx.tree_at(lambda s: s.position, self, moved)

    def distances(
        self, dtype: Any, within: Ball | None = None
    ) -> Callable[[Float[Array, "3"]], Float[Array, ""]]:
        """The same, of many points."""
        nearest = self.searching(dtype, within)

        def distance(point: Float[Array, "3"]) -> Float[Array, ""]:
            u, place = nearest(point)
            offset = point - place.position
            out = sign(dot(offset, place.normal)) * norm(offset)
            if self.of_direction:
                return out
            beyond = jnp.asarray(False)
            slack = grid_spacing(self.domain)
            for k, (low, high) in enumerate(self.domain):
                beyond |= (u[k] < low - slack[k]) | (u[k] > high + slack[k])
            return jnp.where(beyond, jnp.inf, out)

        return distance
