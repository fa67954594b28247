"""An impact with friction: Routh's and Stronge's equations, by SciPy."""

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq


def impact(G: np.ndarray, u: np.ndarray, mu: float, e: float) -> np.ndarray:
    """Impulse of an impact, (8.6) to (8.9) of docs/theory.md, the third axis normal.

    Args:
        G: Change of the velocity by an impulse.
        u: Velocity of the point.
        mu: Friction.
        e: Restitution.
    """
    size, A, b = np.linalg.norm(u), G[:2, :2], G[:2, 2]
    z = np.concatenate([u, np.zeros(4)])  # velocity, impulse, work
    goal = None
    while True:
        if np.linalg.norm(z[:2]) > 1e-11 * size:
            z, ended = _slid(G, mu, z, goal, 1e-12 * size)
            if ended and (goal is not None or e == 0.0):
                return z[3:6]
            if ended:
                goal = (1 - e * e) * z[6]
                continue
            z[:2] = 0.0
        hold = -np.linalg.solve(A, b)
        if np.linalg.norm(hold) > mu:
            hold = -mu * _slips_off(mu * A, b)
        push = np.append(hold, 1.0)
        du = G @ push
        if goal is None:
            p = -z[2] / du[2]
            work = z[6] + 0.5 * z[2] * p
            z = np.concatenate([z[:3] + du * p, z[3:6] + push * p, [work]])
            goal = (1 - e * e) * work
        p = (np.sqrt(z[2] ** 2 + 2 * du[2] * (goal - z[6])) - z[2]) / du[2]
        return z[3:6] + push * p


def _slips_off(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The direction ``s`` of ``(A + f) s = b``, f positive."""
    way = lambda f: np.linalg.solve(A + f * np.eye(2), b)
    f = brentq(lambda f: np.linalg.norm(way(f)) - 1.0, 0.0, np.linalg.norm(b))
    return way(f)


def _slid(G, mu, z, goal, small) -> tuple[np.ndarray, bool]:
    """To the end of the phase (true), or of the slip."""

    def rates(_, z):
        speed = np.linalg.norm(z[:2])
        push = np.append(-mu * z[:2], speed)
        return np.concatenate([G @ push, push, [speed * z[2]]])

    phase: Any = lambda _, z: z[2] if goal is None else z[6] - goal
    slip: Any = lambda _, z: np.linalg.norm(z[:2]) - small
    phase.terminal = slip.terminal = True
    phase.direction = 1
    how = {"events": (phase, slip), "method": "DOP853", "rtol": 1e-12, "atol": 1e-15}
    run = solve_ivp(rates, (0.0, 1e7), z, **how)
    return run.y[:, -1], len(run.t_events[0]) > 0
