"""Impacts with friction, of any response: against SciPy, and differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from rollkane.dynamics.impact_process import collided

RESTS = jnp.asarray(0.0)
# Of the speed a straight way may leave out 1e-10; what an impulse changes along the
# surface is up to a hundred times what it changes along n
LEFT_OUT = 1e-8


def drawn(count, seed):
    """Velocity, response, mu and e of points of bodies, slender ones among them."""
    rng = np.random.default_rng(seed)
    return np.stack([one(rng) for _ in range(count)])


def one(rng):
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    thin = 10.0 ** -rng.uniform(0.0, 1.5)
    last = thin if rng.random() < 0.5 else rng.uniform(0.3, 1.0)
    moments = np.array([1.0, rng.uniform(max(0.02, 1.0 - thin), 1.0), last])
    moments *= 10.0 ** rng.uniform(-1.5, 0.3)
    arm = rng.normal(size=3)
    arm *= rng.uniform(0.2, 1.5) / np.linalg.norm(arm)
    skew = np.cross(np.eye(3), arm)
    G = np.eye(3) + skew @ turn @ np.diag(1.0 / moments) @ turn.T @ skew.T
    velocity = rng.normal(size=3) * 10.0 ** rng.uniform(-3.0, 0.5)
    velocity[2] = -(10.0 ** rng.uniform(-1.5, 0.5))
    mu, e = 10.0 ** rng.uniform(-2.0, 0.3), rng.uniform(0.0, 1.0)
    return np.concatenate([velocity, G.reshape(9), [mu, e]])


def ended(x):
    """Impulse and velocity behind an impact."""
    found = collided(x[:3], x[3:12].reshape(3, 3), x[12], x[13], RESTS)
    return jnp.concatenate(found)


class Reference:
    """The same by SciPy: (8.8) until the slip is gone, then (8.9), in NumPy."""

    def __init__(self, x):
        self.velocity, self.G = x[:3], x[3:12].reshape(3, 3)
        self.mu, self.e = x[12:]
        self.phase, self.goal = 0, None

    def rates(self, _, y):
        slip = np.hypot(y[0], y[1])
        push = np.array([-self.mu * y[0], -self.mu * y[1], slip])
        return np.concatenate([self.G @ push, push, [slip * y[2]]])

    def without_slip(self):
        """Push, and change of the velocity, for one newton second along n."""
        A, b, mu = self.G[:2, :2], self.G[:2, 2], self.mu
        holding = np.linalg.solve(A, b)
        if holding @ holding <= mu * mu:
            along, slips = -holding, np.zeros(2)
        else:
            way = lambda f: np.linalg.solve(mu * A + f * np.eye(2), b)
            size = lambda f: np.linalg.norm(way(f)) - 1.0
            f = brentq(size, 0.0, 10.0 * np.linalg.norm(b), xtol=1e-16, rtol=1e-15)
            along, slips = -mu * way(f), f * way(f)
        return np.append(along, 1.0), np.append(slips, self.G[2, 2] + b @ along)

    def closed(self, y):
        """Compression has ended."""
        self.phase, self.goal = 1, (1.0 - self.e**2) * y[6]
        return np.concatenate([y[:2], [0.0], y[3:]])

    def ended(self):
        """Impulse and velocity behind it."""
        speed = np.linalg.norm(self.velocity)
        y = np.concatenate([self.velocity, np.zeros(4)])
        fastest = self.mu * np.trace(self.G[:2, :2]) + np.linalg.norm(self.G[:2, 2])
        close = lambda s, y: y[2] if self.phase == 0 else y[6] - self.goal
        gone = lambda s, y: np.hypot(y[0], y[1]) - 1e-13 * speed
        close.terminal = gone.terminal = True
        close.direction, gone.direction = 1.0, -1.0
        how = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-17 * speed}
        how |= {"events": [close, gone], "max_step": 2.0 / fastest}
        while True:
            run = solve_ivp(self.rates, (0.0, 1e5 / fastest), y, **how)
            y = run.y[:, -1]
            if not len(run.t_events[0]):
                assert len(run.t_events[1])
                return self.ended_without_slip(y)
            if self.phase == 1:
                return np.concatenate([y[3:6], y[:3]])
            y = self.closed(y)

    def ended_without_slip(self, y):
        push, change = self.without_slip()
        moved = lambda y, p: np.concatenate(
            [
                y[:3] + p * change,
                y[3:6] + p * push,
                [y[6] + (y[2] + change[2] * p / 2) * p],
            ]
        )
        y = np.concatenate([[0.0, 0.0], y[2:]])
        if self.phase == 0:
            y = self.closed(moved(y, -y[2] / change[2]))
        left = self.goal - y[6]
        y = moved(y, 2.0 * left / (y[2] + np.sqrt(y[2] ** 2 + 2.0 * change[2] * left)))
        return np.concatenate([y[3:6], y[:3]])


def case(velocity, G, numbers):
    """Of the response rows of the upper triangle."""
    nn, nt, no, tt, to, oo = G
    return np.array([*velocity, nn, nt, no, nt, tt, to, no, to, oo, *numbers])


HARD = {
    "a slip nearly ends, and turns round": case(
        (-0.0099538388095, -0.00480005649595, -1.23896470296),
        (
            *(1.45660031697, -0.854230641399, 1.01789000366),
            *(6.89384807056, -0.0226309491656, 4.09341466423),
        ),
        (0.247607500066, 0.0339554249238),
    ),
    "a slip neither slows nor grows": case(
        (-0.00189337870101, -0.0012435188272, -0.748542931592),
        (
            *(1.01208828098, 0.0174692390299, 0.0537652397495),
            *(1.46984283599, -0.00271843562037, 1.25367789192),
        ),
        (0.0532375038487, 0.0913940628293),
    ),
    "a slip ends ten times more slowly than its direction settles": case(
        (0.02709842, -0.27486408, -0.84693028),
        (2.60106181, 0.35218693, 0.47215676, 2.54256906, -0.1757186, 1.0038518),
        (0.3, 0.6),
    ),
}


@pytest.mark.parametrize("name", HARD)
def test_hard_impacts_by_scipy(name):
    x = HARD[name]
    found, expected = np.asarray(jax.jit(ended)(jnp.asarray(x))), Reference(x).ended()
    np.testing.assert_allclose(found, expected, atol=LEFT_OUT * np.abs(expected).max())


def test_impacts_by_scipy():
    x = drawn(60, 41)
    found = np.asarray(jax.jit(jax.vmap(ended))(jnp.asarray(x)))
    expected = np.stack([Reference(row).ended() for row in x])
    size = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(found - expected) <= LEFT_OUT * size).all()


def test_tangents_by_differences():
    """Of 500 impacts along some change of all numbers, and of the hard ones.

    Central differences of steps h and h / 2, extrapolated, of the best of three h: the
    values' own 1e-10 over 1e-5, or 1e-8 over 1e-4 where they are that far off.
    """
    x = np.concatenate([drawn(500, 42), np.stack(list(HARD.values()))])
    ways = x * np.random.default_rng(43).normal(size=x.shape)
    G = ways[:, 3:12].reshape(-1, 3, 3)
    ways[:, 3:12] = (0.5 * (G + G.transpose(0, 2, 1))).reshape(-1, 9)
    value = jax.jit(jax.vmap(ended))
    push = jax.jit(jax.vmap(lambda x, way: jax.jvp(ended, (x,), (way,))[1]))
    found = np.asarray(push(jnp.asarray(x), jnp.asarray(ways)))
    difference = lambda h: np.asarray(value(x + h * ways) - value(x - h * ways)) / 2 / h
    off = np.full(len(x), np.inf)
    for h in (1e-4, 1e-5, 1e-6):
        expected = (4.0 * difference(h / 2) - difference(h)) / 3.0
        size = np.abs(expected).max(axis=1)
        assert (size > 0.0).all()
        off = np.minimum(off, np.abs(expected - found).max(axis=1) / size)
    assert (off <= 1e-5).all()
