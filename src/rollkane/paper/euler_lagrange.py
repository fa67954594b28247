"""The paper's formulation: Euler-Lagrange equations in quasi-velocities.

Three forms of the equations of the supporting body, [A] (2.3), (2.5) and (2.9), with
those of what it carries, [A] (2.4) or (2.10). Each is written as its residual, as it
stands in the paper (corrected as docs/errata.md says); being linear in the
accelerations, it is solved by linearising it once. Vectors are on body axes where
nothing else is said.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene
from ..geometry.small_linear import (
    components,
    cross,
    dot,
    matvec,
    matvec_transposed,
    solve_spd,
)
from ..kinematics.coordinates import State
from ..kinematics.voronets import AnyState, ChartContact, VoronetsState, virtual_rates
from ..validation.checks import FieldError
from ..validation.user_functions import as_time
from .conversions import in_charts
from .quasi_energy import (
    Configuration,
    Inertia,
    angular_momentum_about_contact,
    applied,
    inertia_of,
    kinetic_energy_with_slip,
    place_of,
)
from .quasi_velocities import paper_quantities

EQUATIONS = ("2.3", "2.5", "2.9")
# of the accelerations (sigma', tau', n', alpha''), or of a part of them
_Residual = Callable[[Float[Array, " m"]], Float[Array, " k"]]


def euler_lagrange_derivative(
    scene: Scene, t: Float[Array, ""], state: AnyState, equations: str = "2.5"
) -> AnyState:
    """Rates of the state of a rolling body, by the Euler-Lagrange equations.

    The twin of :func:`rollkane.rolling_derivative`, with equal results.

    Args:
        scene: What rolls on what, carrying what, under which loads.
        t: Time [s].
        state: In Voronets coordinates; a pole-free state is seen in the charts of its
            surfaces, and its rates are NaN at their poles.
        equations: ``"2.3"`` (with [A] (2.4)), ``"2.5"`` or ``"2.9"`` (with
            [A] (2.10)).

    Returns:
        Rates of every number of the state [its unit / s], as a state.

    Raises:
        FieldError: other equations.

    Source: [A] (2.3)-(2.5), (2.9), (2.10); docs/theory.md, section 5.
    """
    if equations not in EQUATIONS:
        raise FieldError(
            "euler_lagrange_derivative.equations",
            equations,
            "is not known",
            f"use one of {EQUATIONS}",
        )
    t = as_time(t)
    own = in_charts(scene, t, state) if isinstance(state, State) else state
    contact = contact_of(scene, t, own)
    assert isinstance(contact, ChartContact)
    residual = residual_of(scene, t, own, contact, equations)
    origin = jnp.zeros(3 + own.alpha.size, state.angular_velocity.dtype)
    solved = _solved(residual, origin)
    # w' on body axes: (sigma', tau', n') = w'|e + w_1 x w, (5.1)
    on_frame = solved[:3] - cross(contact.frame_turn, own.angular_velocity)
    w_dot = matvec(contact.shell.frame, on_frame)
    if own is not state:
        contact = contact_of(scene, t, state)
    return state.rates(contact, w_dot, solved[3:])


def _solved(residual: _Residual, origin: Float[Array, " m"]) -> Float[Array, " m"]:
    """Where an affine residual with a symmetric positive definite matrix vanishes."""
    constant, linear = cast(
        tuple[Array, Callable[[Array], Array]], jax.linearize(residual, origin)
    )
    units = jnp.eye(origin.size, dtype=origin.dtype)
    columns = [components(linear(unit)) for unit in units]
    rows = [[columns[j][i] for j in range(i + 1)] for i in range(origin.size)]
    return jnp.stack(solve_spd(rows, components(-constant)))


class _Motion(NamedTuple):
    """A state, and how it moves but for its accelerations."""

    x: Configuration
    x_dot: Configuration
    v: Float[Array, "3"]  # (sigma, tau, n)
    alpha_dot: Float[Array, " n"]

    def along(
        self, function: Callable[..., Any], acceleration: Float[Array, " m"]
    ) -> Any:
        """d/dt of ``function(x, v, alpha')`` along the motion."""
        tangents = self.x_dot, acceleration[:3], acceleration[3:]
        return jax.jvp(function, (self.x, self.v, self.alpha_dot), tangents)[1]


def residual_of(
    scene: Scene,
    t: Float[Array, ""],
    state: VoronetsState,
    contact: ChartContact,
    equations: str,
) -> _Residual:
    """Left less right sides of the equations, as a function of the accelerations.

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: In Voronets coordinates.
        contact: Its contact.
        equations: ``"2.3"``, ``"2.5"`` or ``"2.9"``.

    Returns:
        A function of ``(sigma', tau', n', alpha'')`` [rad/s^2; 1/s^2] -> 3 + n
        residuals [N m; J per unit of alpha].
    """
    motion = _Motion(
        Configuration(
            state.contact_on_body, state.contact_on_base, state.angle, state.alpha, t
        ),
        Configuration(
            contact.body_rates,
            contact.base_rates,
            contact.angle_rate,
            state.alpha_dot,
            jnp.ones_like(t),
        ),
        state.angular_velocity,
        state.alpha_dot,
    )
    moment, Q = applied(scene, t, state, contact)
    if equations == "2.3":
        return _lagrangian(scene, state, contact, motion, moment, Q)
    own = _carried_equations(scene, state, motion, Q)
    by_body = _vector_equation if equations == "2.9" else _scalar_equations
    body = by_body(scene, state, contact, motion, moment)
    if not state.alpha.size:
        return body

    def residual(acceleration: Array) -> Array:
        return jnp.concatenate([body(acceleration), own(acceleration)])

    return residual


def _lagrangian(
    scene: Scene,
    state: VoronetsState,
    contact: ChartContact,
    motion: _Motion,
    moment: Float[Array, "3"],
    Q: Float[Array, " n"],
) -> _Residual:
    """[A] (2.3) and (2.4), every term by automatic differentiation of T'."""
    sign = state.sign

    def T(x: Configuration, U: Array, alpha_dot: Array) -> Array:
        return kinetic_energy_with_slip(scene, x, U, alpha_dot, sign)

    def Theta(x: Configuration, v: Array, alpha_dot: Array) -> Array:
        return T(x, jnp.concatenate([jnp.zeros(2, v.dtype), v]), alpha_dot)

    x, v, alpha_dot = motion.x, motion.v, motion.alpha_dot
    U = jnp.concatenate([jnp.zeros(2, v.dtype), v])
    p = cast(Array, jax.grad(T, argnums=1)(x, U, alpha_dot))  # dT'/dU^r
    slope = cast(Configuration, jax.grad(Theta)(x, v, alpha_dot))  # dTheta'/dq^i
    paper = paper_quantities(contact)
    Gamma, epsilon = paper.Gamma, paper.epsilon
    rows: list[Array] = []
    for k in (2, 3, 4):
        bent = sum(
            p[r] * (sum(Gamma[r, u, k] * U[u] for u in (2, 3, 4)) + epsilon[r, k])
            for r in range(5)
        )
        unit = jnp.eye(3, dtype=v.dtype)[k - 2]
        q_k, qc_k, theta_k = virtual_rates(contact, unit)
        along = dot(slope.q, q_k) + dot(slope.q_c, qc_k) + slope.theta * theta_k
        rows.append(bent - along)
    forced = jnp.stack(rows) - moment

    def residual(acceleration: Array) -> Array:
        gradients = cast(Callable[..., Any], jax.grad(Theta, argnums=(1, 2)))
        K_dot, p_dot = motion.along(gradients, acceleration)
        return jnp.concatenate([K_dot + forced, p_dot - slope.alpha - Q])

    return residual


def _scalar_equations(
    scene: Scene,
    state: VoronetsState,
    contact: ChartContact,
    motion: _Motion,
    moment: Float[Array, "3"],
) -> _Residual:
    """[A] (2.5): the three equations written out on (e1, e2, e3)."""

    def K(x: Configuration, v: Array, alpha_dot: Array) -> Array:
        place = place_of(scene, x, state.sign)
        body = inertia_of(scene, x, alpha_dot)
        momentum = angular_momentum_about_contact(place, body, v)
        return matvec_transposed(place.frame, momentum)

    place = place_of(scene, motion.x, state.sign)
    body = inertia_of(scene, motion.x, motion.alpha_dot)

    def on_e(vector: Float[Array, "3"]) -> list[Float[Array, ""]]:
        return components(matvec_transposed(place.frame, vector))

    (xi, eta, eps), (Q1, Q2, Q3) = on_e(place.rho), on_e(body.Q_r)
    (xi_C, eta_C, eps_C), (j1, j2, j3) = on_e(body.r_C), on_e(place.j)
    M = body.mass
    sigma, tau, n = components(motion.v)
    sigma_1, tau_1, n_1 = components(contact.frame_turn)
    u1, u2 = components(contact.steps)  # sqrt(a11) q1', sqrt(a22) q2'
    K1, K2, K3 = components(K(motion.x, motion.v, motion.alpha_dot))
    lever = M * ((xi - xi_C) * tau - (eta - eta_C) * sigma)

    def spun(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
        return n * a - sigma * c, sigma * b - tau * a, tau * c - n * b

    w13, w21, w32 = spun(xi, eta, eps)  # n xi - sigma eps, sigma eta - tau xi, ...
    c13, c21, c32 = spun(xi_C, eta_C, eps_C)
    rows = [
        (tau - tau_1) * K3
        - (n - n_1) * K2
        + lever * u2
        + (M * j3 + Q3) * u2
        - (Q2 * j3 - Q3 * j2)
        + M * (w13 * j3 - w21 * j2)
        - M * (c13 * j3 - c21 * j2),
        (n - n_1) * K1
        - (sigma - sigma_1) * K3
        - lever * u1
        - (M * j3 + Q3) * u1
        - (Q3 * j1 - Q1 * j3)
        + M * (w21 * j1 - w32 * j3)
        - M * (c21 * j1 - c32 * j3),
        (sigma - sigma_1) * K2
        - (tau - tau_1) * K1
        + M * (eps - eps_C) * (u1 * sigma + u2 * tau)
        - M * ((xi - xi_C) * u1 + (eta - eta_C) * u2) * n
        - (M * j1 + Q1) * u2
        + (M * j2 + Q2) * u1
        - (Q1 * j2 - Q2 * j1)
        + M * (w32 * j2 - w13 * j1)
        - M * (c32 * j2 - c13 * j1),
    ]
    forced = jnp.stack(rows) - moment

    def residual(acceleration: Array) -> Array:
        return motion.along(K, acceleration) + forced

    return residual


def _vector_equation(
    scene: Scene,
    state: VoronetsState,
    contact: ChartContact,
    motion: _Motion,
    moment: Float[Array, "3"],
) -> _Residual:
    """[A] (2.9): the same as one vector equation, d/dt in fixed axes."""

    def K(x: Configuration, v: Array, alpha_dot: Array) -> Array:
        place = place_of(scene, x, state.sign)
        body = inertia_of(scene, x, alpha_dot)
        return angular_momentum_about_contact(place, body, v)

    place = place_of(scene, motion.x, state.sign)
    body = inertia_of(scene, motion.x, motion.alpha_dot)
    rho, j, M, r_C, Q_r = place.rho, place.j, body.mass, body.r_C, body.Q_r
    w = matvec(place.frame, motion.v)
    rho_star = contact.velocity
    forced = (
        cross(w, K(motion.x, motion.v, motion.alpha_dot))
        + cross(rho_star, M * (cross(rho - r_C, w) + j) + Q_r)
        - cross(Q_r, j)
        + M * cross(cross(w, rho - r_C), j)
    )
    forced = matvec_transposed(place.frame, forced) - moment

    def residual(acceleration: Array) -> Array:
        change = motion.along(K, acceleration)
        return matvec_transposed(place.frame, change) + forced

    return residual


def _carried_equations(
    scene: Scene, state: VoronetsState, motion: _Motion, Q: Float[Array, " n"]
) -> _Residual:
    """[A] (2.10), for each coordinate of what is carried."""
    x, v, alpha_dot = motion.x, motion.v, motion.alpha_dot
    place = place_of(scene, x, state.sign)
    w = matvec(place.frame, v)

    def relative(x: Configuration, v: Array, alpha_dot: Array) -> tuple[Array, Array]:
        """dT_r/dalpha' and dK_r/dalpha'."""

        def energy(rates: Array) -> Array:
            return inertia_of(scene, x, rates).T_r

        def spin(rates: Array) -> Array:
            return inertia_of(scene, x, rates).K_r

        return (
            cast(Array, jax.grad(energy)(alpha_dot)),
            cast(Array, jax.jacfwd(spin)(alpha_dot)),
        )

    def moved(x: Configuration, v: Array, alpha_dot: Array) -> tuple[Array, Array]:
        """J + rho x w, and w."""
        place = place_of(scene, x, state.sign)
        w = matvec(place.frame, v)
        return place.j + cross(place.rho, w), w

    def by_alpha(quantity: Callable[[Inertia], Array]) -> Array:
        def of(alpha: Array) -> Array:
            return quantity(inertia_of(scene, x._replace(alpha=alpha), alpha_dot))

        return cast(Array, jax.jacfwd(of)(x.alpha))

    slope_T = by_alpha(lambda body: body.T_r)
    slope_K = by_alpha(lambda body: body.K_r)
    slope_C = by_alpha(lambda body: body.mass * body.r_C)
    half_spin = by_alpha(lambda body: 0.5 * dot(w, matvec(body.Th, w)))
    v_O = place.j + cross(place.rho, w)
    _, K_by_rates = relative(x, v, alpha_dot)

    def residual(acceleration: Array) -> Array:
        T_dot, K_dot = motion.along(relative, acceleration)
        v_O_star, w_dot = motion.along(moved, acceleration)
        pushed = v_O_star + cross(w, v_O)
        return (
            (T_dot - slope_T)  # E_s(T_r)
            - Q
            + matvec(slope_C.T, pushed)
            - half_spin
            + matvec(K_by_rates.T, w_dot)
            + matvec((K_dot - slope_K).T, w)  # w . E*_s(K_r)
        )

    return residual
