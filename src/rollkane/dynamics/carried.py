"""What is carried, at one instant: where it is, how it moves, what moves it.

The mechanics needs nothing else of it.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.small_linear import components, dot, matmul


class Turning(eqx.Module):
    """Rotation of a carried rigid body at one instant, on BODY axes.

    Attributes:
        rotation: From its own to body axes [1], shape (3, 3).
        inertia: About its own mass centre [kg m^2], shape (3, 3).
        velocity: ``w_r``, relative to the rolling body [rad/s], shape (3,).
        bias: ``w_r*`` at alpha'' = 0, relative rate of it [rad/s^2], shape (3,).
        partials: ``dw_r/dalpha'^s`` [rad per unit of alpha], each of shape (3,).
    """

    rotation: Float[Array, "3 3"]
    inertia: Float[Array, "3 3"]
    velocity: Float[Array, "3"]
    bias: Float[Array, "3"]
    partials: tuple[Float[Array, "3"], ...]


class Carried(eqx.Module):
    """Masses inside the rolling body at one instant, on BODY axes, from its origin.

    Attributes:
        mass: [kg], shape (k,).
        place: ``r`` [m], shape (3, k).
        velocity: ``r*`` relative to the body [m/s], shape (3, k).
        bias: ``r**`` at alpha'' = 0 [m/s^2], shape (3, k).
        partials: ``dr/dalpha^s`` [m per unit of alpha], each of shape (3, k); empty
            where the motion is prescribed.
        turning: Rotation of a rigid body (then k = 1); None for point masses.

    Source: docs/theory.md, (4.2).
    """

    mass: Float[Array, " k"]
    place: Float[Array, "3 k"]
    velocity: Float[Array, "3 k"]
    bias: Float[Array, "3 k"]
    partials: tuple[Float[Array, "3 k"], ...]
    turning: Turning | None = None


def turning_of(
    inertia: Float[Array, "3 3"],
    R: Float[Array, "3 3"],
    R_dot: Float[Array, "3 3"],
    R_ddot: Float[Array, "3 3"],
    partials: tuple[Float[Array, "3 3"], ...],
) -> Turning:
    """Relative rotation on body axes: ``dR R^T = skew(dw)``.

    Args:
        inertia: About the part's own mass centre, its own axes [kg m^2].
        R: From its own to body axes [1].
        R_dot: Rate of it [1/s].
        R_ddot: Second rate at alpha'' = 0 [1/s^2].
        partials: ``dR/dalpha^s`` [1 per unit of alpha].
    """

    def entry(rates: Float[Array, "3 3"], i: int, j: int) -> Float[Array, ""]:
        return dot(rates[i], R[j])

    def spin(rates: Float[Array, "3 3"]) -> Float[Array, "3"]:
        return jnp.stack([entry(rates, 2, 1), entry(rates, 0, 2), entry(rates, 1, 0)])

    w = components(spin(R_dot))
    products = jnp.stack([w[1] * w[2], w[2] * w[0], w[0] * w[1]])
    return Turning(
        rotation=R,
        inertia=matmul(matmul(R, inertia), R.T),
        velocity=jnp.stack(w),
        bias=spin(R_ddot) - products,
        partials=tuple(spin(partial) for partial in partials),
    )
