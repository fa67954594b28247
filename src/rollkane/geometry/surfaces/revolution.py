"""Surfaces of revolution by their meridian, smooth where it meets the axis."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ...validation.checks import flag
from ...validation.user_functions import UserFunction, check_output
from ..local_geometry import LocalGeometry, from_chart
from ..small_linear import components, dot, norm, sign
from .abstract_surface import Ball
from .directions import (
    SPHERE_SAMPLES,
    SPHERE_SPACING,
    Range,
    beyond,
    direction_rates,
    domain_of,
    grid_of,
    grid_spacing,
    sphere_of_directions,
)
from .kinds import AbstractPointSurface
from .meridians import (
    DENSE,
    found_poles,
    found_rising,
    meridian_of,
    refuse_tips,
    sampled,
)
from .moved import MovedFunction


class _OnMeridian(NamedTuple):
    """Where a coordinate lies: meridian, way along it, distance from its pole."""

    s: Array  # parameter of the meridian
    way: tuple[Array, Array]  # from the pole, of length `across`; smooth at the pole
    cosine: Array  # direction of the meridian's half-plane
    sine: Array
    across: Array  # unit way round per radian of turn: sin(polar angle), |u| or 1
    rate: Array | float  # ds per unit of local coordinate
    edge: Array | float  # ds per unit of `across` next to the pole


class Revolution(AbstractPointSurface):
    """A surface of revolution about the z axis, by its meridian.

    Where the meridian meets the axis the surface is smooth, and a body rolls through
    that pole like anywhere else; at the very pole first derivatives alone are right.
    Coordinates: with no pole the pair (s, angle about z [rad]); with one, the pair
    ``|s - pole| * (cos, sin)``; with two, a direction whose polar angle runs from the
    first pole to the last.

    Attributes:
        profile: The user's function, with its parameters.
        domain: Range of the meridian's parameter s.
        poles: Which ends of the range lie on the axis, (first, last).
        rising: Whether the height grows from the first end to the last.
        inside: Whether the outward side is turned towards the axis.
    """

    searches_distance: ClassVar[bool] = True
    profile: UserFunction
    domain: tuple[float, float] = eqx.field(static=True)
    poles: tuple[bool, bool] = eqx.field(static=True)
    rising: bool = eqx.field(static=True)
    inside: bool = eqx.field(static=True)
    coordinate_count: int = eqx.field(static=True)

    def __init__(
        self,
        profile: Callable[..., Any],
        parameters: Any = None,
        domain: ArrayLike | Sequence[float] = (0.0, np.pi),
        poles: tuple[bool, bool] | None = None,
        rising: bool | None = None,
        inside: bool = False,
    ):
        """Make a surface of revolution.

        Args:
            profile: ``profile(s)`` or ``profile(s, parameters)`` -> (radius, height)
                [m], written with jax.numpy and twice differentiable. At a pole the
                radius is zero and the height stationary.
            parameters: Tree of numbers that it depends on; differentiable.
            domain: Range (first, last) of s; a meridian without poles goes on beyond.
            poles: Whether the radius vanishes at (first, last); found by evaluation
                when left out.
            rising: Whether the height grows from first to last; likewise, and of a
                meridian that ends at the height at which it begins (a tube's cross
                section) whether it goes anticlockwise in the plane of radius and
                height.
            inside: True turns the outward side towards the axis, else false. Else the
                normal out of the material points away from the axis (a hanging bowl's
                is its lower side); True lets the other body roll within.

        A contact that comes to the rim of a meridian with one pole (a cup) ends a run
        with ``Code.SURFACE_EDGE``, and so does a flight that comes to what would go on
        behind it.

        Raises:
            FieldError: profile of another signature or result; ends of the meridian
                that cannot be found because the parameters are traced; a meridian that
                meets the axis in a tip, or whose outward side cannot be told.
        """
        self.profile = UserFunction("Revolution.profile", profile, 1, parameters)
        (self.domain,) = domain_of("Revolution.domain", domain, 1)
        self.inside = flag("Revolution.inside", inside)
        meridian = meridian_of(self.profile)
        check_output("Revolution.profile", meridian, (), (2,))
        if poles is None or rising is None:
            places = sampled(meridian, self.domain)
            poles = found_poles(places) if poles is None else poles
            rising = found_rising(places) if rising is None else rising
        first, last = poles
        self.poles = flag("Revolution.poles", first), flag("Revolution.poles", last)
        self.rising = flag("Revolution.rising", rising)
        refuse_tips(meridian, self.domain, self.poles)
        self.coordinate_count = 3 if all(self.poles) else 2

    @property
    def _side(self) -> float:
        """Sign of the outward normal against (height', -radius') of the meridian."""
        return 1.0 if self.rising != self.inside else -1.0

    def _place(self, u: Float[Array, " k"]) -> _OnMeridian:
        if not any(self.poles):
            s, angle = components(u)
            cosine, sine = jnp.cos(angle), jnp.sin(angle)
            one = jnp.ones_like(s)
            return _OnMeridian(s, (cosine, sine), cosine, sine, one, 1.0, 1.0)
        first, last = self.domain
        if all(self.poles):
            x, y, z = components(u / norm(u))
            cosine, sine, across = _polar(x, y)
            rate = (last - first) / np.pi
            # the profile is of this angle: a quarter of a step in C (0.5 us of
            # 2.4, an egg by Dopri8), which only another parameter would spare
            s = first + rate * jnp.arctan2(across, z)
            edge = jnp.where(z < 0, -rate, rate)
            return _OnMeridian(s, (x, y), cosine, sine, across, rate, edge)
        x, y = components(u)
        cosine, sine, across = _polar(x, y)
        rate = 1.0 if self.poles[0] else -1.0
        s = first + across if self.poles[0] else last - across
        return _OnMeridian(s, (x, y), cosine, sine, across, rate, rate)

    def geometry(self, u: Float[Array, " k"]) -> LocalGeometry:
        """Local geometry from the meridian's derivatives; regular at the poles.

        e1 runs along the meridian (growing s), e2 along the parallel; L and W are
        diagonal because both are lines of curvature.
        """
        place = self._place(u)
        cosine, sine, across = place.cosine, place.sine, place.across
        x, y = place.way

        def slope(s: Array) -> tuple[Array, Array]:
            return jax.jvp(meridian_of(self.profile), (s,), (jnp.ones_like(s),))

        along = jnp.ones_like(place.s)
        (point, first), (_, second) = jax.jvp(slope, (place.s,), (along,))
        r, z = components(point)
        r_1, z_1 = components(first)
        r_2, z_2 = components(second)
        length = jnp.sqrt(r_1 * r_1 + z_1 * z_1)
        zero = jnp.zeros_like(r)
        # next to a pole r, z_1 and the way round vanish together: their ratios have
        # limits, off by across^2, where of the ratios only roundings would be left
        at_pole = across < np.sqrt(np.finfo(across.dtype).eps)
        safe = jnp.where(at_pole, 1.0, across)
        around = jnp.where(at_pole, r_1 * place.edge, r / safe)
        lean = jnp.where(at_pole, z_2 * place.edge, z_1 / safe)
        side = self._side
        # so do those of the tangents, which tilt with the normal: through x and y, too
        rise = jnp.where(at_pole, lean * (x * cosine + y * sine), z_1)
        round_ = side * lean * (x * sine - y * cosine)
        tilt = jnp.where(at_pole, round_ / jnp.where(at_pole, r_1, 1.0), 0.0)
        bend = (r_1 * z_2 - z_1 * r_2) / (length * length) * place.rate
        w11, w22 = -side * bend, -side * lean / length
        return LocalGeometry(
            # through x and y, so that derivatives are right at the very pole
            position=jnp.stack([around * x, around * y, z]),
            frame=jnp.stack(
                [
                    jnp.stack([r_1 * cosine, r_1 * sine, rise]) / length,
                    jnp.stack([side * sine, -side * cosine, tilt]),
                    jnp.stack([lean * x, lean * y, -r_1]) * (side / length),
                ],
                axis=1,
            ),
            lengths=jnp.stack(
                [jnp.stack([length * place.rate, zero]), jnp.stack([zero, around])]
            ),
            frame_rates=jnp.stack([jnp.stack([w11, zero]), jnp.stack([zero, w22])]),
        )

    def neighbour(self, u: Float[Array, " k"], x: Float[Array, "2"]) -> Array:
        """Coordinates beside, by steps along the meridian and round."""
        return u + self._steps(u, x)

    def coordinate_rates(
        self, u: Float[Array, " k"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, " k"]:
        """Rates for steps along the meridian and along e2."""
        del geometry
        return self._steps(u, x)

    def _steps(self, u: Float[Array, " k"], x: Float[Array, "2"]) -> Float[Array, " k"]:
        if not any(self.poles):
            return jnp.stack([x[0], -self._side * x[1]])
        place = self._place(u)
        cosine, sine = place.cosine, place.sine
        round_ = -self._side * jnp.stack([-sine, cosine])
        if not all(self.poles):
            return jnp.stack([cosine, sine]) * x[0] + round_ * x[1]
        z = u[2] / norm(u)
        south = jnp.stack([z * cosine, z * sine, -place.across])
        east = jnp.concatenate([round_, jnp.zeros_like(z)[None]])
        return direction_rates(u, south, east, x)

    def extent(self, u: Float[Array, " k"]) -> Float[Array, ""] | None:
        """Of a meridian with one pole, how far its other end is; else None."""
        if sum(self.poles) != 1:
            return None
        return self.domain[1] - self.domain[0] - norm(u)

    def beyond_samples(self, u: Float[Array, " k"]) -> Float[Array, " k"] | None:
        """Without poles: from the middle of the meridian to a pair beyond its ends."""
        if any(self.poles):
            return None
        shift = beyond(u[:1], [self.domain])
        return jnp.concatenate([shift, jnp.zeros_like(shift)])

    def continued(self, shift: Float[Array, " k"]) -> "Revolution":
        """The surface with another part of the meridian."""
        moved = MovedFunction(self.profile, shift[:1])
        return eqx.tree_at(lambda s: s.profile, self, moved)

    def samples(self) -> np.ndarray:
        """Coordinates over the whole domain of the meridian and once round."""
        if all(self.poles):
            return sphere_of_directions(SPHERE_SAMPLES)
        s, angle = grid_of(self.chart_domain).T
        if not any(self.poles):
            return np.stack([s, angle], axis=1)
        r = s - self.domain[0] if self.poles[0] else self.domain[1] - s
        return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)

    def lattice(self) -> np.ndarray:
        """Directions, or the pairs in units of their spacing."""
        if all(self.poles):
            return self.samples()
        return grid_of(self.chart_domain) / np.array(grid_spacing(self.chart_domain))

    @property
    def spacing(self) -> tuple[float, float]:
        """Of parameter and angle, or of directions [rad]."""
        if all(self.poles):
            return SPHERE_SPACING, SPHERE_SPACING
        along, around = grid_spacing(self.chart_domain)
        if not any(self.poles):
            return along, around
        return along, around * (self.domain[1] - self.domain[0])

    def signed_distance(self, point: Float[Array, "3"]) -> Float[Array, ""]:
        """Distance from the nearest point of the meridian [m].

        Infinite beyond an end of the meridian that is no pole.
        """
        return self.distances(point.dtype)(point)

    def distances(
        self, dtype: Any, within: Ball | None = None
    ) -> Callable[[Float[Array, "3"]], Float[Array, ""]]:
        """The same, of many points."""
        del within  # a meridian has few samples
        first, last = self.domain
        meridian = meridian_of(self.profile)
        seeds = jnp.linspace(first, last, DENSE, dtype=dtype)
        places = jax.vmap(meridian)(seeds)
        longest = (last - first) / (DENSE - 1)
        closed = norm(places[0] - places[-1]) < 1e-6 * jnp.max(jnp.abs(places))

        def slope(s: Array) -> tuple[Array, Array]:
            return jax.jvp(meridian, (s,), (jnp.ones_like(s),))

        def distance(point: Float[Array, "3"]) -> Float[Array, ""]:
            target = jnp.stack([norm(point[:2]), point[2]])

            def advance(s: Array, _: None) -> tuple[Array, None]:
                (place, along), (_, bend) = jax.jvp(slope, (s,), (jnp.ones_like(s),))
                square, left = dot(along, along), target - place
                curved = square - dot(left, bend)  # not positive far from the surface
                curved = jnp.where(curved > 0.1 * square, curved, square)
                return s + jnp.clip(dot(left, along) / curved, -longest, longest), None

            gaps = jax.vmap(norm)(places - target[None])
            s, _ = jax.lax.scan(advance, seeds[jnp.nanargmin(gaps)], length=6)
            place, (r_1, z_1) = slope(s)
            away, up = components(target - place)
            out = sign(self._side * (away * z_1 - up * r_1)) * norm(target - place)
            starts, ends = self.poles
            beyond = (s < first) & (not starts) | (s > last) & (not ends)
            return jnp.where(beyond & ~closed, jnp.inf, out)

        return distance

    @property
    def chart_domain(self) -> Range:
        """Range of s, and once round [rad]."""
        return self.domain, (-np.pi, np.pi)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point at s = q1 and angle q2 about z [m]."""
        r, z = components(meridian_of(self.profile)(q[0]))
        return jnp.stack([r * jnp.cos(q[1]), r * jnp.sin(q[1]), z])

    def chart_coordinates(self, u: Float[Array, " k"]) -> Float[Array, "2"]:
        """Meridian parameter s, and angle about z [rad]."""
        place = self._place(u)
        return jnp.stack([place.s, jnp.arctan2(place.sine, place.cosine)])

    def chart_inverse(self, q: Float[Array, "2"]) -> Float[Array, " k"]:
        """Contact coordinates at s = q1 and angle q2 about z."""
        s, angle = components(q)
        if not any(self.poles):
            return q
        first, last = self.domain
        round_ = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        if all(self.poles):
            polar = (s - first) * (np.pi / (last - first))
            return jnp.concatenate([jnp.sin(polar) * round_, jnp.cos(polar)[None]])
        return (s - first if self.poles[0] else last - s) * round_

    def chart_geometry(self, q: Float[Array, "2"]) -> LocalGeometry:
        """Local geometry in the chart (s, angle), with ``spin_rates``."""
        return from_chart(self.chart, q, -self._side)


def _polar(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Cosine, sine and length of a plane vector; (1, 0, 0) for none but a rounding.

    Whose direction would say nothing, and turn infinitely fast.
    """
    square = x * x + y * y
    at_pole = square <= np.finfo(square.dtype).eps ** 2
    length = jnp.sqrt(jnp.where(at_pole, 1.0, square))
    return (
        jnp.where(at_pole, 1.0, x / length),
        jnp.where(at_pole, 0.0, y / length),
        jnp.where(at_pole, 0.0, length),
    )
