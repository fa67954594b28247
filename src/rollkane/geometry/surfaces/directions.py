"""Directions and grids: coordinates of a sphere, domains and samples of surfaces."""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...validation.checks import FieldError, real_numbers
from ..local_geometry import LocalGeometry, from_chart
from ..rotations import tangent_pair
from ..small_linear import components, dot, norm

PointOfNormal = Callable[[Float[Array, "3"]], Float[Array, "3"]]
Range = tuple[tuple[float, float], tuple[float, float]]  # of two coordinates
# the part of a normal that must not vanish (AbstractSurface.normal_heading)
NormalHeading = Callable[[Float[Array, "3"]], Float[Array, "2"]]
SPHERE: Range = (-np.pi, np.pi), (-0.5 * np.pi, 0.5 * np.pi)  # as of direction_of
SPHERE_SAMPLES = 400
SPHERE_SPACING = (4.0 * np.pi / SPHERE_SAMPLES) ** 0.5  # [rad]
_PAIR_SAMPLES = 31  # along each of two coordinates


def domain_of(field: str, domain: object, count: int) -> tuple[Any, ...]:
    """Static ranges ((low, high), ...) from a user's domain, checked."""
    wanted = "(low, high)" if count == 1 else "((low, high), (low, high))"
    known = real_numbers(field, domain, f"give {wanted}")
    try:
        ranges = np.asarray(known, dtype=float).reshape(count, 2)
    except (TypeError, ValueError) as error:
        raise FieldError(field, domain, "must be ranges", f"give {wanted}") from error
    if not (np.all(np.isfinite(ranges)) and np.all(ranges[:, 0] < ranges[:, 1])):
        raise FieldError(
            field, domain, "must be finite with low < high", "order the limits"
        )
    return tuple((float(low), float(high)) for low, high in ranges)


def grid_of(domain: Range) -> np.ndarray:
    """Pairs of coordinates over two ranges, shape (n, 2)."""
    grids = [np.linspace(low, high, _PAIR_SAMPLES) for low, high in domain]
    return np.stack(np.meshgrid(*grids), axis=-1).reshape(-1, 2)


def grid_spacing(domain: Range) -> tuple[float, float]:
    """Distances of the pairs of ``grid_of`` along both coordinates."""
    first, second = ((high - low) / (_PAIR_SAMPLES - 1) for low, high in domain)
    return first, second


def beyond(
    u: Float[Array, " k"], domain: Sequence[tuple[float, float]]
) -> Float[Array, " k"]:
    """From the middle of ranges to coordinates outside of one; zero within them."""
    low, high = jnp.asarray(np.array(domain).T, u.dtype)
    outside = jnp.any((u < low) | (u > high))
    return jnp.where(outside, u - 0.5 * (low + high), 0.0)


def direction_of(q: Float[Array, "2"]) -> Float[Array, "3"]:
    """Direction with longitude q1 and latitude q2 [rad]."""
    c1, s1, c2, s2 = jnp.cos(q[0]), jnp.sin(q[0]), jnp.cos(q[1]), jnp.sin(q[1])
    return jnp.stack([c2 * c1, c2 * s1, s2])


def longitude_latitude(direction: Float[Array, "3"]) -> Float[Array, "2"]:
    """Longitude and latitude [rad] of a direction of any length."""
    x, y, z = components(direction)
    return jnp.stack([jnp.arctan2(y, x), jnp.arctan2(z, jnp.sqrt(x * x + y * y))])


def direction_rates(
    u: Float[Array, "3"], t1: Float[Array, "3"], t2: Float[Array, "3"], x: Array
) -> Float[Array, "3"]:
    """Rates of a direction of any length that turns by ``x`` along t1 and t2."""
    x1, x2 = components(x)
    return norm(u) * (x1 * t1 + x2 * t2)


def direction_chart(
    position: PointOfNormal, u: Float[Array, "3"], orientation: float
) -> LocalGeometry:
    """Local geometry of a function of a direction, in turns along its tangent pair."""
    direction = u / norm(u)
    t1, t2 = tangent_pair(direction)

    def local(x: Float[Array, "2"]) -> Array:
        turned = direction + x[0] * t1 + x[1] * t2
        return position(turned / jnp.sqrt(dot(turned, turned)))

    return from_chart(local, jnp.zeros(2, u.dtype), orientation, spin=False)


def sphere_of_directions(count: int) -> np.ndarray:
    """Directions spread evenly (Fibonacci lattice), shape (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
