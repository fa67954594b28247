"""One point of one surface as a value: the place where surfaces are differentiated.

A :class:`LocalGeometry` is made once per evaluation, by one of the three builders
below, and carried on; no later module differentiates a surface again. Lengths ``L`` and
frame rates ``W`` are kept instead of the fundamental forms, so that a sharp edge
(singular ``L``) is an ordinary value (docs/theory.md, (2.3)).
"""

from collections.abc import Callable
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.tracing import shared_in_c
from .rotations import tangent_pair
from .small_linear import components, cross, dot, matvec_transposed, norm, solve_2x2


class LocalGeometry(eqx.Module):
    """Position, frame and first-order motion of the frame at one point of a surface.

    With coordinates ``x`` of the surface (chart coordinates, or local ones at the
    point), ``d position = frame[:, m] L[m, a] dx_a`` and
    ``d e3 = -frame[:, m] W[m, a] dx_a``; ``e3`` is the unit normal that points out of
    the material. A convex body has negative second form and curvatures.

    Attributes:
        position: Point of the surface [m], axes of the surface's owner, shape (3,).
        frame: Columns e1, e2 (tangent) and e3 (normal, outwards) [1], shape (3, 3).
        lengths: ``L`` [m per coordinate unit], shape (2, 2); singular at an edge.
        frame_rates: ``W`` [1 per coordinate unit], shape (2, 2).
        spin_rates: ``gam`` [1 per coordinate unit], shape (2,): rotation of (e1, e2)
            about e3, ``gam_a = e2 . d_a e1``; None where any tangent pair serves.

    Source: docs/theory.md, (2.1) to (2.4).
    """

    position: Float[Array, "3"]
    frame: Float[Array, "3 3"]
    lengths: Float[Array, "2 2"]
    frame_rates: Float[Array, "2 2"]
    spin_rates: Float[Array, "2"] | None = None

    @property
    def chart_spin(self) -> Float[Array, "2"]:
        """``spin_rates`` of a chart, which always has them."""
        assert self.spin_rates is not None
        return self.spin_rates

    @property
    def normal(self) -> Float[Array, "3"]:
        """Unit normal out of the material [1], shape (3,)."""
        return self.frame[:, 2]

    @property
    def first_form(self) -> Float[Array, "2 2"]:
        """First fundamental form ``a = L^T L`` [m^2 per unit^2], shape (2, 2)."""
        return self.lengths.T @ self.lengths

    @property
    def second_form(self) -> Float[Array, "2 2"]:
        """Second form ``b = L^T W`` [m per unit^2], shape (2, 2).

        Sign: ``b_ab = position_ab . e3`` with e3 out of the material.
        """
        return self.lengths.T @ self.frame_rates

    @property
    def shape_operator(self) -> Float[Array, "2 2"]:
        """``W L^-1`` on (e1, e2) [1/m], shape (2, 2); not finite at an edge."""
        columns = [
            solve_2x2(self.lengths.T, row) for row in components(self.frame_rates)
        ]
        return jnp.stack(columns)

    @property
    def principal_curvatures(self) -> Float[Array, "2"]:
        """Eigenvalues of the shape operator, ascending [1/m], shape (2,).

        Negative for a convex body (e3 points outwards).
        """
        (a, b), (c, d) = (components(row) for row in components(self.shape_operator))
        mean = 0.5 * (a + d)
        half_gap = jnp.sqrt((0.5 * (a - d)) ** 2 + b * c)
        return jnp.stack([mean - half_gap, mean + half_gap])

    @property
    def regularity(self) -> Float[Array, ""]:
        """How well the two coordinates count for two, on point and normal [1].

        1 where their effects are equal and at right angles, 0 at the pole of a chart.
        """
        return self.regularity_by(jnp.ones(2, self.lengths.dtype))

    def regularity_by(self, units: Float[Array, "2"]) -> Float[Array, ""]:
        """The same for coordinates that are measured by units of their own [1]."""
        effects: list[Array] = []
        for matrix in (self.lengths * units[None], self.frame_rates * units[None]):
            largest = jnp.max(jnp.abs(matrix))
            tiny = cast(float, jnp.finfo(matrix.dtype).tiny)
            effects.append(matrix / jnp.maximum(largest, tiny))
        first, second = (jnp.concatenate([e[:, a] for e in effects]) for a in range(2))
        squares, along = (dot(first, first), dot(second, second)), dot(first, second)
        area = squares[0] * squares[1] - along * along
        return jnp.sqrt(jnp.maximum(area, 0.0)) / jnp.maximum(*squares)

    @property
    def upright(self) -> Float[Array, "3"]:
        """The normal, as long as the coordinates are regular, none at a pole [1].

        Behind the pole of a chart ``d1 x d2`` is the normal on the other side. Where a
        surface over x and y becomes upright these come to stand still: of so small a
        rate r a step shorter than eps / r is filled by rounding. Below a third of the
        digits that is a pole, too; above it such steps are 4e-11 of a motion's time.
        """
        regular = self.regularity
        least = float(np.finfo(regular.dtype).eps) ** (1.0 / 3.0)
        return self.normal * jnp.where(regular < least, 0.0, regular)

    def turned_over(self) -> "LocalGeometry":
        """The same point with the frame (e1, -e2, -e3): e3 into the material."""
        flip = jnp.array([1.0, -1.0], self.lengths.dtype)
        spin = self.spin_rates
        return LocalGeometry(
            position=self.position,
            frame=self.frame * jnp.array([[1.0, -1.0, -1.0]], self.frame.dtype),
            lengths=self.lengths * flip[:, None],
            frame_rates=self.frame_rates * -flip[:, None],
            spin_rates=None if spin is None else -spin,
        )


@shared_in_c
def from_chart(
    position: Callable[[Float[Array, "2"]], Float[Array, "3"]],
    q: Float[Array, "2"],
    orientation: float = 1.0,
    spin: bool = True,
) -> LocalGeometry:
    """Geometry of a chart by nested forward derivatives.

    Args:
        position: Chart, coordinates to a point [m].
        q: Coordinates [chart units].
        orientation: +1 where d1 x d2 points out of the material, else -1.
        spin: Whether ``spin_rates`` are wanted.

    Source: docs/theory.md, (2.1), (2.2): Gram-Schmidt frame, L upper triangular,
    W = L^-T b.
    """
    along_1, along_2 = jnp.eye(2, dtype=q.dtype)

    def tangent_1(q: Array) -> tuple[Array, Array]:
        return jax.jvp(position, (q,), (along_1,))

    def tangent_2(q: Array) -> Array:
        return jax.jvp(position, (q,), (along_2,))[1]

    (rho, rho_1), (_, rho_11) = jax.jvp(tangent_1, (q,), (along_1,))
    rho_2, rho_22 = jax.jvp(tangent_2, (q,), (along_2,))
    _, rho_12 = jax.jvp(tangent_2, (q,), (along_1,))

    l11 = norm(rho_1)
    e1 = rho_1 / l11
    across = cross(rho_1, rho_2) * orientation
    e3 = across / norm(across)
    e2 = cross(e3, e1)
    l12, l22 = dot(e1, rho_2), dot(e2, rho_2)
    b11, b12, b22 = dot(rho_11, e3), dot(rho_12, e3), dot(rho_22, e3)
    w11, w12 = b11 / l11, b12 / l11
    zero = jnp.zeros_like(l11)
    return LocalGeometry(
        position=rho,
        frame=jnp.stack([e1, e2, e3], axis=1),
        lengths=jnp.stack([jnp.stack([l11, l12]), jnp.stack([zero, l22])]),
        frame_rates=jnp.stack(
            [
                jnp.stack([w11, w12]),
                jnp.stack([(b12 - l12 * w11) / l22, (b22 - l12 * w12) / l22]),
            ]
        ),
        spin_rates=jnp.stack([dot(e2, rho_11), dot(e2, rho_12)]) / l11
        if spin
        else None,
    )


@shared_in_c
def from_height(
    height: Callable[[Float[Array, "2"]], Float[Array, ""]],
    q: Float[Array, "2"],
    orientation: float = 1.0,
) -> LocalGeometry:
    """Geometry of ``z = height(x, y)`` in the chart (x, y); no spin rates.

    What :func:`from_chart` gives, with a third of the equations.

    Args:
        height: [m] as a function of (x, y) [m].
        q: (x, y) [m].
        orientation: +1 where the normal out of the material points up, else -1.
    """
    along_1, along_2 = jnp.eye(2, dtype=q.dtype)

    def slope_1(q: Array) -> tuple[Array, Array]:
        return jax.jvp(height, (q,), (along_1,))

    def slope_2(q: Array) -> Array:
        return jax.jvp(height, (q,), (along_2,))[1]

    (z, z_1), (_, z_11) = jax.jvp(slope_1, (q,), (along_1,))
    z_2, z_22 = jax.jvp(slope_2, (q,), (along_2,))
    z_12 = jax.jvp(slope_2, (q,), (along_1,))[1]

    l11 = jnp.sqrt(1.0 + z_1 * z_1)
    steep = jnp.sqrt(1.0 + z_1 * z_1 + z_2 * z_2)
    # where it is upright x and y stand still but for steps that roundings fill, of eps
    # by the slope: here 2e-12 of a motion's time each
    upright = float(np.finfo(steep.dtype).eps) ** -0.25
    l11 = jnp.where(steep < upright, l11, jnp.nan)
    l12, l22 = z_1 * z_2 / l11, orientation * steep / l11
    up = orientation / steep
    b11, b12, b22 = z_11 * up, z_12 * up, z_22 * up
    w11, w12 = b11 / l11, b12 / l11
    zero, one = jnp.zeros_like(z), jnp.ones_like(z)
    e1 = jnp.stack([one, zero, z_1]) / l11
    e3 = jnp.stack([-z_1, -z_2, one]) * up
    return LocalGeometry(
        position=jnp.concatenate([q, z[None]]),
        frame=jnp.stack([e1, cross(e3, e1), e3], axis=1),
        lengths=jnp.stack([jnp.stack([l11, l12]), jnp.stack([zero, l22])]),
        frame_rates=jnp.stack(
            [
                jnp.stack([w11, w12]),
                jnp.stack([(b12 - l12 * w11) / l22, (b22 - l12 * w12) / l22]),
            ]
        ),
    )


def from_normal(
    point: Callable[[Float[Array, "3"]], Float[Array, "3"]],
    normal: Float[Array, "3"],
    pair: tuple[Float[Array, "3"], Float[Array, "3"]] | None = None,
) -> LocalGeometry:
    """Geometry of a surface parametrized by its normal; edges included.

    The local coordinates are the turns of the normal along e1 and e2, so
    ``W = -identity`` and ``L`` holds the radii of curvature (zero across an edge).

    Args:
        point: Unit normal out of the material -> point with that normal [m].
        normal: Unit normal [1].
        pair: Tangent pair to use; any by default.
    """
    e1, e2 = tangent_pair(normal) if pair is None else pair
    rho, travel_1 = jax.jvp(point, (normal,), (e1,))
    travel_2 = jax.jvp(point, (normal,), (e2,))[1]
    l12 = dot(e1, travel_2)  # symmetric: the normal map is a gradient
    lengths = jnp.stack(
        [jnp.stack([dot(e1, travel_1), l12]), jnp.stack([l12, dot(e2, travel_2)])]
    )
    return LocalGeometry(
        position=rho,
        frame=jnp.stack([e1, e2, normal], axis=1),
        lengths=lengths,
        frame_rates=-jnp.eye(2, dtype=normal.dtype),
    )


@shared_in_c
def from_level_set(
    level: Callable[[Float[Array, "3"]], Float[Array, ""]], point: Float[Array, "3"]
) -> LocalGeometry:
    """Geometry of ``level(p) = 0`` at a point of it, the gradient out of the material.

    The local coordinates are lengths along e1 and e2, so ``L = identity``.

    Source: docs/theory.md, (2.4).
    """

    def gradient(p: Array) -> Array:
        return cast(Array, jax.grad(level)(p))

    slope = gradient(point)
    steepness = norm(slope)
    e3 = slope / steepness
    e1, e2 = tangent_pair(e3)
    bend_1 = jax.jvp(gradient, (point,), (e1,))[1]
    bend_2 = jax.jvp(gradient, (point,), (e2,))[1]
    w12 = dot(e1, bend_2)
    rates = [[dot(e1, bend_1), w12], [w12, dot(e2, bend_2)]]
    return LocalGeometry(
        position=point,
        frame=jnp.stack([e1, e2, e3], axis=1),
        lengths=jnp.eye(2, dtype=point.dtype),
        frame_rates=jnp.stack([jnp.stack(row) for row in rates]) / -steepness,
    )


def travel(geometry: LocalGeometry, x: Float[Array, "2"]) -> Float[Array, "3"]:
    """Velocity of the point for coordinate rates ``x``, owner's axes [m/s]."""
    steps = jnp.stack([dot(row, x) for row in components(geometry.lengths)])
    return matvec_transposed(geometry.frame.T[:2], steps)
