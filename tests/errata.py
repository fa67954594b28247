"""What the paper prints against what is true: the residual of each form.

    python -m tests.errata

Formulas are written out as they stand in print, in lines of curvature, and once more as
corrected. What is true is found without them: from the pose alone (``by_definition``)
or from the motion of every mass. Random configurations of the problem of the collected
equations' section 10, both signs, with a base that moves.
"""

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.codegen.compile_effort import for_one_call
from rollkane.dynamics import observables
from rollkane.geometry.rotations import rotation_matrix
from rollkane.paper.euler_lagrange import residual_of
from rollkane.paper.quasi_energy import (
    Configuration,
    inertia_of,
    kinetic_energy_with_slip,
    place_of,
)

from . import paper
from .by_definition import affine, coordinates, defined_symbols, pose

DRAWS = 20  # of each sign
NOW = np.zeros(())


def drawn(sign):
    """Scenes of section 10 with random states in its charts, and their time."""
    rng = np.random.default_rng(20 + sign)
    scene, state = paper.scene_and_state(sign)
    inner = lambda low, high: low + (high - low) * (0.1 + 0.8 * rng.random(DRAWS))
    body = np.stack([inner(1.01, 1.68), inner(0.5, 0.99)], axis=1)
    base = np.stack([inner(10.9, 15.9), inner(6.3, 10.8)], axis=1)
    return scene, rk.VoronetsState(
        contact_on_body=jnp.asarray(body),
        contact_on_base=jnp.asarray(base),
        angle=jnp.asarray(6.0 * rng.random(DRAWS)),
        angular_velocity=jnp.asarray(rng.standard_normal((DRAWS, 3))),
        alpha=jnp.asarray(rng.standard_normal((DRAWS, 1))),
        alpha_dot=jnp.asarray(rng.standard_normal((DRAWS, 1))),
        sign=state.sign,
    )


def forms(surface, q, geometry):
    """a11, a22, b11, b22 of a principal chart, and d1 ln a_kk, d2 ln a_kk."""
    a, b = jnp.diag(geometry.first_form), jnp.diag(geometry.second_form)
    first = lambda q: jnp.log(jnp.diag(surface.chart_geometry(q).first_form))
    slopes = jax.jacfwd(first)(q)  # [k, i]: d_i ln a_kk
    return a, b, slopes


def kinematics(scene, state):
    """Items 1 to 3 and 8: pairs of residuals, as printed and as corrected."""
    x, s, v = coordinates(state), state.sign, state.angular_velocity
    A_ri, A_r0 = affine(scene, NOW, x, s)
    B_ik = jnp.linalg.inv(A_ri)
    x_dot = B_ik @ (jnp.concatenate([jnp.zeros(2), v]) - A_r0)  # rolling
    contact = rk.contact_of(scene, NOW, state)
    a, b, dln = forms(scene.body.surface, state.contact_on_body, contact.shell)
    ac, bc, dlnc = forms(scene.base.surface, state.contact_on_base, contact.ground)
    sin, cos = jnp.sin(state.angle), jnp.cos(state.angle)
    (k1, k2), (k1c, k2c) = b / a, bc / ac
    D11 = k1 - s * k1c * sin**2 - s * k2c * cos**2
    D22 = k2 - s * k2c * sin**2 - s * k1c * cos**2
    D12 = -s * (k2c - k1c) * sin * cos
    R = D11 * D22 - D12**2
    first = dln[0, 1] / jnp.sqrt(a[1]) - sin * dlnc[0, 1] / jnp.sqrt(ac[1])
    D1_dropped = 0.5 * first
    D1_misread = 0.5 * (first + s * cos * dlnc[0, 0] / jnp.sqrt(ac[0]))
    D1 = 0.5 * (first + s * cos * dlnc[1, 0] / jnp.sqrt(ac[0]))
    D2 = 0.5 * (
        dln[1, 0] / jnp.sqrt(a[0])
        - s * sin * dlnc[1, 0] / jnp.sqrt(ac[0])
        - cos * dlnc[0, 1] / jnp.sqrt(ac[1])
    )
    # n = -theta' + Delta_1 u1 - Delta_2 u2 + C, for a unit of sigma and one of tau
    u = jnp.sqrt(a)[:, None] * B_ik[:2, 2:4]
    true_D1, _ = jnp.linalg.solve(jnp.stack([u[0], -u[1]], axis=1), B_ik[4, 2:4])
    base_spin = A_r0[2:]  # (A, B, C): quasi-velocities of a body that the base carries
    sigma_A, tau_B = v[0] - base_spin[0], v[1] - base_spin[1]
    by_sigma = sigma_A / R * (D12 * D1 + D11 * D2)
    by_tau = tau_B / R * (D22 * D1 + D12 * D2)
    still = base_spin[2] - v[2]
    across = -(sigma_A * D11 + tau_B * D12)
    # absolute velocity of the geometric contact point
    moving = lambda x, t: pose(scene, x, t, s)
    (_, turn, _, arm, _), (v_0, turn_dot, _, arm_dot, _) = jax.jvp(
        moving, (x, NOW), (x_dot, np.ones(()))
    )
    rho_star = arm_dot - turn_dot @ (turn.T @ arm)
    w = turn @ (contact.shell.frame @ v)
    return {
        "1, term dropped": (D1_dropped - true_D1, D1 - true_D1),
        "1, index misread": (D1_misread - true_D1, D1 - true_D1),
        "2": (
            still + by_sigma - by_tau - x_dot[4],
            still + by_sigma + by_tau - x_dot[4],
        ),
        "3": (
            across / jnp.sqrt(jnp.abs(a[1] * R)) - x_dot[1],
            across / (jnp.sqrt(a[1]) * R) - x_dot[1],
        ),
        "8": (
            v_0 + jnp.cross(w, w) + rho_star - (v_0 + arm_dot),
            v_0 + jnp.cross(w, arm) + rho_star - (v_0 + arm_dot),
        ),
    }


def literal_symbols(paper_values):
    """Gamma and epsilon with (2.2) to the letter: s = 1, 2 where 5 is meant."""
    Gamma, epsilon = paper_values.Gamma, paper_values.epsilon
    p, q = paper_values.p, paper_values.q
    for s in (0, 1):
        Gamma = Gamma.at[s, 2, 3].set(p[0] + q[1] - 1.0)
        Gamma = Gamma.at[s, 3, 2].set(-(p[0] + q[1] - 1.0))
        epsilon = epsilon.at[s, 2].set(-q[2]).at[s, 3].set(p[2])
    Gamma = Gamma.at[4, 2, 3].set(0.0).at[4, 3, 2].set(0.0)
    epsilon = epsilon.at[4, 2].set(0.0).at[4, 3].set(0.0)
    return Gamma, epsilon


def symbols(scene, state):
    """Items 4 and 5, and (2.3) with both."""
    contact = rk.contact_of(scene, NOW, state)
    corrected = rk.paper_quantities(contact, principal=True)
    Gamma, epsilon = corrected.Gamma, corrected.epsilon
    Gamma_printed, epsilon_printed = literal_symbols(corrected)
    Gamma_true, epsilon_true = defined_symbols(scene, NOW, state)
    # those with a slip among their lower indices are multiplied by zero
    lower = np.s_[:, 2:, 2:]
    rates = rk.rolling_derivative(scene, NOW, state)
    moved = jnp.concatenate([rates.angular_velocity, rates.alpha_dot])
    left = residual_of(scene, NOW, state, contact, "2.3")(moved)
    U = jnp.concatenate([jnp.zeros(2), state.angular_velocity])
    x = configuration(state)
    T = lambda U: kinetic_energy_with_slip(scene, x, U, state.alpha_dot, state.sign)
    more = jnp.einsum("rtk,t->rk", Gamma_printed - Gamma, U) + epsilon_printed - epsilon
    return {
        "4": ((Gamma_printed - Gamma_true)[lower], (Gamma - Gamma_true)[lower]),
        "5": (
            (epsilon_printed - epsilon_true)[:, 2:],
            (epsilon - epsilon_true)[:, 2:],
        ),
        "(2.3) with 4 and 5": (left[:3] + (jax.grad(T)(U) @ more)[2:], left),
    }


def configuration(state):
    """Coordinates of the whole system, at time 0."""
    on_body, on_base = state.contact_on_body, state.contact_on_base
    return Configuration(on_body, on_base, state.angle, state.alpha, NOW)


def energies(scene, state):
    """Items 12 and 20: kinetic energy, and angular momentum about the contact point."""
    contact = rk.contact_of(scene, NOW, state)
    x, rates = configuration(state), state.alpha_dot
    body, place = inertia_of(scene, x, rates), place_of(scene, x, state.sign)
    U = jnp.concatenate([jnp.zeros(2), state.angular_velocity])
    T = kinetic_energy_with_slip(scene, x, U, rates, state.sign)
    (masses,) = scene.supported
    r = masses.carried(NOW, state.alpha, rates).place
    T_printed = T - body.T_r + 0.5 * jnp.sum(masses.mass[None] * r * r)
    T_true = observables.kinetic_energy(scene, NOW, state)
    w = contact.angular_velocity
    v_O = place.j - jnp.cross(w, place.rho)
    K_O = body.mass * jnp.cross(body.r_C, v_O) + body.Th @ w + body.K_r
    P = body.mass * (v_O + jnp.cross(w, body.r_C)) + body.Q_r
    turned = contact.rotation.T
    K_true = turned @ observables.contact_angular_momentum(scene, NOW, state)
    return {
        "12": (T_printed - T_true, T - T_true),
        "20": (
            K_O + jnp.cross(body.Q_r, place.rho) - K_true,
            K_O + jnp.cross(P, place.rho) - K_true,
        ),
    }


def carried_scene(sign):
    """The same body and base with a rigid body inside that has six coordinates."""
    scene, state = paper.scene_and_state(sign)
    place = lambda a: 0.2 * jnp.stack([a[0] + a[1] ** 2, a[1], jnp.sin(a[2])])
    half = lambda a: 0.5 * jnp.stack([2.0 + a[3] * a[4], a[3], a[4], a[5] + a[3] ** 2])
    unit = lambda v: v / jnp.sqrt(jnp.sum(v * v))
    part = rk.SupportedBody(
        0.7,
        [[0.05, 0.004, 0.002], [0.004, 0.06, -0.003], [0.002, -0.003, 0.09]],
        place,
        lambda a: rotation_matrix(unit(half(a))),
        lambda t, a, a_dot: -0.4 * a - 0.1 * a_dot,
    )
    rng = np.random.default_rng(30 + sign)
    state = jax.tree.map(lambda leaf: jnp.stack([leaf] * DRAWS), state)
    spins = jnp.asarray(rng.standard_normal((DRAWS, 3)))
    own = [jnp.asarray(rng.standard_normal((DRAWS, 6))) for _ in range(2)]
    replaced = rk.VoronetsState(
        state.contact_on_body, state.contact_on_base, state.angle, spins, *own, sign
    )
    return rk.Scene(scene.body, scene.base, part, scene.loads), replaced


def supported_body(scene, state):
    """Item 7: the rotation of the carried body, with either trace."""
    contact = rk.contact_of(scene, NOW, state)
    (part,) = scene.supported
    (turning,) = part.carried(NOW, state.alpha, state.alpha_dot).turnings
    rates = rk.rolling_derivative(scene, NOW, state)
    w, w_r, I_r = contact.angular_velocity, turning.velocity, turning.inertia
    # w' on body axes from (sigma', tau', n') (theory 4.1)
    on_frame = rates.angular_velocity - jnp.cross(
        contact.frame_turn, state.angular_velocity
    )
    w_dot = contact.shell.frame @ on_frame
    partials = jnp.stack(turning.partials)
    w_r_star = turning.bias + rates.alpha_dot @ partials
    Q = part.generalized_force(NOW, state.alpha, state.alpha_dot)

    def left(trace):
        mixed = I_r @ w - 0.5 * trace * w
        known = I_r @ w_r_star + jnp.cross(w_r, I_r @ w_r) + I_r @ w_dot
        return known + jnp.cross(w, I_r @ w) + 2.0 * jnp.cross(w_r, mixed)

    body = scene.body
    c = body.center_of_mass
    about_O = body.inertia + body.mass * (c @ c * jnp.eye(3) - jnp.outer(c, c))
    printed, corrected = left(jnp.trace(about_O)), left(jnp.trace(I_r))
    own = slice(3, 6)  # the coordinates of its rotation
    return {"7": ((partials @ printed - Q)[own], (partials @ corrected - Q)[own])}


def bar(seed):
    """Item 14: (w x H) . dw/dw2' of the bar on a rail, axes e1 (bar), e2, e3."""
    rng = np.random.default_rng(seed)
    theta, v, v_dot, w2, d = rng.uniform(0.2, 1.2, 5)
    moment = 0.8 * 0.5**2 / 12.0  # m L^2 / 12
    S, C = np.sin(theta), np.cos(theta)
    w = np.array([-S * v / d, w2, C * v / d])
    H = moment * np.array([0.0, w[1], w[2]])
    true = np.cross(w, H)[1]
    share = moment * S * C / d**2
    return {"14": (share * v_dot - true, share * v**2 - true)}


def residuals() -> dict[str, tuple[float, float]]:
    """Item -> largest residual (as printed, as corrected) over all configurations."""
    found: dict[str, list] = {}
    groups = (
        (drawn, 1, (kinematics, symbols, energies)),
        (drawn, -1, (kinematics, energies)),
        (carried_scene, -1, (supported_body,)),
    )
    for make, sign, parts in groups:
        scene, state = make(sign)
        for part in parts:
            of = lambda s, part=part, scene=scene: part(scene, s)
            pairs = for_one_call(lambda s, of=of: jax.vmap(of)(s))(state)
            for name, pair in pairs.items():
                found.setdefault(name, []).append(pair)
    for seed in range(DRAWS):
        for name, pair in bar(seed).items():
            found.setdefault(name, []).append(pair)
    largest = lambda values: max(float(np.abs(v).max()) for v in values)
    return {
        name: (largest(p for p, _ in pairs), largest(c for _, c in pairs))
        for name, pairs in found.items()
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    for item, (printed, corrected) in residuals().items():
        print(f"{item:22}{printed:10.1e}{corrected:10.1e}")
