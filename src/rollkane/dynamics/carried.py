"""What is carried, at one instant: where it is, how it moves, what moves it.

The mechanics needs nothing else of it.
"""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.small_linear import components, cross, dot, matmul, matvec
from ..kinematics.contact import Contact


class Turning(eqx.Module):
    """Rotation of a carried rigid body at one instant, on BODY axes.

    Attributes:
        rotation: From its own to body axes [1], shape (3, 3).
        inertia: About its own mass centre [kg m^2], shape (3, 3).
        velocity: ``w_r``, relative to the rolling body [rad/s], shape (3,).
        bias: ``w_r*`` at alpha'' = 0, relative rate of it [rad/s^2], shape (3,).
        partials: ``dw_r/dalpha'^s`` [rad per unit of alpha], each of shape (3,).
        driven: The part of ``w_r`` that a prescribed motion gives [rad/s], shape (3,);
            None: there is none.
    """

    rotation: Float[Array, "3 3"]
    inertia: Float[Array, "3 3"]
    velocity: Float[Array, "3"]
    bias: Float[Array, "3"]
    partials: tuple[Float[Array, "3"], ...]
    driven: Float[Array, "3"] | None = None


class Pairing(eqx.Module):
    """How a body that rolls on its carrier touches it, at one instant.

    Attributes:
        contact: Of the pair alone, on the body's OWN axes; the surface in the place of
            a base at rest.
        rotation: From its own to the carrier's axes [1], shape (3, 3).
        place: Contact point [m], CARRIER axes, shape (3,).
        axes: Unit vectors along which the relative angular velocity may change, OWN
            axes, each of shape (3,): three, or two where it does not spin.
        turn_bias: Relative angular acceleration at zero rates of its quasi-velocities
            [rad/s^2], OWN axes; None: zero.
        masses: How many masses move with it.
        placement: Unit quaternion, the surface's to the carrier's axes [1], shape (4,);
            None: the same axes.
        inner: Of the bodies that roll on it or in it.
    """

    contact: Contact
    rotation: Float[Array, "3 3"]
    place: Float[Array, "3"]
    axes: tuple[Float[Array, "3"], ...]
    turn_bias: Float[Array, "3"] | None
    masses: int = eqx.field(static=True)
    placement: Float[Array, "4"] | None = None
    inner: tuple["Pairing", ...] = ()

    @property
    def first_of_inner(self) -> tuple[int, ...]:
        """Index of the first mass of each inner body, among those that move with it."""
        first = self.masses - sum(pairing.masses for pairing in self.inner)
        found: list[int] = []
        for pairing in self.inner:
            found.append(first)
            first += pairing.masses
        return tuple(found)


class Carried(eqx.Module):
    """Masses inside the rolling body at one instant, on BODY axes, from its origin.

    Attributes:
        mass: [kg], shape (k,).
        place: ``r`` [m], shape (3, k).
        velocity: ``r*`` relative to the body [m/s], shape (3, k).
        bias: ``r**`` at alpha'' = 0 [m/s^2], shape (3, k).
        partials: ``dr/dalpha^s`` [m per unit of alpha], each of shape (3, k); empty
            where the motion is prescribed.
        turnings: Rotations of the rigid bodies among them; none for point masses.
        driven: The part of ``r*`` that a prescribed motion gives [m/s], shape (3, k);
            None: there is none.
        pairing: The contact of a body that rolls on its carrier; None: it does not.

    Source: docs/theory.md, (4.2).
    """

    mass: Float[Array, " k"]
    place: Float[Array, "3 k"]
    velocity: Float[Array, "3 k"]
    bias: Float[Array, "3 k"]
    partials: tuple[Float[Array, "3 k"], ...]
    turnings: tuple[Turning, ...] = ()
    driven: Float[Array, "3 k"] | None = None
    pairing: Pairing | None = None


def without_columns(part: Carried) -> Carried:
    """A part of point masses or bodies whose coordinates are held."""
    still = [dataclasses.replace(x, partials=()) for x in part.turnings]
    return dataclasses.replace(part, partials=(), turnings=tuple(still))


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


def rolling_with(pairing: Pairing, parts: Sequence[Carried]) -> Carried:
    """Parts of a body that rolls on its carrier, as the carrier sees them.

    Args:
        pairing: How the body touches its carrier.
        parts: Of the body, on its OWN axes from its origin.

    Returns:
        All of them, on the CARRIER's axes from its origin. Their columns: one for each
        of the body's own axes, then those of the parts.

    Source: docs/theory.md, (4.6), (4.7), with u* as the unknown.
    """
    seen = [_seen(pairing, part) for part in parts]
    counts = [len(part.partials) for part in parts]
    own, R = len(pairing.axes), pairing.rotation
    before = [sum(counts[:i]) for i in range(len(counts))]
    after = [sum(counts[i + 1 :]) for i in range(len(counts))]

    def widened(i: int, partials: tuple[Array, ...]) -> list[Array]:
        """A part's columns among all: zero for the coordinates of others."""
        zero = jnp.zeros_like(partials[0])
        return [
            *partials[:own],
            *[zero] * before[i],
            *partials[own:],
            *[zero] * after[i],
        ]

    columns = [widened(i, part.partials) for i, part in enumerate(seen)]
    beside: Callable[[Sequence[Array]], Array] = lambda arrays: (
        arrays[0] if len(arrays) == 1 else jnp.concatenate(arrays, axis=-1)
    )
    turned: Callable[[Sequence[Array]], Array] = lambda x: matvec(
        R[:, :, None], beside(x)
    )
    turnings = [
        _turned(R, turning, widened(i, turning.partials))
        for i, part in enumerate(seen)
        for turning in part.turnings
    ]
    driven = None
    if any(part.driven is not None for part in seen):
        driven = turned(
            [
                jnp.zeros_like(part.place) if part.driven is None else part.driven
                for part in seen
            ]
        )
    return Carried(
        mass=beside([part.mass for part in seen]),
        place=pairing.place[:, None] + turned([part.place for part in seen]),
        velocity=turned([part.velocity for part in seen]),
        bias=turned([part.bias for part in seen]),
        partials=tuple(turned(list(column)) for column in zip(*columns, strict=True)),
        turnings=tuple(turnings),
        driven=driven,
        pairing=pairing,
    )


def _seen(pairing: Pairing, part: Carried) -> Carried:
    """A part of the body with its motion relative to the carrier, from the contact.

    Still on the body's OWN axes; (4.6): ``r* = u x s + r°`` and ``r** = r°° +
    u x (u x s + 2 r° - V)`` at u* = 0.
    """
    contact = pairing.contact
    u, s = contact.angular_velocity, part.place - contact.body_point[:, None]
    glide = cross(u, s)
    path = glide + 2.0 * part.velocity - contact.velocity[:, None]
    bias = part.bias + cross(u, path)
    if pairing.turn_bias is not None:
        bias = bias + cross(pairing.turn_bias, s)
    return Carried(
        mass=part.mass,
        place=s,
        velocity=glide + part.velocity,
        bias=bias,
        partials=(*(cross(e, s) for e in pairing.axes), *part.partials),
        turnings=tuple(_seen_turning(pairing, turning) for turning in part.turnings),
        driven=part.driven,
    )


def _seen_turning(pairing: Pairing, turning: Turning) -> Turning:
    """Rotation relative to the carrier, on the body's OWN axes; (4.7)."""
    u = pairing.contact.angular_velocity
    bias = turning.bias + cross(u, turning.velocity)
    if pairing.turn_bias is not None:
        bias = bias + pairing.turn_bias
    return Turning(
        rotation=turning.rotation,
        inertia=turning.inertia,
        velocity=u + turning.velocity,
        bias=bias,
        partials=(*pairing.axes, *turning.partials),
        driven=turning.driven,
    )


def _turned(
    R: Float[Array, "3 3"], turning: Turning, partials: Sequence[Array]
) -> Turning:
    """The same on axes to which R turns."""
    driven = turning.driven
    return Turning(
        rotation=matmul(R, turning.rotation),
        inertia=matmul(matmul(R, turning.inertia), R.T),
        velocity=matvec(R, turning.velocity),
        bias=matvec(R, turning.bias),
        partials=tuple(matvec(R, partial) for partial in partials),
        driven=None if driven is None else matvec(R, driven),
    )
