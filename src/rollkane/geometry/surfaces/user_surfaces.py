"""Surfaces by a user's own JAX function of a place: graph and implicit."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ...validation.checks import positive, real
from ...validation.user_functions import UserFunction, check_output
from ..local_geometry import (
    LocalGeometry,
    from_chart,
    from_height,
    from_level_set,
    travel,
)
from ..rotations import tangent_pair
from ..small_linear import dot, inverse_sqrt, norm
from .directions import (
    SPHERE,
    SPHERE_SAMPLES,
    SPHERE_SPACING,
    Range,
    direction_of,
    domain_of,
    longitude_latitude,
    sphere_of_directions,
)
from .kinds import AbstractPairSurface, AbstractPointSurface
from .parametric import Parametric as Parametric  # its place before

_Pair = tuple[Array, Array]


class Graph(AbstractPairSurface):
    """The surface z = f(x, y, parameters); the other body is above.

    Coordinates x and y [m]; outward normal upwards.

    Attributes:
        f: The user's function, with its parameters.
        domain: Ranges of x and y in which a body's contact point is searched, and
            which are drawn [m]; the surface goes on beyond. Where it becomes upright a
            motion ends before.
    """

    is_regular: ClassVar[bool] = True
    is_bounded: ClassVar[bool] = False
    is_height: ClassVar[bool] = True
    f: UserFunction
    domain: Range = eqx.field(static=True)

    def __init__(
        self,
        f: Callable[..., Any],
        parameters: Any = None,
        domain: ArrayLike | Sequence[Sequence[float]] = ((-1.0, 1.0), (-1.0, 1.0)),
    ):
        """Make a graph.

        Args:
            f: ``f(x, y, parameters)``, ``f(x, y)`` or ``f(xy, parameters)`` -> z [m],
                written with jax.numpy and twice differentiable.
            parameters: Tree of numbers that f depends on; differentiable.
            domain: Ranges of x and y for searches and drawing [m].

        Raises:
            FieldError: f of another signature, or whose value is not one number.
        """
        self.f = UserFunction("Graph.f", f, 2, parameters)
        self.domain = domain_of("Graph.domain", domain, 2)
        check_output("Graph.f", self.f, (2,), ())

    @property
    def orientation(self) -> float:
        """d1 x d2 points up, out of the material."""
        return 1.0

    @property
    def chart_domain(self) -> Range:
        """Ranges of x and y for searches and drawing [m]."""
        return self.domain

    def geometry(self, u: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry at (x, y), from the derivatives of the height alone."""
        return from_height(self.f, u)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point (x, y, f(x, y)) [m]."""
        return jnp.concatenate([q, self.f(q)[None]])

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """The point's x and y [m]."""
        return point[:2]

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the surface, of first order [m]."""

        # forwards: a function that searches has no other way
        def twice(at: Array) -> _Pair:
            return (height := self.f(at)), height

        slope, height = cast(_Pair, jax.jacfwd(twice, has_aux=True)(point[:2]))
        return (point[2] - height) * inverse_sqrt(1.0 + dot(slope, slope))


class Implicit(AbstractPointSurface):
    """The surface f(p) = 0, with f < 0 in the material.

    Coordinates: the point itself [m]; it is put back onto the surface inside each
    evaluation, so that integration error never lifts it off.

    Attributes:
        f: The user's function, with its parameters.
        center: A point of the material from which rays find the surface [m].
        size: Distance within which they find it [m].
    """

    coordinate_count = 3
    is_by_place: ClassVar[bool] = True
    f: UserFunction
    center: Float[Array, "3"]
    size: Float[Array, ""]

    def __init__(
        self,
        f: Callable[..., Any],
        parameters: Any = None,
        center: ArrayLike | Sequence[ArrayLike] = (0.0, 0.0, 0.0),
        size: ArrayLike = 1.0,
    ):
        """Make an implicit surface.

        Args:
            f: ``f(p, parameters)``, ``f(x, y, z)`` ... -> one number, negative inside
                the material, written with jax.numpy and twice differentiable.
            parameters: Tree of numbers that f depends on; differentiable.
            center: A point of the material from which the surface is searched [m].
            size: How far from there it reaches at most [m], positive.

        Raises:
            FieldError: f of another signature, or whose value is not one number.
        """
        self.f = UserFunction("Implicit.f", f, 3, parameters)
        self.center = real("Implicit.center", center, (3,), "three lengths in metres")
        self.size = positive("Implicit.size", size, (), "a length in metres")
        check_output("Implicit.f", self.f, (3,), ())

    def onto(self, p: Float[Array, "3"]) -> Float[Array, "3"]:
        """A point near the surface moved onto it along the gradient [m]."""
        for _ in range(2):  # quadratic: 1e-5 off becomes 1e-10, then rounding
            level, slope = jax.value_and_grad(self.f)(p)
            p = p - slope * (level / dot(slope, slope))
        return p

    def geometry(self, u: Float[Array, "3"]) -> LocalGeometry:
        """Local geometry at the surface point next to ``u``."""
        return from_level_set(self.f, self.onto(u))

    def point(self, u: Float[Array, "3"]) -> Float[Array, "3"]:
        """The surface point next to ``u`` [m]."""
        return self.onto(u)

    def neighbour(self, u: Float[Array, "3"], x: Float[Array, "2"]) -> Array:
        """The point beside, by lengths along any tangent pair [m]."""
        slope = cast(Array, jax.grad(self.f)(u))
        first, second = tangent_pair(slope / norm(slope))
        return self.onto(u + x[0] * first + x[1] * second)

    def coordinate_rates(
        self, u: Float[Array, "3"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, "3"]:
        """Velocity of the point along the surface [m/s]."""
        del u
        return travel(geometry, x)

    def settled(self, u: Float[Array, "3"]) -> Float[Array, "3"]:
        """The point, moved onto the surface [m]."""
        return self.onto(u)

    def _along_ray(self, direction: Float[Array, "3"]) -> Float[Array, "3"]:
        """First surface point from the centre along a direction; NaN for none."""
        steps = jnp.linspace(0.0, 1.0, 65, dtype=self.size.dtype)[1:] * self.size

        def level(r: Array) -> Array:
            return self.f(self.center + r * direction)

        levels = jax.vmap(level)(steps)
        outside = levels > 0
        first = jnp.argmax(outside)
        low = jnp.where(first > 0, steps[jnp.maximum(first - 1, 0)], 0.0)
        high = steps[first]

        def halve(_: Array, bounds: _Pair) -> _Pair:
            low, high = bounds
            mid = 0.5 * (low + high)
            out = self.f(self.center + mid * direction) > 0
            return jnp.where(out, low, mid), jnp.where(out, mid, high)

        low, high = cast(_Pair, jax.lax.fori_loop(0, 30, halve, (low, high)))
        r = jnp.where(jnp.any(outside), 0.5 * (low + high), jnp.nan)
        return self.onto(self.center + r * direction)

    def samples(self) -> Array:
        """Surface points along rays from the centre; needs known numbers."""
        rays = jnp.asarray(sphere_of_directions(SPHERE_SAMPLES), dtype=self.size.dtype)
        return jax.lax.stop_gradient(jax.vmap(self._along_ray)(rays))

    def lattice(self) -> np.ndarray:
        """The rays."""
        return sphere_of_directions(SPHERE_SAMPLES)

    @property
    def spacing(self) -> tuple[Array, Array]:
        """Of the surface points [m], as if they were as far as the surface reaches."""
        return SPHERE_SPACING * self.size, SPHERE_SPACING * self.size

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the surface, of first order [m]."""
        level, slope = jax.value_and_grad(self.f)(point)
        steepness = dot(slope, slope)
        level_set = level * inverse_sqrt(jnp.where(steepness == 0.0, 1.0, steepness))
        return jnp.where(steepness == 0.0, jnp.sign(level) * self.size, level_set)

    def locate(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """The point, moved onto the surface [m]."""
        return self.onto(self.onto(point))

    @property
    def chart_domain(self) -> Range:
        """Longitude and latitude of the ray [rad]."""
        return SPHERE

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """First surface point along the ray of longitude q1 and latitude q2 [m]."""
        direction = direction_of(q)
        p = jax.lax.stop_gradient(self._along_ray(direction))
        for _ in range(3):  # Newton along the ray; carries two derivatives of the chart
            level, slope = jax.value_and_grad(self.f)(p)
            r = dot(p - self.center, direction) - level / dot(slope, direction)
            p = self.center + r * direction
        return p

    def chart_coordinates(self, u: Float[Array, "3"]) -> Float[Array, "2"]:
        """Longitude and latitude of the ray through the point [rad]."""
        return longitude_latitude(self.onto(u) - self.center)

    def chart_inverse(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """The first surface point along the ray [m]."""
        return self.chart(q)

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in the chart of rays, with ``spin_rates``.

        Rays from inside the material: east x north points outwards.
        """
        return from_chart(self.chart, q, 1.0)
