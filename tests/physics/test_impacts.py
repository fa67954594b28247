"""Impacts: inside the friction cone, pushing, taking energy; and their limits."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.impact_process import NEVER_SLIPS, collided
from rollkane.dynamics.impacts import impact
from rollkane.geometry.rotations import rotation_matrix
from rollkane.kinematics.coordinates import FlyingState

SLOW = 1e-9  # [m/s]: below every rebound here but those of plastic impacts
COUNT = 5000
# Of what it is compared with: some 200 roundings by 1e-16 of matrices with condition
# numbers up to 1e4 (slender rods)
ROUNDED = 1e-10


def drawn(count: int, seed: int) -> dict[str, np.ndarray]:
    """Rods, ellipsoids and loaded shells that come in somehow; mu, e."""
    rng = np.random.default_rng(seed)
    axes = 10.0 ** rng.uniform(-1.3, 0.0, (count, 3))
    axes[::3, :2] = 0.02  # rods
    mass = rng.uniform(0.5, 5.0, count)
    squares = axes**2
    # from a solid (1/5) to a thin shell (1/3)
    share = np.where(np.arange(count) % 3 == 2, 1.0 / 3.0, 0.2)
    moments = (share * mass)[:, None] * (squares.sum(1, keepdims=True) - squares)
    inertia = moments[:, :, None] * np.eye(3)
    # a load anywhere inside, seen from the common mass centre
    load = rng.uniform(0.0, 3.0, count) * (np.arange(count) % 3 > 0)
    place = rng.uniform(-0.5, 0.5, (count, 3)) * axes
    center = (load / (mass + load))[:, None] * place
    reduced = (mass * load / (mass + load))[:, None, None]
    outer = place[:, :, None] * place[:, None, :]
    apart = (place**2).sum(1)[:, None, None] * np.eye(3) - outer
    turn = rng.normal(size=(count, 4))
    mu, e = rng.uniform(0.0, 10.0, count), rng.uniform(0.0, 1.0, count)
    mu[::4], mu[1::4] = 0.0, rng.uniform(0.0, 1.0, count)[1::4]
    mu[2::8] = NEVER_SLIPS  # what friction=None stands for
    e[::5], e[1::5] = 0.0, 1.0
    return {
        "axes": axes,
        "mass": mass + load,
        "center": center,
        "inertia": inertia + reduced * apart,
        "turn": turn / np.linalg.norm(turn, axis=1, keepdims=True),
        "spin": 5.0 * rng.normal(size=(count, 3)),
        "velocity": rng.normal(size=(count, 3)),
        "mu": mu,
        "e": e,
    }


@functools.partial(jax.jit, static_argnums=1)
def hit(x, law="energetic"):
    """What :func:`one` finds, of many."""
    return jax.vmap(functools.partial(one, law=law))(x)


def one(x, law):
    """Impulse, point that is hit from the mass centre, and velocities before, after.

    Of the mass centre and of the body, both on fixed axes.
    """
    surface = rk.Ellipsoid(x["axes"])
    body = rk.Body(x["mass"], x["inertia"], surface, x["center"])
    scene = rk.Scene(body, contact=rk.Slipping())
    R = rotation_matrix(x["turn"])
    of_normal = surface.normal_map(True)
    arm = R @ of_normal(-R[2])
    spin = R @ x["spin"]
    # it comes in, with what it has
    down = jnp.abs((x["velocity"] + jnp.cross(spin, arm))[2]) + 0.01
    fall = x["velocity"] - jnp.cross(spin, arm)
    velocity = fall.at[2].add(-down - (fall + jnp.cross(spin, arm))[2])
    none = jnp.zeros(0)
    place = jnp.array([0.0, 0.0, -1.0]) * arm[2]
    state = FlyingState(
        x["turn"], x["spin"], (place + arm)[:2], none, none, none, place, velocity
    )
    numbers = x["e"], x["mu"], jnp.asarray(SLOW)
    found = impact(scene, jnp.zeros(()), state, *numbers, law)
    c = R @ x["center"]
    motions = [
        (s.velocity + jnp.cross(R @ s.angular_velocity, c), R @ s.angular_velocity)
        for s in (state, found.flying)
    ]
    return found.impulse, arm - c, motions, found.touching.slip, found.speed


def checked(x, found):
    """What was found, with the work of the impulse and the energies before and after.

    Energies by the definition, in NumPy: no part of the library's mass matrix.
    """
    J, arm, motions, slip, speed = jax.tree.map(np.asarray, found)
    R = np.asarray(jax.vmap(rotation_matrix)(jnp.asarray(x["turn"])))
    inertia = R @ x["inertia"] @ R.transpose(0, 2, 1)
    points, energies = [], []
    for v, w in motions:
        points.append(v + np.cross(w, arm))
        turned = np.einsum("ni,nij,nj->n", w, inertia, w)
        energies.append(0.5 * (x["mass"] * (v**2).sum(1) + turned))
    # momentum and angular momentum change by the impulse at the point, and by no more
    (v0, w0), (v1, w1) = motions
    change = x["mass"][:, None] * (v1 - v0) - J
    turning = np.einsum("nij,nj->ni", inertia, w1 - w0) - np.cross(arm, J)
    size = np.linalg.norm(J, axis=1, keepdims=True)
    assert (np.abs(change) <= ROUNDED * size).all()
    assert (np.abs(turning) <= ROUNDED * size).all()
    work = 0.5 * np.einsum("ni,ni->n", J, points[0] + points[1])
    return J, work, *energies, points, slip, speed


def test_impacts_push_lie_in_the_cone_and_take_energy():
    """Of 5,000 bodies; mu from 0 to 10 and none, e from 0 to 1."""
    x = drawn(COUNT, 14)
    J, work, before, after, points, _, _ = checked(x, hit(x))
    assert np.isfinite(J).all()
    size = np.linalg.norm(J, axis=1)
    assert (J[:, 2] >= -ROUNDED * size).all()
    along = np.linalg.norm(J[:, :2], axis=1)
    rubs = x["mu"] < NEVER_SLIPS
    assert (along <= x["mu"] * J[:, 2] + ROUNDED * size)[rubs].all()
    assert (work <= ROUNDED * before).all()
    np.testing.assert_allclose(after - before, work, atol=ROUNDED * before.max())
    # elastic without friction: nothing is lost
    smooth = (x["mu"] == 0.0) & (x["e"] == 1.0)
    assert smooth.sum() > 100
    np.testing.assert_allclose(after[smooth], before[smooth], rtol=ROUNDED)
    np.testing.assert_allclose(points[1][smooth, 2], -points[0][smooth, 2], rtol=1e-8)


def response(x, arm):
    """``G`` of a point of a free body: ``1 / m - [a]x I^-1 [a]x``, in NumPy."""
    R = np.asarray(jax.vmap(rotation_matrix)(jnp.asarray(x["turn"])))
    inverse = np.linalg.inv(R @ x["inertia"] @ R.transpose(0, 2, 1))
    skew = np.zeros((len(arm), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[:, i, j], skew[:, j, i] = -arm[:, k], arm[:, k]
    whole = np.eye(3) / x["mass"][:, None, None]
    return whole - skew @ inverse @ skew


def stepped(u, G, mu, e, steps=20_000):
    """The process by small steps of the normal impulse, in NumPy; None where it sticks.

    Midpoint rule: its error is the square of a step, 1e-8 of the whole here.
    """
    work, least, p, J = 0.0, 0.0, 0.0, np.zeros(3)
    whole = -4.0 * u[2] / np.linalg.eigvalsh(G)[0]
    h = whole / steps
    while p < whole:
        slip = np.linalg.norm(u[:2])
        if slip < 3.0 * h * mu * np.linalg.norm(G):
            return None
        half = u + 0.5 * h * G @ np.append(-mu * u[:2] / slip, 1.0)
        push = np.append(-mu * half[:2] / np.linalg.norm(half[:2]), 1.0)
        new = u + h * G @ push
        gained = work + 0.5 * h * (u[2] + new[2])
        goal = (1.0 - e * e) * min(least, gained)
        if new[2] > 0.0 and gained >= goal:
            last = (goal - work) / (0.5 * (u[2] + new[2]))
            return J + last * push
        work, least, u, J, p = gained, min(least, gained), new, J + h * push, p + h
    return None


def test_impulses_by_small_steps():
    """Slips that turn, against the process stepped through: to 1e-4, the steps' own."""
    x = {k: v[:400] for k, v in drawn(COUNT, 15).items()}
    found = jax.tree.map(np.asarray, hit(x))
    J, arm, motions = found[:3]
    G = response(x, arm)
    compared = 0
    for i in np.nonzero((x["mu"] > 0.0) & (x["mu"] < 2.0) & (x["e"] > 0.0))[0]:
        v, w = (part[i] for part in motions[0])
        expected = stepped(v + np.cross(w, arm[i]), G[i], x["mu"][i], x["e"][i])
        if expected is None:
            continue
        compared += 1
        size = np.linalg.norm(expected)
        np.testing.assert_allclose(J[i], expected, atol=2e-4 * size)
    assert compared > 20


def test_a_plastic_impact_without_slip_stops_the_point():
    """``J = -G^-1 u`` where that pushes and sticks: the energy lost is u G^-1 u / 2."""
    x = drawn(1000, 16)
    x["mu"][:], x["e"][:] = NEVER_SLIPS, 0.0
    J, _, before, after, points, slip, speed = checked(x, hit(x))
    _, arm, _, _, _ = jax.tree.map(np.asarray, hit(x))
    stop = -np.linalg.solve(response(x, arm), points[0][:, :, None])[:, :, 0]
    sticks = np.linalg.norm(slip, axis=1) == 0.0
    assert sticks.sum() > 500
    size = np.abs(stop).max(axis=1, keepdims=True)
    assert (np.abs(J - stop) <= 1e-7 * size)[sticks].all()
    lost = -0.5 * np.einsum("ni,ni->n", stop, points[0])
    np.testing.assert_allclose((before - after)[sticks], lost[sticks], rtol=1e-7)
    assert (speed == 0.0)[sticks].all()


def test_newton_is_refused_where_it_is_inconsistent():
    """It agrees with its own rule where it holds; NaN where it would not."""
    x = drawn(COUNT, 14)
    x["e"] = np.maximum(x["e"], 0.05)
    J = np.asarray(hit(x, "newton")[0])
    known = np.isfinite(J).all(axis=1)
    x = {k: v[known] for k, v in x.items()}
    assert 0.5 * COUNT < known.sum() < COUNT
    J, work, before, _, points, _, _ = checked(x, hit(x, "newton"))
    assert (J[:, 2] >= -ROUNDED * np.linalg.norm(J, axis=1)).all()
    assert (work <= 1e-9 * before).all()
    # a normal velocity of 0.01 m/s and more, of points that move with up to 10 m/s
    np.testing.assert_allclose(points[1][:, 2], -x["e"] * points[0][:, 2], rtol=1e-7)


@pytest.mark.parametrize("law", ["energetic", "newton"])
def test_of_a_ball_both_laws_are_one(law):
    """``u_n+ = -e u_n``; it slips where mu (1 + e) |u_n| < 2/7 |u_t|, else it rolls."""
    x = drawn(200, 17)
    x["axes"][:] = 0.11
    x["center"][:] = 0.0
    x["inertia"][:] = 0.4 * x["mass"][:, None, None] * 0.11**2 * np.eye(3)
    x["mu"] = np.linspace(0.0, 1.0, 200)
    J, _, _, _, (u, after), _, _ = checked(x, hit(x, law))
    fall = -(1.0 + x["e"]) * u[:, 2]
    np.testing.assert_allclose(J[:, 2], x["mass"] * fall, rtol=1e-10)
    slip = np.linalg.norm(u[:, :2], axis=1)
    along = np.minimum(x["mu"] * fall, 2.0 / 7.0 * slip)
    expected = -(x["mass"] * along / slip)[:, None] * u[:, :2]
    np.testing.assert_allclose(J[:, :2], expected, atol=1e-10)
    np.testing.assert_allclose(after[:, 2], -x["e"] * u[:, 2], atol=1e-10)


# Responses G [1/kg] that turn no slip: of a ball, and of a body hit in its plane.
BALL_LIKE = np.diag([3.5, 3.5, 1.0])
IN_A_PLANE = np.array([[4.0, 0.0, 1.5], [0.0, 2.0, 0.0], [1.5, 0.0, 2.0]])
STRAIGHT = [  # response, velocity, mu, e
    (BALL_LIKE, (2.0, 1.0, -1.0), 0.2, 0.5),  # slips on
    (BALL_LIKE, (0.4, 0.2, -1.0), 0.5, 0.5),  # stops
    (BALL_LIKE, (0.4, 0.2, -1.0), 0.5, 0.0),
    (IN_A_PLANE, (2.0, 0.0, -1.0), 0.2, 0.6),
    (IN_A_PLANE, (-3.0, 0.0, -1.0), 0.2, 0.6),
    (IN_A_PLANE, (0.3, 0.0, -1.0), 0.2, 0.6),  # slips back
    (IN_A_PLANE, (0.3, 0.0, -1.0), 0.9, 0.6),  # stops and sticks
    (IN_A_PLANE, (2.0, 0.7, -1.0), 0.0, 0.6),  # without friction
]


def test_a_body_does_not_jump_to_where_it_is_hit():
    """Where the nearest points are not those that touch, nothing is known behind."""
    ball = rk.Body(1.0, 0.4e-2 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(ball, contact=rk.Slipping())
    down = (0.3, 0.0, -1.0)
    there = rk.release(scene, (1, 0, 0, 0), (0, 0, 0), (0.2, 0.1, 0.1), down)
    numbers = [jnp.asarray(x) for x in (0.5, 0.3, SLOW)]
    hits = jax.jit(lambda state: impact(scene, jnp.zeros(()), state, *numbers))
    # a millionth of a metre above the plane; and beside the contact by as much
    off = np.array([[0, 0, 0], [0, 0, 1e-6], [1e-6, 0, 0]])
    for k, x in enumerate(off):
        state = eqx.tree_at(lambda s: s.position, there, there.position + x)
        found = hits(state)
        known = np.isfinite(np.asarray(found.flying.velocity)).all()
        assert known == (k == 0)
        assert np.isfinite(np.asarray(found.touching.slip)).all() == known


def test_neighbours_of_a_straight_slip_turn():
    """What symmetry keeps straight has derivatives by what breaks the symmetry.

    Central differences of steps 1e-3 and 5e-4, extrapolated: 1e-12 of a fifth
    derivative, which powers of mu G / slip of up to 10 make 1e-7 of the sixth's; and
    the process' own 1e-10 over 1e-3.
    """
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]

    def ended(x):
        G = jnp.zeros((3, 3))
        for at, value in zip(pairs, x[3:9], strict=True):
            G = G.at[at].set(value).at[at[::-1]].set(value)
        found = collided(x[:3], G, x[9], x[10], jnp.asarray(SLOW))
        return jnp.concatenate(found)

    cases = jnp.asarray(
        [[*u, *(G[at] for at in pairs), mu, e] for G, u, mu, e in STRAIGHT]
    )
    run, jacobian = jax.jit(jax.vmap(ended)), jax.jit(jax.vmap(jax.jacfwd(ended)))
    found = jacobian(cases)
    for i in range(cases.shape[1]):
        way = jnp.eye(cases.shape[1])[i][None]
        slope = lambda h, way=way: (run(cases + h * way) - run(cases - h * way)) / 2 / h
        expected = (4.0 * slope(5e-4) - slope(1e-3)) / 3.0
        # friction and restitution that would be negative have no meaning
        meant = (cases[:, i] > 0.0) | (i < 9)
        np.testing.assert_allclose(found[meant, :, i], expected[meant], atol=1e-6)


@pytest.mark.slow
def test_derivatives_of_impacts():
    """By velocity, spin, mu and e: forward is reverse, and both the difference.

    Central differences of steps 1e-4 and 5e-5, extrapolated: 1e-16 over rounding
    1e-12 / 1e-4; across a corner of the law (to stick, to slip) they are left out.
    """
    x = {k: v[:60] for k, v in drawn(COUNT, 18).items()}
    keep = (x["mu"] > 0.0) & (x["mu"] < NEVER_SLIPS) & (x["e"] > 0.0) & (x["e"] < 1.0)
    names = "velocity", "spin", "mu", "e"

    def impulse(free, rest):
        whole = {k: v[None] for k, v in (rest | free).items()}
        return hit(whole)[0][0]

    forward, reverse = (jax.jit(f(impulse)) for f in (jax.jacfwd, jax.jacrev))
    run, compared = jax.jit(impulse), 0
    rng = np.random.default_rng(19)
    for i in np.nonzero(keep)[0]:
        own = {k: jnp.asarray(v[i]) for k, v in x.items()}
        free = {k: own.pop(k) for k in names}
        ways = {k: jnp.asarray(rng.normal(size=v.shape)) for k, v in free.items()}

        def beside(h, free=free, ways=ways, own=own):
            at = [
                run({k: v + s * h * ways[k] for k, v in free.items()}, own)
                for s in (1.0, -1.0)
            ]
            return (at[0] - at[1]) / (2.0 * h)

        once, half = beside(1e-4), beside(5e-5)
        size = float(jnp.max(jnp.abs(half)))
        if float(jnp.max(jnp.abs(once - half))) > 1e-5 * size:
            continue
        compared += 1
        expected = (4.0 * half - once) / 3.0
        fwd, rev = forward(free, own), reverse(free, own)
        sums = [
            sum(jnp.tensordot(jac[k], ways[k], axes=jnp.ndim(ways[k])) for k in names)
            for jac in (fwd, rev)
        ]
        np.testing.assert_allclose(sums[0], expected, atol=1e-6 * size)
        np.testing.assert_allclose(sums[1], sums[0], atol=1e-9 * size)
    assert compared > 10
