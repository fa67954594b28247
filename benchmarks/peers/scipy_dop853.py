"""Peer: right-hand sides in plain Python, solved by SciPy's DOP853.

The state is unpacked into Python floats by `tolist` and worked on with `math.sqrt`.
The usual small-array style (`np.cross`, `@`, `np.linalg.solve` on vectors of three)
is `rhs_arrays`: it gives the same numbers and was measured some 40 times slower per
call (130 against 3 us). `check.py` repeats that measurement. Both are peers.
"""

import time
from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from .problems import GRAVITY, INITIAL, PROBLEMS, PeerResult

_STAGES = 12  # right-hand sides of DOP853 per attempted step

Rhs = Callable[[float, np.ndarray], Any]
Floats = tuple[float, ...]


def rates(q: Floats, w: Floats, v: Floats) -> Floats:
    """Return q' and the horizontal velocity [m/s] from w [rad/s] and v_C in body axes.

    `q` is scalar first, body -> world.
    """
    q0, q1, q2, q3 = q
    wx, wy, wz = w
    vx, vy, vz = v
    return (
        0.5 * (-q1 * wx - q2 * wy - q3 * wz),
        0.5 * (q0 * wx + q2 * wz - q3 * wy),
        0.5 * (q0 * wy + q3 * wx - q1 * wz),
        0.5 * (q0 * wz + q1 * wy - q2 * wx),
        vx
        + 2.0
        * (
            -(q2 * q2 + q3 * q3) * vx
            + (q1 * q2 - q0 * q3) * vy
            + (q1 * q3 + q0 * q2) * vz
        ),
        vy
        + 2.0
        * (
            (q1 * q2 + q0 * q3) * vx
            - (q1 * q1 + q3 * q3) * vy
            + (q2 * q3 - q0 * q1) * vz
        ),
    )


def disc(problem: dict[str, Any]) -> Rhs:
    """Return the right-hand side of P2: on (e, t, e3), e from contact to centre."""
    mass, radius = problem["mass"], problem["surface"]["radius"]
    inertia = problem["inertia"]
    along = inertia[0][0]
    across = along + mass * radius**2
    axial = inertia[2][2] + mass * radius**2

    def rhs(_t: float, y: np.ndarray) -> Any:
        q0, q1, q2, q3, wx, wy, w3, _, _ = y.tolist()
        k1 = 2.0 * (q1 * q3 - q0 * q2)
        k2 = 2.0 * (q2 * q3 + q0 * q1)
        k3 = 1.0 - 2.0 * (q1 * q1 + q2 * q2)
        r = 1.0 / sqrt(k1 * k1 + k2 * k2)
        ex, ey = k1 * r, k2 * r
        we, wt = ex * wx + ey * wy, ex * wy - ey * wx
        speed = radius * (w3 - k3 * we * r)  # of the contact point, along t
        ae = (across - axial) / along * wt * w3
        moment = mass * radius * (GRAVITY * k3 - speed * we)
        at = (moment + (axial - along) * w3 * we) / across
        a3 = (along - across) / axial * we * wt
        v = (-radius * w3 * ey, radius * w3 * ex, -radius * wt)
        dq0, dq1, dq2, dq3, dx, dy = rates((q0, q1, q2, q3), (wx, wy, w3), v)
        ax, ay = ex * ae - ey * at, ey * ae + ex * at
        return (dq0, dq1, dq2, dq3, ax, ay, a3, dx, dy)

    return rhs


def rattleback(problem: dict[str, Any]) -> Rhs:
    """Return the right-hand side of P3, the 3x3 system solved by the adjugate."""
    mass, (_, _, height) = problem["mass"], problem["com"]
    s1, s2, s3 = (a * a for a in problem["surface"]["semi_axes"])
    (ixx, ixy, _), (_, iyy, _), (_, _, izz) = problem["inertia"]

    def rhs(_t: float, y: np.ndarray) -> Any:
        q0, q1, q2, q3, wx, wy, wz, _, _ = y.tolist()
        n1 = 2.0 * (q0 * q2 - q1 * q3)
        n2 = -2.0 * (q2 * q3 + q0 * q1)
        n3 = 2.0 * (q1 * q1 + q2 * q2) - 1.0
        # contact point rho, its velocity V in body axes, the arm c = r_C - rho
        p1, p2, p3 = n2 * wz - n3 * wy, n3 * wx - n1 * wz, n1 * wy - n2 * wx
        r = 1.0 / sqrt(s1 * n1 * n1 + s2 * n2 * n2 + s3 * n3 * n3)
        x1, x2, x3 = s1 * n1 * r, s2 * n2 * r, s3 * n3 * r
        rp = x1 * p1 + x2 * p2 + x3 * p3
        v1, v2 = (s1 * p1 - x1 * rp) * r, (s2 * p2 - x2 * rp) * r
        v3 = (s3 * p3 - x3 * rp) * r
        c1, c2, c3 = -x1, -x2, height - x3
        f1 = mass * (GRAVITY * n1 - (v2 * wz - v3 * wy))
        f2 = mass * (GRAVITY * n2 - (v3 * wx - v1 * wz))
        f3 = mass * (GRAVITY * n3 - (v1 * wy - v2 * wx))
        # inertia about the contact [[a, b, c], [b, e, f], [c, f, g]]
        a = ixx + mass * (c2 * c2 + c3 * c3)
        b, c = ixy - mass * c1 * c2, -mass * c1 * c3
        e, f = iyy + mass * (c1 * c1 + c3 * c3), -mass * c2 * c3
        g = izz + mass * (c1 * c1 + c2 * c2)
        l1, l2 = a * wx + b * wy + c * wz, b * wx + e * wy + f * wz
        l3 = c * wx + f * wy + g * wz
        m1 = c2 * f3 - c3 * f2 - (wy * l3 - wz * l2)
        m2 = c3 * f1 - c1 * f3 - (wz * l1 - wx * l3)
        m3 = c1 * f2 - c2 * f1 - (wx * l2 - wy * l1)
        j11, j12, j13 = e * g - f * f, c * f - b * g, b * f - c * e
        j22, j23, j33 = a * g - c * c, b * c - a * f, a * e - b * b
        i = 1.0 / (a * j11 + b * j12 + c * j13)
        a1 = i * (j11 * m1 + j12 * m2 + j13 * m3)
        a2 = i * (j12 * m1 + j22 * m2 + j23 * m3)
        a3 = i * (j13 * m1 + j23 * m2 + j33 * m3)
        v = (wy * c3 - wz * c2, wz * c1 - wx * c3, wx * c2 - wy * c1)
        dq0, dq1, dq2, dq3, dx, dy = rates((q0, q1, q2, q3), (wx, wy, wz), v)
        return (dq0, dq1, dq2, dq3, a1, a2, a3, dx, dy)

    return rhs


def rhs_arrays(problem: dict[str, Any]) -> Rhs:
    """Return the right-hand side in small-array NumPy style."""
    mass, com = problem["mass"], np.array(problem["com"])
    surface = problem["surface"]
    rim = surface["kind"] == "rim"
    # a rim is the support function of a flat ellipse: radius^2 in its plane, 0 across
    axes = [surface["radius"]] * 2 + [0.0] if rim else surface["semi_axes"]
    squares = np.square(axes)
    inertia, unit = np.array(problem["inertia"]), np.eye(3)

    def rhs(_t: float, y: np.ndarray) -> Any:
        q, w = y[:4], y[4:7]
        q0, qv = q[0], q[1:]
        skew = np.array([[0, -qv[2], qv[1]], [qv[2], 0, -qv[0]], [-qv[1], qv[0], 0]])
        rotation = unit + 2.0 * (q0 * skew + skew @ skew)
        n = -rotation[2]
        dn = np.cross(n, w)
        s = np.sqrt(n @ (squares * n))
        rho = squares * n / s
        velocity = (squares * dn - rho * (rho @ dn)) / s
        c = com - rho
        about = inertia + mass * ((c @ c) * unit - np.outer(c, c))
        force = mass * (GRAVITY * n - np.cross(velocity, w))
        moment = np.cross(c, force) - np.cross(w, about @ w)
        dq = 0.5 * np.concatenate(([-qv @ w], q0 * w + np.cross(qv, w)))
        moved = rotation @ np.cross(w, c)
        return np.concatenate((dq, np.linalg.solve(about, moment), moved[:2]))

    return rhs


RHS = {"P2": disc(PROBLEMS["P2"]), "P3": rattleback(PROBLEMS["P3"])}
ARRAYS = {name: rhs_arrays(problem) for name, problem in PROBLEMS.items()}


def solve(name: str, rtol: float, atol: float, arrays: bool = False) -> PeerResult:
    """Integrate a problem to its end; raise RuntimeError when it fails."""
    done = solve_ivp(
        (ARRAYS if arrays else RHS)[name],
        (0.0, PROBLEMS[name]["t_end"]),
        np.array(INITIAL[name]),
        method="DOP853",
        rtol=rtol,
        atol=atol,
    )
    if not done.success:
        raise RuntimeError(f"SciPy DOP853, {name}: {done.message}")
    accepted = len(done.t) - 1
    rejected = (done.nfev - 2) // _STAGES - accepted
    return PeerResult(done.y[:, -1].tolist(), accepted, rejected, done.nfev)


def seconds(
    name: str, rtol: float, atol: float, samples: int, arrays: bool = False
) -> list[float]:
    """Return `samples` wall times per solve [s]."""
    times = []
    for _ in range(samples):
        start = time.perf_counter()
        solve(name, rtol, atol, arrays)
        times.append(time.perf_counter() - start)
    return times
