"""The paper's own quantities at a contact, by their names.

Everything follows from one :class:`ChartContact`: relative curvature coefficients,
constraint coefficients, velocities of the base on the moving frame, the frame's own
rotation, and the symbols Gamma and epsilon of the Euler-Lagrange equations. In general
charts (docs/theory.md, section 2); in principal ones they are the formulas of [A] term
by term.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry.local_geometry import LocalGeometry
from ..geometry.small_linear import components, dot, matmul, matvec, solve_2x2
from ..kinematics.voronets import ChartContact, virtual_rates
from ..validation.checks import refuse


class PaperQuantities(eqx.Module):
    """What [A] calls by name at one contact; index k of [A] is index k - 1 here.

    Attributes:
        a: First form of the body [m^2 per unit^2], shape (2, 2).
        b: Second form of the body [m per unit^2], shape (2, 2).
        a_c: First form of the base, shape (2, 2) [m^2 per unit^2].
        b_c: Second form of the base, shape (2, 2) [m per unit^2].
        f: ``(f_1, f_2, f_3)``, base velocity at M [m/s], BASE axes ([A] (1.3)).
        base_velocity: ``(b_1, b_2, b_3)``, the same on (e1c, e2c, e3c) [m/s].
        j: ``(j_1, j_2, j_3)``, the same on (e1, e2, e3) [m/s].
        A: Angular velocity of the base along e1 [rad/s].
        B: The same along e2 [rad/s].
        C: The same along e3 [rad/s].
        Delta: ``Delta_ab``, relative curvature [1/m], shape (2, 2).
        Delta_1: [1/m].
        Delta_2: [1/m].
        R: ``det Delta`` [1/m^2].
        c: ``c_ab`` [1/m], shape (2, 2) ([A] (1.13)).
        d: ``c_11 c_22 - c_12 c_21 = s R`` [1/m^2].
        p: ``(p_1, p_2, p_3)`` of sigma_1 = p_1 sigma + p_2 tau + p_3, shape (3,) [1];
            the last [rad/s].
        q: Likewise of tau_1, shape (3,) [1].
        r: Likewise of n_1, shape (3,) [1].
        w_1: ``(sigma_1, tau_1, n_1)``, shape (3,) [rad/s].
        kappa: ``kappa^s_a = Delta_as / R``, index [s, a], shape (2, 2) [m].

    At a sharp edge Delta, Delta_1, Delta_2, R, c and d are not finite; p, q, r, w_1,
    kappa, Gamma and epsilon are.

    Source: [A] (1.2)-(1.13), (2.1); docs/theory.md, sections 2 and 3.
    """

    a: Float[Array, "2 2"]
    b: Float[Array, "2 2"]
    a_c: Float[Array, "2 2"]
    b_c: Float[Array, "2 2"]
    f: Float[Array, "3"]
    base_velocity: Float[Array, "3"]
    j: Float[Array, "3"]
    A: Float[Array, ""]
    B: Float[Array, ""]
    C: Float[Array, ""]
    Delta: Float[Array, "2 2"]
    Delta_1: Float[Array, ""]
    Delta_2: Float[Array, ""]
    R: Float[Array, ""]
    c: Float[Array, "2 2"]
    d: Float[Array, ""]
    p: Float[Array, "3"]
    q: Float[Array, "3"]
    r: Float[Array, "3"]
    w_1: Float[Array, "3"]
    kappa: Float[Array, "2 2"]

    @property
    def Gamma(self) -> Float[Array, "5 5 5"]:
        """``Gamma^r_tk``, index [r-1, t-1, k-1], shape (5, 5, 5).

        Units [m] for r = 1, 2 and [1] for r = 3, 4, 5; antisymmetric in t and k.
        Source: [A] (2.1), (2.2), corrected (docs/errata.md): the last has r = 5.
        """
        p_1, p_2, _ = components(self.p)
        q_1, q_2, _ = components(self.q)
        r_1, r_2, _ = components(self.r)
        upper = {
            (1, 3, 5): self.kappa[0, 0],
            (1, 4, 5): self.kappa[0, 1],
            (2, 3, 5): self.kappa[1, 0],
            (2, 4, 5): self.kappa[1, 1],
            (3, 3, 5): q_1,
            (3, 4, 5): q_2 - 1.0,
            (3, 3, 4): -r_1,
            (4, 3, 5): 1.0 - p_1,
            (4, 4, 5): -p_2,
            (4, 3, 4): -r_2,
            (5, 3, 4): p_1 + q_2 - 1.0,
        }
        lower = {(r, k, t): -value for (r, t, k), value in upper.items()}
        return _filled((5, 5, 5), upper | lower)

    @property
    def epsilon(self) -> Float[Array, "5 5"]:
        """``epsilon^r_k``, index [r-1, k-1], shape (5, 5).

        Units [m/s] for r = 1, 2 and [rad/s] for r = 3, 4, 5; zero where the base does
        not turn. Source: [A] (2.1), (2.2), corrected (docs/errata.md): the last have
        r = 5.
        """
        p_3, q_3, r_3 = self.p[2], self.q[2], self.r[2]
        turning = jnp.stack([self.A, self.B])
        values = {
            (1, 3): self.kappa[0, 0] * self.C,
            (1, 4): self.kappa[0, 1] * self.C,
            (1, 5): -dot(self.kappa[0], turning),
            (2, 3): self.kappa[1, 0] * self.C,
            (2, 4): self.kappa[1, 1] * self.C,
            (2, 5): -dot(self.kappa[1], turning),
            (3, 4): -r_3,
            (3, 5): q_3,
            (4, 3): r_3,
            (4, 5): -p_3,
            (5, 3): -q_3,
            (5, 4): p_3,
        }
        return _filled((5, 5), values)


def _filled(
    shape: tuple[int, ...], values: dict[tuple[int, ...], Float[Array, ""]]
) -> Array:
    """An array of few entries, counted from 1. Stacked: a scatter is a slow loop."""
    zero = jnp.zeros_like(next(iter(values.values())))
    entries = [
        values.get(tuple(i + 1 for i in index), zero) for index in np.ndindex(shape)
    ]
    return jnp.stack(entries).reshape(shape)


def paper_quantities(contact: ChartContact, principal: bool = False) -> PaperQuantities:
    """The quantities of [A] at a contact in charts.

    Args:
        contact: From ``contact_of(scene, t, state)`` with a Voronets state.
        principal: Whether the charts must be principal, as [A] assumes: a chart whose
            lines are not lines of curvature is then refused.

    Raises:
        FieldError: ``principal``, and a12 or b12 of a chart is not zero.

    Source: docs/theory.md, (2.2), (3.1) to (3.3).
    """
    shell, ground, T, s = contact.shell, contact.ground, contact.tangents, contact.sign
    if principal:
        shell = _refuse_askew("body", shell)
        ground = _refuse_askew("base", ground)
    sin, cos = T[1, 1], T[0, 1]
    Bf, Bf_c = shell.shape_operator, ground.shape_operator
    Delta = Bf - s * matmul(matmul(T, Bf_c), T.T)
    (D11, D12), (D21, D22) = (components(row) for row in components(Delta))
    R = D11 * D22 - D12 * D21
    # gam.q' = g.u and gam_c.qc' = g_c.u, u = V on (e1, e2)
    g = solve_2x2(shell.lengths.T, shell.chart_spin)
    g_c = matvec(T, solve_2x2(ground.lengths.T, ground.chart_spin))
    away = s * g_c - g  # theta' = C - n + Delta_1 u1 - Delta_2 u2
    zero = jnp.zeros_like(R)
    A, B, C = (
        (zero,) * 3 if contact.base_turn is None else components(contact.base_turn)
    )
    # rates of the body's chart for a unit of sigma - A, and of tau - B
    units = jnp.eye(3, dtype=R.dtype)[:2]
    q_of = jnp.stack([virtual_rates(contact, unit)[0] for unit in units], axis=1)
    # u1 = (D12, D22).(sigma - A, tau - B)/R, u2 = -(D11, D12).(sigma - A, tau - B)/R
    u_of, tilts = matmul(shell.lengths, q_of), matmul(shell.frame_rates, q_of)
    turning = jnp.stack([A, B])

    def coefficients(row: Float[Array, "2"]) -> Float[Array, "3"]:
        return jnp.concatenate([row, -dot(row, turning)[None]])

    f = None if contact.base is None else contact.base.velocity_at(contact.base_point)
    f = jnp.zeros_like(contact.normal) if f is None else f
    b = matvec(ground.frame.T, f)
    j = jnp.concatenate([matvec(T, b[:2]), s * b[2:]])
    return PaperQuantities(
        a=shell.first_form,
        b=shell.second_form,
        a_c=ground.first_form,
        b_c=ground.second_form,
        f=f,
        base_velocity=b,
        j=j,
        A=A,
        B=B,
        C=C,
        Delta=Delta,
        Delta_1=away[0],
        Delta_2=-away[1],
        R=R,
        c=jnp.stack(
            [
                jnp.stack([s * (sin * D11 - cos * D12), sin * D12 + cos * D11]),
                jnp.stack([s * (sin * D12 - cos * D22), sin * D22 + cos * D12]),
            ]
        ),
        d=s * R,
        p=coefficients(-tilts[1]),
        q=coefficients(tilts[0]),
        r=coefficients(-matvec(q_of.T, shell.chart_spin)),
        w_1=contact.frame_turn,
        kappa=jnp.stack([-u_of[1], u_of[0]]).T,
    )


def _refuse_askew(owner: str, geometry: LocalGeometry) -> LocalGeometry:
    """Refuse a chart whose lines are not lines of curvature at this point."""
    (a11, a12), (_, a22) = (components(row) for row in components(geometry.first_form))
    (b11, b12), (_, b22) = (components(row) for row in components(geometry.second_form))
    loose = 1e-8 if a11.dtype == jnp.float64 else 1e-3
    askew = jnp.abs(a12) > loose * jnp.sqrt(a11 * a22)
    bent = jnp.abs(b11 * a22 / a11) + jnp.abs(b22)
    askew |= jnp.abs(b12) > loose * bent * jnp.sqrt(a11 / a22)
    checked = refuse(
        geometry.lengths,
        askew,
        f"{owner}.surface",
        "has a chart whose lines are not lines of curvature at the contact (a12 or b12 "
        "is not zero)",
        "use principal=False (general charts), or give the surface by a chart of its "
        "lines of curvature",
    )
    return eqx.tree_at(lambda g: g.lengths, geometry, checked)
