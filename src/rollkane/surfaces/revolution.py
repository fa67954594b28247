"""Surfaces of revolution by their meridian, smooth where it meets the axis."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..checks import FieldError, flag, is_traced
from ..geometry import LocalGeometry, from_chart
from ..small_linear import components, norm
from ..user_function import UserFunction, check_output
from .given import Range, domain_of
from .kinds import AbstractPointSurface, direction_rates, sphere_of_directions


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
    that pole like anywhere else. Coordinates: with no pole the pair (s, angle about
    z [rad]); with one, the pair ``|s - pole| * (cos, sin)``; with two, a direction
    whose polar angle runs from the first pole to the last.

    Attributes:
        profile: The user's function, with its parameters.
        domain: Range of the meridian's parameter s.
        poles: Which ends of the range lie on the axis, (first, last).
        rising: Whether the height grows from the first end to the last.
        inside: Whether the outward side is turned towards the axis.
    """

    profile: UserFunction
    domain: tuple[float, float] = eqx.field(static=True)
    poles: tuple[bool, bool] = eqx.field(static=True)
    rising: bool = eqx.field(static=True)
    inside: bool = eqx.field(static=True)
    coordinate_count: int = eqx.field(static=True)

    def __init__(
        self,
        profile,
        parameters=None,
        domain=(0.0, np.pi),
        poles=None,
        rising=None,
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
            rising: Whether the height grows from first to last; likewise.
            inside: The normal out of the material points away from the axis (a
                hanging bowl's is its lower side); True turns it round, so that the
                other body rolls within.

        Raises:
            FieldError: profile of another signature or result; ends of the meridian
                that cannot be found because the parameters are traced.
        """
        self.profile = UserFunction("Revolution.profile", profile, 1, parameters)
        (self.domain,) = domain_of("Revolution.domain", domain, 1)
        self.inside = flag("Revolution.inside", inside)
        meridian = _meridian(self.profile)
        check_output("Revolution.profile", meridian, jnp.zeros(()), (2,))
        if poles is None or rising is None:
            found_poles, found_rising = _ends(meridian, self.domain)
            poles = found_poles if poles is None else poles
            rising = found_rising if rising is None else rising
        first, last = poles
        self.poles = flag("Revolution.poles", first), flag("Revolution.poles", last)
        self.rising = flag("Revolution.rising", rising)
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

        def slope(s):
            return jax.jvp(_meridian(self.profile), (s,), (jnp.ones_like(s),))

        along = jnp.ones_like(place.s)
        (point, first), (_, second) = jax.jvp(slope, (place.s,), (along,))
        r, z = components(point)
        r_1, z_1 = components(first)
        r_2, z_2 = components(second)
        length = jnp.sqrt(r_1 * r_1 + z_1 * z_1)
        zero = jnp.zeros_like(r)
        # next to a pole r, z_1 and the way round vanish together: 0/0 has a limit
        at_pole = across == 0
        safe = jnp.where(at_pole, 1.0, across)
        around = jnp.where(at_pole, r_1 * place.edge, r / safe)
        lean = jnp.where(at_pole, z_2 * place.edge, z_1 / safe)
        side = self._side
        bend = (r_1 * z_2 - z_1 * r_2) / (length * length) * place.rate
        w11, w22 = -side * bend, -side * lean / length
        return LocalGeometry(
            # through x and y, so that derivatives are right at the very pole
            position=jnp.stack([around * x, around * y, z]),
            frame=jnp.stack(
                [
                    jnp.stack([r_1 * cosine, r_1 * sine, z_1]) / length,
                    jnp.stack([side * sine, -side * cosine, zero]),
                    jnp.stack([lean * x, lean * y, -r_1]) * (side / length),
                ],
                axis=1,
            ),
            lengths=jnp.stack(
                [jnp.stack([length * place.rate, zero]), jnp.stack([zero, around])]
            ),
            frame_rates=jnp.stack([jnp.stack([w11, zero]), jnp.stack([zero, w22])]),
        )

    def coordinate_rates(
        self, u: Float[Array, " k"], geometry: LocalGeometry, x: Float[Array, "2"]
    ) -> Float[Array, " k"]:
        """Rates for steps along the meridian and along e2."""
        del geometry
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

    def samples(self) -> np.ndarray:
        """Coordinates over the whole domain of the meridian and once round."""
        if all(self.poles):
            return sphere_of_directions(400)
        s, angle = np.meshgrid(
            np.linspace(*self.domain, 31), np.linspace(-np.pi, np.pi, 32)[:-1]
        )
        s, angle = s.ravel(), angle.ravel()
        if not any(self.poles):
            return np.stack([s, angle], axis=1)
        r = s - self.domain[0] if self.poles[0] else self.domain[1] - s
        return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)

    @property
    def chart_domain(self) -> Range:
        """Range of s, and once round [rad]."""
        return self.domain, (-np.pi, np.pi)

    def chart(self, q: Float[Array, "2"]) -> Float[Array, "3"]:
        """Point at s = q1 and angle q2 about z [m]."""
        r, z = components(_meridian(self.profile)(q[0]))
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
    """Cosine, sine and length of a plane vector; (1, 0, 0) for the zero vector."""
    square = x * x + y * y
    at_pole = square == 0
    length = jnp.sqrt(jnp.where(at_pole, 1.0, square))
    return (
        jnp.where(at_pole, 1.0, x / length),
        jnp.where(at_pole, 0.0, y / length),
        jnp.where(at_pole, 0.0, length),
    )


def _meridian(profile: UserFunction) -> Callable[[Array], Array]:
    """The profile as a function of a scalar with values of shape (2,)."""

    def meridian(s):
        value = profile(s[None])
        if isinstance(value, (tuple, list)):
            value = jnp.stack([jnp.asarray(x) for x in value])
        return value

    return meridian


def _ends(meridian, domain) -> tuple[tuple[bool, bool], bool]:
    """Which ends are poles, and whether the meridian rises, by evaluation."""
    places = jax.vmap(meridian)(jnp.linspace(domain[0], domain[1], 65))
    if is_traced(places):
        raise FieldError(
            "Revolution.poles",
            None,
            "cannot be found while the profile's parameters are traced",
            "give poles=(first, last) and rising= yourself",
        )
    radius, height = np.asarray(places).T
    near = 1e-6 * np.max(np.abs(radius))  # far below any real hole, above rounding
    poles = bool(abs(radius[0]) < near), bool(abs(radius[-1]) < near)
    return poles, bool(height[-1] >= height[0])
