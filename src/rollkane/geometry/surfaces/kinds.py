"""The two ways in which a surface can carry a contact point.

A surface is *parametrized by its normal* when that determines the point (sphere,
ellipsoid, rim): then the normal itself is the coordinate and edges are ordinary. Every
other surface has *explicit contact coordinates*, on a manifold without poles.
"""

import abc
import functools
from collections.abc import Callable
from typing import Any, ClassVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..local_geometry import LocalGeometry, from_chart, from_normal
from ..rotations import tangent_pair
from ..small_linear import dot, matmul, matvec, matvec_transposed, norm, solve_2x2
from .abstract_surface import AbstractSurface, Ball
from .directions import (
    SPHERE,
    SPHERE_SAMPLES,
    SPHERE_SPACING,
    PointOfNormal,
    Range,
    direction_of,
    direction_rates,
    grid_of,
    grid_spacing,
    longitude_latitude,
    sphere_of_directions,
)

# Samples of a surface that are few to look through for each of many points: an eighth
# of a chart's 961, of which a look takes a third of the time.
_FEW = 128

# local rates at a place, of one step of a search
_Step = Callable[[LocalGeometry], Float[Array, "2"]]


class AbstractNormalSurface(AbstractSurface):
    """A surface parametrized by its normal, its coordinate (inverse Gauss map)."""

    coordinate_count = 3
    is_by_normal: ClassVar[bool] = True

    @abc.abstractmethod
    def point_with_normal(self, normal: Float[Array, "3"]) -> Float[Array, "3"]:
        """Point where the unit normal out of the material is ``normal`` [m]."""

    def normal_map(self, against_plane: bool) -> PointOfNormal | None:
        """The map from outward normal to point."""
        del against_plane
        return self.point_with_normal

    def geometry(self, u: Float[Array, "3"]) -> LocalGeometry:
        """Local geometry where the outward normal is along ``u`` (any length)."""
        return from_normal(self.point_with_normal, u / norm(u))

    def point(self, u: Float[Array, "3"]) -> Float[Array, "3"]:
        """The point whose outward normal is along ``u`` [m]."""
        return self.point_with_normal(u / norm(u))

    def neighbour(self, u: Float[Array, "3"], x: Float[Array, "2"]) -> Array:
        """The normal, turned by ``x`` along any tangent pair."""
        return u + direction_rates(u, *tangent_pair(u / norm(u)), x)

    def coordinate_rates(
        self, u: Float[Array, "3"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, "3"]:
        """Rates of the normal, turning by ``x`` along e1 and e2."""
        return direction_rates(u, geometry.frame[:, 0], geometry.frame[:, 1], x)

    def samples(self) -> np.ndarray:
        """Normals spread over the sphere of directions."""
        return sphere_of_directions(SPHERE_SAMPLES)

    @property
    def spacing(self) -> tuple[float, float]:
        """Turns of the normal [rad]."""
        return SPHERE_SPACING, SPHERE_SPACING

    @property
    def chart_domain(self) -> Range:
        """Longitude and latitude of the normal [rad]."""
        return SPHERE

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point whose outward normal has longitude q1 and latitude q2 [rad]."""
        return self.point_with_normal(direction_of(q))

    def chart_coordinates(self, u: Float[Array, "3"]) -> Float[Array, "2"]:
        """Longitude and latitude of the normal [rad]."""
        return longitude_latitude(u)

    def chart_inverse(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """The normal with a longitude and a latitude."""
        return direction_of(q)

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Geometry in longitude and latitude of the normal; edges included.

        Source: docs/theory.md, (2.3) (the chart of the rim, for any such surface).
        """
        c1, s1, c2, s2 = jnp.cos(q[0]), jnp.sin(q[0]), jnp.cos(q[1]), jnp.sin(q[1])
        zero = jnp.zeros_like(c1)
        e1 = jnp.stack([-s1, c1, zero])
        e2 = jnp.stack([-s2 * c1, -s2 * s1, c2])
        normal = jnp.stack([c2 * c1, c2 * s1, s2])
        turned = from_normal(self.point_with_normal, normal, (e1, e2))
        turn = jnp.stack([c2, jnp.ones_like(c2)])  # turns per unit of q1 and q2
        return LocalGeometry(
            position=turned.position,
            frame=turned.frame,
            lengths=turned.lengths * turn[None, :],
            frame_rates=turned.frame_rates * turn[None, :],
            spin_rates=jnp.stack([s2, zero]),
        )


class AbstractPointSurface(AbstractSurface):
    """A surface with explicit contact coordinates, found by search if need be."""

    def locate(self, point: Float[Array, "3"]) -> Float[Array, " k"]:
        """Coordinates of the nearest surface point, by Gauss-Newton from samples."""
        fixed = jax.lax.stop_gradient(point)
        seed = self._nearest_sample(fixed)
        return self._refine(seed, _step_to(fixed), _newton_step_to(point))

    def searching(
        self, dtype: Any, within: Ball | None = None
    ) -> Callable[[Float[Array, "3"]], tuple[Array, LocalGeometry]]:
        """A search for the nearest surface point about a point; no derivatives.

        A few steps; what is the same for all points is computed here, once.

        Args:
            dtype: Of places.
            within: Where all of the points are; None: anywhere.
        """
        next_to = _nearest_of(*self._sampled(dtype), within)
        longest = self._search_step()

        def nearest(point: Float[Array, "3"]) -> tuple[Array, LocalGeometry]:
            point = jax.lax.stop_gradient(point)
            step, seed = _step_to(point), next_to(point)

            def advance(u: Array, _: None) -> tuple[Array, None]:
                return self._advanced(u, step, longest), None

            def gap(u: Array) -> Array:
                return norm(self.point(u) - point)

            u, _ = jax.lax.scan(advance, seed, length=8)
            # far from a bent surface the steps do not converge
            u = jnp.where(gap(u) < gap(seed), u, seed)
            return u, self.geometry(u)

        return nearest

    def _nearest_sample(self, point: Float[Array, "3"]) -> Float[Array, " k"]:
        return _nearest_of(*self._sampled(point.dtype))(point)

    def _sampled(self, dtype: Any) -> tuple[Float[Array, "n k"], Float[Array, "n 3"]]:
        """Coordinates over the whole surface, and their points [m]."""
        seeds = jnp.asarray(self.samples(), dtype)
        return seeds, jax.vmap(self.point)(seeds)

    def find_normal(
        self, normal: Float[Array, "3"], near: Float[Array, "3"] | None = None
    ) -> Float[Array, " k"]:
        """Coordinates of the point with the given outward normal.

        Of several such points the one next to ``near`` [m], or else the one farthest
        out along the normal: the first that a plane meets. Where there is none, a
        point with another normal comes back, which the caller must check.
        """
        fixed = jax.lax.stop_gradient(normal)
        seed = self._outermost(fixed) if near is None else self.locate(near)
        return self.find_normal_from(normal, seed)

    def find_normal_from(
        self, normal: Float[Array, "3"], u: Float[Array, " k"]
    ) -> Float[Array, " k"]:
        """Coordinates of a point with the given outward normal, searched from ``u``.

        Where a whole line has the normal, the place on it that is next to ``u``. Where
        there is none, a point with another normal, which the caller must check.
        """

        def towards(target: Array) -> _Step:
            def gap(geometry: LocalGeometry) -> Array:
                # that the normal still needs; once that is nothing, its derivative is
                # the normal's alone: tangents next to a pole would turn with the place
                left = target - geometry.normal
                turn = matvec_transposed(geometry.frame[:, :2], left)
                return _least_turn(-geometry.frame_rates, turn)

            return gap

        return self._refine(u, towards(jax.lax.stop_gradient(normal)), towards(normal))

    def _outermost(self, normal: Float[Array, "3"]) -> Float[Array, " k"]:
        """The sample farthest out along a normal, of those that face its way."""
        seeds = jnp.asarray(self.samples(), dtype=normal.dtype)
        found = jax.vmap(self.geometry)(seeds)
        height = found.position @ normal
        facing = found.frame[:, :, 2] @ normal
        spread = jnp.nanmax(height) - jnp.nanmin(height)
        # where a whole line has the normal (cylinder), the place next to the origin
        far = 1e-6 * jax.vmap(norm)(found.position)
        score = height + spread * jnp.minimum(facing - 0.5, 0.0) - far
        return seeds[jnp.argmax(jnp.where(jnp.isfinite(score), score, -jnp.inf))]

    def _refine(
        self, seed: Float[Array, " k"], step_to_fixed: _Step, step_to_moving: _Step
    ) -> Float[Array, " k"]:
        """Newton steps from a seed; the last two carry the derivative.

        That by the seed, too: along a line on which no step is taken.
        """
        longest = self._search_step()

        def advance(_: Array, u: Array) -> Array:
            return self._advanced(u, step_to_fixed, longest)

        found = cast(Array, jax.lax.fori_loop(0, 60, advance, seed))
        u = jax.lax.stop_gradient(found) + (seed - jax.lax.stop_gradient(seed))
        for _ in range(2):
            u = self._advanced(u, step_to_moving, longest)
        return u

    def _advanced(
        self, u: Float[Array, " k"], step: _Step, longest: Float[Array, ""]
    ) -> Float[Array, " k"]:
        """Coordinates after one step of a search, which is cut to a length [m]."""
        geometry = self.geometry(u)
        x = step(geometry)
        # steps that carry derivatives are uncut; of none left no length has one
        excess = jax.lax.stop_gradient(norm(matvec(geometry.lengths, x)) / longest)
        x = x / jnp.maximum(1.0, excess)
        x = jnp.where(jnp.all(jnp.isfinite(x)), x, 0.0)
        return self.settled(u + self.coordinate_rates(u, geometry, x))

    def _search_step(self) -> Float[Array, ""]:
        """Longest step of a search [m]: a tenth of the sampled extent."""
        seeds = jnp.asarray(self.samples())

        def place(u: Array) -> Array:
            return self.geometry(u).position

        places = jax.lax.stop_gradient(jax.vmap(place)(seeds))
        places = jnp.where(jnp.isfinite(places), places, 0.0)
        return 0.1 * jnp.max(jnp.max(places, axis=0) - jnp.min(places, axis=0))


class AbstractPairSurface(AbstractPointSurface):
    """A surface whose contact coordinates are a pair, by one chart without poles."""

    coordinate_count = 2
    is_regular: ClassVar[bool] = False  # whether the chart is known to have no pole

    @property
    def may_turn_over(self) -> bool:
        """Whether it is not known that the chart has no pole."""
        return not self.is_regular

    @property
    @abc.abstractmethod
    def orientation(self) -> float:
        """+1 where d1 x d2 of the chart points out of the material, else -1."""

    def geometry(self, u: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in the chart, without spin rates."""
        return from_chart(self.chart, u, self.orientation, spin=False)

    def point(self, u: Float[Array, "2"]) -> Float[Array, "3"]:
        """The chart's point [m]."""
        return self.chart(u)

    def neighbour(self, u: Float[Array, "2"], x: Float[Array, "2"]) -> Array:
        """The pair beside."""
        return u + x

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in the chart, with ``spin_rates``."""
        return from_chart(self.chart, q, self.orientation)

    def chart_coordinates(self, u: Float[Array, "2"]) -> Float[Array, "2"]:
        """The pair itself."""
        return u

    def chart_inverse(self, q: Float[Array, "2"]) -> Float[Array, "2"]:
        """The pair itself."""
        return q

    def coordinate_rates(
        self, u: Float[Array, "2"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, "2"]:
        """The chart rates themselves."""
        del u, geometry
        return x

    def samples(self) -> np.ndarray:
        """A grid over the chart's domain."""
        return grid_of(self.chart_domain)

    def lattice(self) -> np.ndarray:
        """The grid in units of its spacing."""
        return grid_of(self.chart_domain) / np.array(grid_spacing(self.chart_domain))

    @property
    def spacing(self) -> tuple[float, float]:
        """Of the grid."""
        return grid_spacing(self.chart_domain)


def _nearest_of(
    seeds: Float[Array, "n k"], places: Float[Array, "n 3"], within: Ball | None = None
) -> Callable[[Float[Array, "3"]], Float[Array, " k"]]:
    """Of samples the one whose place is nearest to a point.

    To points in a small ball only those are that are not farther from its center than
    the nearest is, and twice its radius: mostly a few.
    """
    known = jnp.all(jnp.isfinite(places), axis=1, keepdims=True)
    places = jnp.where(known, places, jnp.inf)

    def squares(point: Float[Array, "3"], places: Float[Array, "n 3"]) -> Array:
        off = places - point[None]
        return jax.vmap(dot)(off, off)

    def next_to(seeds: Array, places: Array, point: Array) -> Array:
        return seeds[jnp.argmin(squares(point, places))]

    if within is None or seeds.shape[0] <= _FEW:
        return functools.partial(next_to, seeds, places)
    away = squares(jax.lax.stop_gradient(within.center), places)
    farthest = jnp.sqrt(jnp.min(away)) + 2.0 * within.radius
    count = jnp.sum(away <= farthest * farthest)
    _, first = jax.lax.top_k(-away, _FEW)
    few = seeds[first], places[first]

    def found(point: Float[Array, "3"]) -> Float[Array, " k"]:
        of_few = functools.partial(next_to, *few)
        of_all = functools.partial(next_to, seeds, places)
        return cast(Array, jax.lax.cond(count <= _FEW, of_few, of_all, point))

    return found


def _step_to(target: Float[Array, "3"]) -> _Step:
    """The Gauss-Newton step along a surface towards the point next to a target."""

    def step(geometry: LocalGeometry) -> Array:
        offset = target - geometry.position
        across = matvec_transposed(geometry.frame[:, :2], offset)
        return solve_2x2(geometry.lengths, across)

    return step


def _newton_step_to(target: Float[Array, "3"]) -> _Step:
    """Newton's step there: tangents turn on the way, ``d t_i = e3 W dx``, (2.3).

    Beside the nearest point of a target off the surface the other one does not lead
    to the next one at once: its derivative is not the nearest point's.
    """

    def step(geometry: LocalGeometry) -> Array:
        across = matvec_transposed(geometry.frame, target - geometry.position)
        slope = geometry.lengths - across[2] * geometry.frame_rates
        return solve_2x2(slope, across[:2])

    return step


def _least_turn(
    matrix: Float[Array, "2 2"], turn: Float[Array, "2"]
) -> Float[Array, "2"]:
    """Smallest x with ``matrix x = turn``, also where one way does not turn at all.

    A cylinder's generator keeps the normal: its point then stays where it was.
    """
    square = matmul(matrix.T, matrix)
    slack = 1e-14 * (square[0, 0] + square[1, 1])
    pulled = matvec_transposed(matrix, turn)
    return solve_2x2(square + slack * jnp.eye(2, dtype=turn.dtype), pulled)
