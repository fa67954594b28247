"""Voronets coordinates: both contact points by charts, and one angle between them.

State (q1, q2, qc1, qc2, theta; sigma, tau, n; alpha, alpha'): as many numbers as the
constrained motion has, in any regular charts; near the edge of a chart they end. The
mechanics is that of every other coordinate system: only the contact is described here.
"""

from typing import ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.local_geometry import LocalGeometry
from ..geometry.small_linear import (
    components,
    cross,
    dot,
    matmul,
    matvec,
    matvec_transposed,
    solve_2x2,
    solve_4x4,
)
from ..geometry.surfaces import AbstractSurface
from .base_motion import BaseKinematics
from .contact import Contact, within
from .coordinates import AbstractState, Accelerations, Pair, State

# Regularity of a chart (1 at its best) below which it has come to its edge: there the
# rates grow as 1/regularity, and 1e-3 leaves three quarters of the digits.
CHART_EDGE = 1e-3


class VoronetsState(AbstractState):
    """State of a rolling body in Voronets coordinates.

    Attributes:
        contact_on_body: ``(q1, q2)``, chart coordinates on the body, shape (2,).
        contact_on_base: ``(qc1, qc2)``, chart coordinates on the base, shape (2,).
        angle: ``theta``, in the tangent plane between e1 and e2c [rad].
        angular_velocity: ``(sigma, tau, n)``, absolute, on (e1, e2, e3) [rad/s], (3,).
        alpha: Coordinates of what the body supports, shape (n,).
        alpha_dot: Their rates, shape (n,).
        sign: ``s``: -1 where both e3 point out of the material; +1 where that of the
            base points into it, so that e3 = +e3c (the upper sign of [A]).

    Source: [A] section 1; docs/theory.md, (1.1) to (1.3), (3.1) to (3.3).
    """

    contact_on_body: Float[Array, "2"]
    contact_on_base: Float[Array, "2"]
    angle: Float[Array, ""]
    angular_velocity: Float[Array, "3"]
    alpha: Float[Array, " n"]
    alpha_dot: Float[Array, " n"]
    sign: int = eqx.field(static=True, default=-1)

    in_charts: ClassVar[bool] = True
    supported: ClassVar[tuple[()]] = ()  # bodies that roll on it have no such state

    def contact(self, pair: Pair) -> "ChartContact":
        """Its contact."""
        return chart_contact(pair.body, pair.base, self, pair.moving())

    def _rates(self, contact: Contact, known: Accelerations) -> Self:
        """Rates of a state that rolls; NaN at the edge of a chart.

        Source: docs/theory.md, (5.1), ``(sigma', tau', n') = w'|e - (w - w_1) x w``.
        """
        assert isinstance(contact, ChartContact)
        w_1 = contact.frame_turn
        on_frame = matvec_transposed(contact.shell.frame, known.angular)
        inside = contact.regularity > CHART_EDGE
        return type(self)(
            contact_on_body=jnp.where(inside, contact.body_rates, jnp.nan),
            contact_on_base=contact.base_rates,
            angle=contact.angle_rate,
            angular_velocity=on_frame + cross(w_1, self.angular_velocity),
            alpha=self.alpha_dot,
            alpha_dot=known.alpha,
            sign=self.sign,
        )


AnyState = State | VoronetsState


class ChartContact(Contact):
    """A contact in charts: what the paper's quantities are made of.

    Attributes:
        shell: Geometry of the body in its chart.
        ground: Geometry of the base in its chart; e3c into the material for s = +1.
        tangents: ``T_mb = e_m . e_bc`` [1], shape (2, 2).
        steps: ``(u1, u2)``, V on (e1, e2) [m/s], shape (2,).
        frame_turn: ``(sigma_1, tau_1, n_1)`` [rad/s]: MINUS the angular velocity of
            the frame relative to the body, on (e1, e2, e3), shape (3,).
        base_turn: ``(A, B, C)``, angular velocity of the base on (e1, e2, e3) [rad/s];
            None where it does not turn.
        angle_rate: ``theta'`` [rad/s].
        sign: ``s``.
        by_normal: Whether the body is parametrized by its normal: its chart may be
            an edge.
        is_wire: Whether the body is a wire, whose normal may stand still, too.
    """

    shell: LocalGeometry
    ground: LocalGeometry
    tangents: Float[Array, "2 2"]
    steps: Float[Array, "2"]
    frame_turn: Float[Array, "3"]
    base_turn: Float[Array, "3"] | None
    angle_rate: Float[Array, ""]
    sign: int = eqx.field(static=True)
    by_normal: bool = eqx.field(static=True)
    is_wire: bool = eqx.field(static=True)

    @property
    def regularity(self) -> Float[Array, ""]:
        """How far both charts are from their edges [1]: 1 at best, 0 at an edge."""
        return jnp.minimum(self.shell.regularity, self.ground.regularity)


def chart_contact(
    body: AbstractSurface,
    base: AbstractSurface,
    state: VoronetsState,
    moving: BaseKinematics | None = None,
) -> ChartContact:
    """Contact of a body that rolls without slipping, in Voronets coordinates.

    Args:
        body: Surface of the body, body axes.
        base: Surface of the base, base axes.
        state: Chart coordinates, angle and angular velocity.
        moving: Motion of the base; None: at rest.

    Source: docs/theory.md, (1.2), and (3.5) for U = 0.
    """
    s = state.sign
    q, q_c, theta = state.contact_on_body, state.contact_on_base, state.angle
    shell, ground, T, to_base = charts_of(body, base, q, q_c, theta, s)
    rotation = to_base
    if moving is not None and moving.rotation is not None:
        rotation = matmul(moving.rotation, to_base)

    relative, base_turn, on_frame = state.angular_velocity, None, None
    if moving is not None and moving.angular_velocity is not None:
        base_turn = matvec_transposed(to_base, moving.angular_velocity)
        on_frame = matvec_transposed(shell.frame, base_turn)  # (A, B, C)
        relative = state.angular_velocity - on_frame
    sigma, tau, n = components(relative)
    turning = jnp.stack([tau, -sigma])
    kind = body.is_by_normal, body.is_wire
    q_dot, qc_dot = _chart_rates(*kind, shell, ground, s, T, turning)
    steps = matvec(shell.lengths, q_dot)
    tilt_1, tilt_2 = components(matvec(shell.frame_rates, q_dot))
    gam_q = dot(shell.chart_spin, q_dot)
    return ChartContact(
        orientation=None,
        rotation=rotation,
        to_base=to_base,
        angular_velocity=matvec(shell.frame, state.angular_velocity),
        normal=shell.normal,
        body_point=shell.position,
        base_point=ground.position,
        velocity=matvec(shell.frame[:, :2], steps),
        body_rates=within(body.chart_extent(q), q_dot),
        base_rates=within(base.chart_extent(q_c), qc_dot),
        base=moving,
        base_angular_velocity=base_turn,
        slip=None,
        normal_rate=None,
        shell=shell,
        ground=ground,
        tangents=T,
        steps=steps,
        frame_turn=jnp.stack([-tilt_2, tilt_1, -gam_q]),
        base_turn=on_frame,
        angle_rate=s * dot(ground.chart_spin, qc_dot) - gam_q - n,
        sign=s,
        by_normal=kind[0],
        is_wire=kind[1],
    )


def charts_of(
    body: AbstractSurface,
    base: AbstractSurface,
    q: Float[Array, "2"],
    q_c: Float[Array, "2"],
    theta: Float[Array, ""],
    sign: int,
) -> tuple[LocalGeometry, LocalGeometry, Array, Array]:
    """Both geometries, ``T_mb = e_m . e_bc``, and the rotation from body to base axes.

    Args:
        body: Surface of the body.
        base: Surface of the base.
        q: Chart coordinates on the body.
        q_c: Chart coordinates on the base.
        theta: Angle between e1 and e2c [rad].
        sign: ``s``; for +1 the base's frame is turned over, e3c into its material.

    Source: docs/theory.md, (1.2), ``R_CB = Ec S_th E^T``.
    """
    shell, ground = body.chart_geometry(q), base.chart_geometry(q_c)
    if sign > 0:
        ground = ground.turned_over()
    sin, cos = jnp.sin(theta), jnp.cos(theta)
    T = jnp.stack([jnp.stack([sign * sin, cos]), jnp.stack([-sign * cos, sin])])
    e1c, e2c, e3c = components(ground.frame.T)
    rows = [T[0, 0] * e1c + T[0, 1] * e2c, T[1, 0] * e1c + T[1, 1] * e2c, sign * e3c]
    return shell, ground, T, matmul(jnp.stack(rows, axis=1), shell.frame.T)


def virtual_rates(
    contact: ChartContact, turn: Float[Array, "3"]
) -> tuple[Float[Array, "2"], Float[Array, "2"], Float[Array, ""]]:
    """``(dq, dqc, dtheta)`` of a virtual turn on (e1, e2, e3), the base held still.

    Args:
        contact: Contact in charts.
        turn: ``(dV^3, dV^4, dV^5)`` [rad].

    Source: [A] after (1.10); docs/theory.md, section 5: the columns B^i_k.
    """
    shell, ground, s = contact.shell, contact.ground, contact.sign
    sigma, tau, n = components(turn)
    turning = jnp.stack([tau, -sigma])
    kind = contact.by_normal, contact.is_wire
    dq, dqc = _chart_rates(*kind, shell, ground, s, contact.tangents, turning)
    return dq, dqc, s * dot(ground.chart_spin, dqc) - dot(shell.chart_spin, dq) - n


def _chart_rates(
    by_normal: bool,
    is_wire: bool,
    shell: LocalGeometry,
    ground: LocalGeometry,
    s: int,
    T: Float[Array, "2 2"],
    turning: Float[Array, "2"],
) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Rates of both charts: ``W q' - s T W_c qc' = r`` and ``L q' = T L_c qc'``.

    Only non-vanishing quantities are divided by: the turn of a surface given by its
    normal (whose edges have no length), the length of any other; of a wire either may
    vanish, and all four unknowns are solved for at once.
    """
    own, other = s * matmul(T, ground.frame_rates), matmul(T, ground.lengths)
    if is_wire:
        above = jnp.concatenate([shell.frame_rates, -own], axis=1)
        below = jnp.concatenate([shell.lengths, -other], axis=1)
        still = jnp.zeros_like(turning)
        system = jnp.concatenate([above, below])
        x = solve_4x4(system, jnp.concatenate([turning, still]))
        return x[:2], x[2:]
    if by_normal:
        kept, solved, still = shell.lengths, shell.frame_rates, own
        tilt = solve_2x2(solved, turning)
        columns = [solve_2x2(solved, still[:, a]) for a in range(2)]
        x = jnp.stack(columns, axis=1)  # W^-1 s T W_c
        qc_dot = solve_2x2(other - matmul(kept, x), matvec(kept, tilt))
        return tilt + matvec(x, qc_dot), qc_dot
    columns = [solve_2x2(shell.lengths, other[:, a]) for a in range(2)]
    x = jnp.stack(columns, axis=1)  # L^-1 T L_c
    qc_dot = solve_2x2(matmul(shell.frame_rates, x) - own, turning)
    return matvec(x, qc_dot), qc_dot
