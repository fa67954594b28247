"""Two surfaces that touch and roll: the pose as an output, and the contact's velocity.

The pose follows from the contact, never the other way round, so the body cannot leave
the surface. All vectors are on BODY axes unless said otherwise.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.local_geometry import LocalGeometry, from_normal
from ..geometry.rotations import multiply, rotation_matrix, shortest_turn
from ..geometry.small_linear import cross, dot, matmul, matvec, matvec_transposed
from ..geometry.surfaces import AbstractSurface
from .base_motion import BaseKinematics
from .rolling_rates import (
    along_base,
    from_pair,
    roll_by_normal,
    rolling_unknowns,
    tangents_in_body,
)


class Contact(eqx.Module):
    """The contact of a rolling body at one instant.

    Attributes:
        orientation: Quaternion, scalar first, body to fixed, of any length [1]; None
            where the coordinates hold none.
        rotation: ``R_NB``, body to fixed axes [1], shape (3, 3).
        to_base: ``R_CB``, body to base axes [1], shape (3, 3); the same as
            ``rotation`` where the base does not turn.
        angular_velocity: ``w``, absolute [rad/s], body axes, shape (3,).
        normal: Unit normal out of the body [1], body axes, shape (3,).
        body_point: ``rho``, contact point from the body origin [m], body axes, (3,).
        base_point: ``rho_c``, contact point [m], base axes, shape (3,).
        velocity: ``V``, of the contact point along the body's surface [m/s], body
            axes; along the base's, too, where nothing slips.
        body_rates: Rates of the body's contact coordinates [1/s]; shape (0,) where
            the body is parametrized by its normal.
        base_rates: Rates of the base's contact coordinates [1/s], shape (k,).
        base: Motion of the base at this instant; None: at rest.
        base_angular_velocity: ``w_c`` [rad/s], body axes; None: it does not turn.
        slip: ``U``, of the body's material point over the base [m/s], body axes; None:
            it rolls.
        normal_rate: Absolute rate of the normal [1/s], body axes; None where nothing
            asks for it.
        spare_spin: Of the state's angular velocity what is left out: turning about the
            normal, relative to the base [rad/s]; None: nothing is.
        spare_slip: Of its slip, the part along the normal [m/s]; None: it rolls.

    Source: docs/theory.md, (1.2), (1.3), (3.4), (3.5).
    """

    orientation: Float[Array, "4"] | None
    rotation: Float[Array, "3 3"]
    to_base: Float[Array, "3 3"]
    angular_velocity: Float[Array, "3"]
    normal: Float[Array, "3"]
    body_point: Float[Array, "3"]
    base_point: Float[Array, "3"]
    velocity: Float[Array, "3"]
    body_rates: Float[Array, " m"]
    base_rates: Float[Array, " k"]
    base: BaseKinematics | None
    base_angular_velocity: Float[Array, "3"] | None
    slip: Float[Array, "3"] | None
    normal_rate: Float[Array, "3"] | None
    spare_spin: Float[Array, ""] | None = eqx.field(default=None, kw_only=True)
    spare_slip: Float[Array, ""] | None = eqx.field(default=None, kw_only=True)

    @property
    def position(self) -> Float[Array, "3"]:
        """Body origin O [m], fixed axes (docs/theory.md, (1.3))."""
        return self.place - matvec(self.rotation, self.body_point)

    @property
    def place(self) -> Float[Array, "3"]:
        """Contact point [m], fixed axes."""
        return (
            self.base_point if self.base is None else self.base.placed(self.base_point)
        )

    @property
    def base_velocity(self) -> Float[Array, "3"] | None:
        """``j``, of the base's material point at the contact [m/s], body axes."""
        return self._of_base(BaseKinematics.velocity_at)

    @property
    def point_velocity(self) -> Float[Array, "3"] | None:
        """``j + U``, of the body's material point at the contact [m/s], body axes."""
        j = self.base_velocity
        if self.slip is None:
            return j
        return self.slip if j is None else j + self.slip

    @property
    def base_acceleration(self) -> Float[Array, "3"] | None:
        """``a_b``, of the base's material point [m/s^2], body axes, (1.6)."""
        return self._of_base(BaseKinematics.acceleration_at)

    def _of_base(
        self, quantity: Callable[[BaseKinematics, Array], Array | None]
    ) -> Float[Array, "3"] | None:
        moving = None if self.base is None else quantity(self.base, self.base_point)
        return None if moving is None else matvec_transposed(self.to_base, moving)

    @property
    def relative_angular_velocity(self) -> Float[Array, "3"]:
        """``Om = w - w_c`` [rad/s], body axes."""
        if self.base_angular_velocity is None:
            return self.angular_velocity
        return self.angular_velocity - self.base_angular_velocity

    @property
    def body_point_acceleration(self) -> Float[Array, "3"]:
        """``a_P``, of the body's material point at the contact [m/s^2], body axes.

        Where it slips, without the part along the surface that the forces determine.

        Source: docs/theory.md, (4.1), ``a_P = a_b + V x (w - w_c)``; where it slips
        (7.1), ``a_b + w_c x V_c - w x V_b + dU/dt``.
        """
        relative = cross(self.velocity, self.relative_angular_velocity)
        if self.slip is not None:
            assert self.normal_rate is not None
            relative = relative - self.normal * dot(self.slip, self.normal_rate)
            if self.base_angular_velocity is not None:
                relative = relative + cross(self.base_angular_velocity, self.slip)
        pushed = self.base_acceleration
        return relative if pushed is None else pushed + relative


def rolling_contact(
    body: AbstractSurface,
    base: AbstractSurface,
    orientation: Float[Array, "4"],
    angular_velocity: Float[Array, "3"],
    on_base: Float[Array, " k"],
    on_body: Float[Array, " m"],
    moving: BaseKinematics | None = None,
    slip: Float[Array, "3"] | None = None,
    without_spin: bool = False,
) -> Contact:
    """Contact of a body that rolls, or slips.

    The normals obey ``n_body = -n_base``, so with ``r = n_body x Om`` the turns of both
    add up, ``K_b x_b + K_c x_c = r`` (K = -W), and the travels agree,
    ``L_b x_b + U = L_c x_c``: the system (3.5) for s = -1. Only non-vanishing
    quantities are divided by: the turn of a body parametrized by its normal, the length
    of any other; of a wire either may vanish, and all four unknowns are solved for at
    once.

    Args:
        body: Surface of the body, body axes.
        base: Surface of the base, base axes.
        orientation: Quaternion, scalar first, body to fixed, any length [1].
        angular_velocity: Absolute, BODY axes [rad/s].
        on_base: Contact coordinates on the base.
        on_body: Contact coordinates on the body; shape (0,) if the normal
            is its parameter.
        moving: Motion of the base; None: at rest.
        slip: ``U``, FIXED axes [m/s]; what of it leaves the surface is left out. None:
            it rolls.
        without_spin: Whether turning about the normal is left out (rubber).
    """
    ground = base.geometry(on_base)
    rotation = rotation_matrix(orientation)
    to_base = body_to_base(rotation, moving)
    normal = -matvec_transposed(to_base, ground.frame[:, 2])
    shell = None
    if body.normal_map(base.is_flat) is None:
        shell = body.geometry(on_body)
        orientation, rotation = _aligned(orientation, rotation, shell, normal)
        to_base = body_to_base(rotation, moving)
        normal = shell.frame[:, 2]
    relative, base_turn = relative_spin(angular_velocity, to_base, moving)
    spare_spin = spare_slip = None
    if without_spin:
        spin, spare_spin = _along(normal, relative)
        relative, angular_velocity = relative - spin, angular_velocity - spin
    if slip is not None:
        slip = matvec_transposed(rotation, slip)
        leaving, spare_slip = _along(normal, slip)
        slip = slip - leaving
    turning = cross(normal, relative)
    moved = rolled_over(body, base, shell, ground, to_base, normal, turning, slip)
    body_rates = on_body
    if shell is not None:
        assert moved.x_body is not None
        body_rates = rates_on(body, on_body, shell, moved.x_body)
    normal_rate = None
    if slip is not None or without_spin:
        normal_rate = _normal_rate(ground, to_base, normal, base_turn, moved.x_base)
    return Contact(
        orientation=orientation,
        rotation=rotation,
        to_base=to_base,
        angular_velocity=angular_velocity,
        normal=normal,
        body_point=moved.body_point,
        base_point=ground.position,
        velocity=moved.velocity,
        body_rates=body_rates,
        base_rates=rates_on(base, on_base, ground, moved.x_base),
        base=moving,
        base_angular_velocity=base_turn,
        slip=slip,
        normal_rate=normal_rate,
        spare_spin=spare_spin,
        spare_slip=spare_slip,
    )


class RolledOver(NamedTuple):
    """How the contact of two surfaces moves, on BODY axes.

    Attributes:
        body_point: Contact point from the body origin [m], shape (3,).
        velocity: Of the contact point along the body [m/s], shape (3,).
        x_body: Local rates on the body [1/s], shape (2,); None where the normal
            determines the point.
        x_base: On the base [1/s], shape (2,).
    """

    body_point: Float[Array, "3"]
    velocity: Float[Array, "3"]
    x_body: Float[Array, "2"] | None
    x_base: Float[Array, "2"]


def rolled_over(
    body: AbstractSurface,
    base: AbstractSurface,
    shell: LocalGeometry | None,
    ground: LocalGeometry,
    to_base: Float[Array, "3 3"],
    normal: Float[Array, "3"],
    turning: Float[Array, "3"],
    slip: Float[Array, "3"] | None = None,
) -> RolledOver:
    """How a contact moves, by what cannot vanish of its two surfaces.

    Args:
        body: Surface of the body.
        base: Surface of the base.
        shell: The body's geometry at the contact; None where the normal determines
            the point.
        ground: The base's geometry at the contact.
        to_base: Body to base axes [1].
        normal: Unit normal out of the body, body axes [1].
        turning: ``N x Om``, body axes [rad/s].
        slip: ``U``, body axes [m/s]; None: it rolls.

    Source: docs/theory.md, (3.4), (3.5).
    """
    if shell is not None:
        roll = rolling_unknowns(body, base)
        found = roll(shell, ground, to_base, turning, slip)
        return RolledOver(shell.position, *found)
    point = body.normal_map(base.is_flat)
    assert point is not None
    if base.is_flat:
        body_point, velocity = jax.jvp(point, (normal,), (turning,))
        x_base = matvec(to_base[:2], along_base(slip, velocity))
        return RolledOver(body_point, velocity, None, x_base)
    pair = tangents_in_body(ground, to_base)
    shell = from_normal(point, normal, pair)
    velocity, x_base = roll_by_normal(shell, ground, pair, turning, slip)
    return RolledOver(shell.position, velocity, None, x_base)


def _along(
    normal: Float[Array, "3"], vector: Float[Array, "3"]
) -> tuple[Float[Array, "3"], Float[Array, ""]]:
    """Part of a vector along a unit vector, and its size."""
    size = dot(normal, vector)
    return normal * size, size


def rates_on(
    surface: AbstractSurface,
    u: Float[Array, " k"],
    geometry: LocalGeometry,
    x: Float[Array, "2"],
) -> Float[Array, " k"]:
    """Rates of coordinates, within the surface."""
    return within(surface.extent(u), surface.coordinate_rates(u, geometry, x))


def within(extent: Float[Array, ""] | None, rates: Float[Array, " k"]) -> Array:
    """Rates of coordinates; NaN beyond the end of a surface, where no step may end."""
    return rates if extent is None else jnp.where(extent > 0.0, rates, jnp.nan)


def flight(
    orientation: Float[Array, "4"],
    angular_velocity: Float[Array, "3"],
    position: Float[Array, "3"],
    velocity: Float[Array, "3"],
) -> Contact:
    """What stands for a contact in flight: its point is the body origin.

    Args:
        orientation: Quaternion, scalar first, body to fixed, any length [1].
        angular_velocity: Absolute, BODY axes [rad/s].
        position: Body origin, FIXED axes [m].
        velocity: Of the body origin, FIXED axes [m/s].
    """
    rotation, zero = rotation_matrix(orientation), jnp.zeros_like(position)
    return Contact(
        orientation=orientation,
        rotation=rotation,
        to_base=rotation,
        angular_velocity=angular_velocity,
        normal=zero,
        body_point=zero,
        base_point=position,
        velocity=zero,
        body_rates=zero[:0],
        base_rates=zero[:0],
        base=None,
        base_angular_velocity=None,
        slip=matvec_transposed(rotation, velocity),
        normal_rate=zero,
    )


def _normal_rate(
    ground: LocalGeometry,
    to_base: Float[Array, "3 3"],
    normal: Float[Array, "3"],
    base_turn: Float[Array, "3"] | None,
    x_base: Float[Array, "2"],
) -> Float[Array, "3"]:
    """Absolute rate of the normal, on body axes: the base's, the other way round."""
    along = matvec(ground.frame_rates, x_base)
    rate = from_pair(tangents_in_body(ground, to_base), along)
    return rate if base_turn is None else rate + cross(base_turn, normal)


def body_to_base(
    rotation: Float[Array, "3 3"], moving: BaseKinematics | None
) -> Float[Array, "3 3"]:
    """Body to base axes, ``A_c^T R``."""
    if moving is None or moving.rotation is None:
        return rotation
    return matmul(moving.rotation.T, rotation)


def relative_spin(
    angular_velocity: Float[Array, "3"],
    to_base: Float[Array, "3 3"],
    moving: BaseKinematics | None,
) -> tuple[Float[Array, "3"], Float[Array, "3"] | None]:
    """``Om = w - w_c`` and ``w_c`` [rad/s], body axes; None: the base does not turn."""
    if moving is None or moving.angular_velocity is None:
        return angular_velocity, None
    base_turn = matvec_transposed(to_base, moving.angular_velocity)
    return angular_velocity - base_turn, base_turn


def _aligned(
    orientation: Float[Array, "4"],
    rotation: Float[Array, "3 3"],
    shell: LocalGeometry,
    normal: Float[Array, "3"],
) -> tuple[Float[Array, "4"], Float[Array, "3 3"]]:
    """Turn the body by the smallest rotation that brings its normal onto the base's.

    Integration error would otherwise open a gap: an error of 2e-8 grew to 3e-5 in 1e5
    steps without this, and stayed at 1e-17 with it. On the exact motion it does
    nothing, so order and derivatives are untouched. NaN where the normals point the
    same way: one of a chart has turned over, behind its pole.
    """
    turn = shortest_turn(shell.frame[:, 2], normal)
    turn = jnp.where(turn[0] > 1.0, turn, jnp.nan)
    return multiply(orientation, turn), matmul(rotation, rotation_matrix(turn))
