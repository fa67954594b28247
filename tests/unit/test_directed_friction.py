"""The direction of a slip that begins, docs/theory.md (8.5)."""

import jax
import jax.numpy as jnp
import numpy as np

from rollkane.dynamics.directed_friction import Balance, begins, first_way


def bodies(rng, count):
    """Balances of bodies, thin ones too, at the point where a slip begins.

    A body that is touched at rho from its centre of mass answers an impulse with
    ``G = 1 - rho x I^-1 rho x``. Its acceleration is planted: along a direction S that
    friction mu has there, by a tenth or all of what friction has.

    Returns:
        M and B of (8.5), and the planted directions, for one newton of normal force.
    """
    found = []
    while len(found) < count:
        rho = rng.normal(size=3) * 10 ** rng.uniform(-2.0, 0.0)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        inverse = turn @ np.diag(10 ** rng.uniform(0.0, 2.0, 3)) @ turn.T
        X = np.cross(np.eye(3), rho)
        G = np.eye(3) - X @ inverse @ X
        mu, angle = rng.uniform(0.0, 3.0), rng.uniform(0.0, 2 * np.pi)
        S = np.array([np.cos(angle), np.sin(angle)])
        # along the surface, with no acceleration off it
        A, r = G[:2, :2] - np.outer(G[:2, 2], G[2, :2]) / G[2, 2], G[2, :2] / G[2, 2]
        one = 1.0 - mu * r @ S
        if one < 0.05:
            continue  # no normal force fits: Painleve
        N = 1.0 / one
        b = mu * N * (A @ S + rng.choice([0.1, 1.0]) * S)
        found.append((mu * (A + np.outer(b, r)), b, S))
    return [np.array(x) for x in zip(*found, strict=True)]


def test_a_slip_begins_where_it_does_not_turn():
    rng = np.random.default_rng(3)
    M, B, planted = bodies(rng, 4000)
    across = np.stack([-planted[:, 1], planted[:, 0]], axis=1)
    on = lambda x, y: np.einsum("ni,nij,nj->n", x, M, y)
    # friction turns the slip at a rate g, which falls at its direction
    falls = np.sum(planted * B, 1) - on(planted, planted) + on(across, across)
    stable = falls > 0.0
    assert stable.sum() > 0.9 * len(B)
    # |g''| <= |B| + 4 |M|: Newton halves a distance of half of falls over that, and no
    # other direction is as near
    bend = np.linalg.norm(B, axis=1) + 4.0 * np.linalg.norm(M, axis=(1, 2))
    angle = rng.uniform(-0.5, 0.5, len(B)) * falls / bend
    start = planted * np.cos(angle)[:, None] + across * np.sin(angle)[:, None]
    find = jax.jit(jax.vmap(lambda M, B, start: first_way(Balance(M, B), start)))
    s = np.asarray(find(M, B, 0.5 * start))
    # g is certain to some 10 roundings of its terms
    error = np.linalg.norm(s - planted, axis=1) * np.abs(falls) / bend
    assert np.all(error[stable] < 3e-15)
    # what friction turns away from is not found
    assert not np.any(error[~stable] < 1e-9)
    found = ~np.isnan(s[:, 0])
    rate = B - np.einsum("nij,nj->ni", M, s)
    turn = np.abs(s[:, 0] * rate[:, 1] - s[:, 1] * rate[:, 0]) / bend
    assert np.all(turn[found] < 3e-15)
    np.testing.assert_allclose(np.sum(s * s, 1)[found], 1.0, rtol=1e-14)
    assert found.mean() > 0.99


def test_its_derivative_is_that_of_the_direction():
    rng = np.random.default_rng(4)
    (M,), (B,), (S,) = bodies(rng, 1)
    dM, dB = rng.normal(size=(2, 2)), rng.normal(size=2)
    at = lambda e: first_way(Balance(M + e * dM, B + e * dB), jnp.asarray(S))
    slope = jax.jit(lambda e: jax.jvp(at, (e,), (1.0,))[1])(0.0)
    h = 1e-4
    value = jax.jit(at)
    first, second = [(value(k * h) - value(-k * h)) / (2 * k * h) for k in (1.0, 2.0)]
    # Richardson: h^4, and rounding over h: each some 1e-12, more where M is far from 1
    np.testing.assert_allclose(slope, (4 * first - second) / 3, rtol=1e-8, atol=1e-9)


def test_without_a_direction_it_is_nan():
    # friction turns it for ever: s' . (B - M s) has no zero
    M = jnp.array([[0.0, 3.0], [-3.0, 0.0]])
    s = jax.jit(first_way)(Balance(M, jnp.array([1.0, 0.0])), jnp.array([1.0, 0.0]))
    assert np.all(np.isnan(s))


def test_length_tells_what_begins():
    assert begins(jnp.array([0.5, 0.0, 0.0]))
    assert begins(jnp.zeros(3))
    assert not begins(jnp.array([0.0, 0.6, -0.8]))
