"""Quasi-velocities and their symbols by definition: from the pose alone.

Nothing of the constraint equations is used: what is derived from them is held against
this.
"""

import jax
import jax.numpy as jnp

from rollkane.geometry.small_linear import cross
from rollkane.kinematics.voronets import charts_of


def pose(scene, x, t, sign):
    """Origin O, rotation R, the frame and the contact of any configuration.

    Args:
        scene: With a base that moves.
        x: ``(q1, q2, qc1, qc2, theta)``.
        t: Time [s].
        sign: ``s``.

    Returns:
        ``r_O`` and ``R`` (fixed axes), ``R E``, ``R rho``, and rho_c (base axes).
    """
    body, base = scene.body.surface, scene.base.surface
    shell, ground, _, to_base = charts_of(body, base, x[:2], x[2:4], x[4], sign)
    base_now = scene.base.motion.at(t)
    R = base_now.rotation @ to_base
    origin = base_now.placed(ground.position) - R @ shell.position
    return origin, R, R @ shell.frame, R @ shell.position, ground.position


def quasi_velocities(scene, t, x, x_dot, sign):
    """U^1 .. U^5 of any velocities, rolling or not."""
    one = jnp.ones_like(t)
    where = lambda x, t: pose(scene, x, t, sign)
    (_, R, E, arm, point), (v_O, R_dot, *_) = jax.jvp(where, (x, t), (x_dot, one))
    S = R_dot @ R.T
    w = jnp.stack([S[2, 1], S[0, 2], S[1, 0]])
    fixed = lambda t: scene.base.motion.at(t).placed(point)
    slip = v_O + cross(w, arm) - jax.jvp(fixed, (t,), (one,))[1]
    return jnp.concatenate([(E.T @ slip)[:2], E.T @ w])


def coordinates(state):
    """``(q1, q2, qc1, qc2, theta)`` of a Voronets state."""
    return jnp.concatenate(
        [state.contact_on_body, state.contact_on_base, state.angle[None]]
    )


def affine(scene, t, x, sign):
    """``A^r_i`` and ``A^r_0`` of ``U^r = A^r_i q'^i + A^r_0``."""
    still = jnp.zeros(5)
    of = lambda x_dot: quasi_velocities(scene, t, x, x_dot, sign)
    return jax.jacfwd(of)(still), of(still)


def defined_symbols(scene, t, state):
    """Gamma and epsilon from their definition (theory, section 4)."""
    x = coordinates(state)
    of = lambda x, t: affine(scene, t, x, state.sign)
    A, A_0 = of(x, t)
    (dA, dA_0), (A_t, _) = jax.jacfwd(of)(x, t), jax.jacfwd(of, 1)(x, t)
    B = jnp.linalg.inv(A)
    curl = dA - jnp.swapaxes(dA, 1, 2)  # [r, i, j]: d_j A^r_i - d_i A^r_j
    Gamma = jnp.einsum("rij,jt,ik->rtk", curl, B, B)
    epsilon = (jnp.einsum("rij,j->ri", curl, -B @ A_0) + A_t - dA_0) @ B
    return Gamma, epsilon
