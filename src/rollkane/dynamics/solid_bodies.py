"""Mass, mass centre and inertia of a body of even density, from its own surface.

Integrals over the body are integrals over its surface (divergence theorem), taken over
the chart with Gauss-Legendre points: the error falls faster than any power of their
number where the chart is smooth.
"""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from ..geometry.surfaces import AbstractSurface
from ..validation.checks import FieldError, is_traced, positive
from .bodies import Body
from .chart_covers import covers_again

_POINTS = 64  # along each parameter of the chart, in each of two halves
_ROUNDING = 1e-13  # sums of 16,384 numbers
_CLOSED = 1e-6  # of the volume: how far a surface may be from closed


def solid_body(density: ArrayLike, surface: AbstractSurface) -> Body:
    """A body that is filled evenly up to its surface.

    Differentiable by the density and by every number of the surface.

    Args:
        density: [kg/m^3], positive.
        surface: A closed surface, whose chart covers it: ``Sphere``, ``Ellipsoid``,
            ``Torus``, ``Revolution`` from pole to pole, a closed ``Parametric``.

    Returns:
        The body, with mass [kg], mass centre [m] and inertia about it [kg m^2] on the
        surface's axes.

    Raises:
        FieldError: a surface that is not closed, or whose chart covers it several
            times (surfaces that are traced are taken for closed and covered once).

    Source: ``3 V`` is the integral of ``x . n`` over the surface, and so on for the
    moments of first and second order.
    """
    rho = jnp.asarray(positive("solid_body.density", density, (), "kg per m^3"))
    field = "solid_body.surface"
    if not isinstance(surface, AbstractSurface):  # pyright: ignore
        remedy = "give one of the catalogue, for example Sphere(radius=0.1)"
        raise FieldError(field, surface, "must be a surface", remedy)
    volume, first, second, flux = _moments(surface)
    miss = flux - volume * jnp.eye(3, dtype=flux.dtype)
    if not is_traced(volume, miss):
        size = float(abs(volume))
        # each component of x carries the same flux through a surface that is closed
        if not (size > 0 and float(jnp.max(jnp.abs(miss))) < _CLOSED * size):
            remedy = "give one that is, or Body(mass, inertia, surface)"
            kind = type(surface).__name__
            raise FieldError(field, kind, "is not closed, and has no volume", remedy)
        if covers_again(surface):
            remedy = "give a domain in which each of its points comes once"
            problem = "is covered more than once by its chart"
            raise FieldError(field, type(surface).__name__, problem, remedy)
    volume, first, second = (jnp.sign(volume) * x for x in (volume, first, second))
    center = first / volume
    about = second - volume * center[:, None] * center[None, :]
    trace = about[0, 0] + about[1, 1] + about[2, 2]
    inertia = rho * (trace * jnp.eye(3, dtype=about.dtype) - about)
    length = jnp.sqrt(trace / volume)
    inertia, center = rounded(inertia, rho * trace), rounded(center, length)
    return Body(rho * volume, inertia, surface, center)


def rounded(values: Any, size: Any) -> Any:
    """What is zero but for rounding as zero, of which the equations take no account.

    Args:
        values: Known or traced numbers.
        size: What they would be if they were large.
    """
    if is_traced(values, size):
        return values
    known = np.array(values)
    known[np.abs(known) < _ROUNDING * float(size)] = 0.0
    return known


def _moments(surface: AbstractSurface) -> tuple[Array, Array, Array, Array]:
    """Volume, first and second moments, and the flux of each component of x.

    All of either sign, as the chart's normal points.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
    axes: list[np.ndarray] = []
    shares: list[np.ndarray] = []
    for low, high in surface.chart_domain:
        middle = 0.5 * (low + high)
        halves = [(low, middle), (middle, high)]
        places = [a + 0.5 * (b - a) * (nodes + 1.0) for a, b in halves]
        axes.append(np.concatenate(places))
        shares.append(np.concatenate([0.5 * (b - a) * weights for a, b in halves]))
    q = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    area = np.outer(*shares).ravel()
    dtype = jnp.result_type(float)

    def at(place: Array) -> tuple[Array, Array]:
        x = surface.chart(place)
        along = cast(Array, jax.jacfwd(surface.chart)(place))
        (a, b), (c, d), (e, f) = along
        return x, jnp.stack([c * f - e * d, e * b - a * f, a * d - c * b])

    x, normal = jax.vmap(at)(jnp.asarray(q, dtype))
    weighted = normal * jnp.asarray(area, dtype)[:, None]
    flux = x.T @ weighted
    volume = (flux[0, 0] + flux[1, 1] + flux[2, 2]) / 3.0
    first = 0.5 * jnp.sum(x * x * weighted, axis=0)
    squares = jnp.sum(x * x * x * weighted, axis=0) / 3.0
    second = jnp.zeros((3, 3), dtype)
    for i in range(3):
        for j in range(3):
            own = 0.5 * jnp.sum(x[:, i] * x[:, i] * x[:, j] * weighted[:, i])
            second = second.at[i, j].set(squares[i] if i == j else own)
    return volume, first, 0.5 * (second + second.T), flux
