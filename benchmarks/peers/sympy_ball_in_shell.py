"""A ball in a shell that rolls on a plane, derived and run by SymPy's Kane's method.

    python benchmarks/peers/sympy_ball_in_shell.py [--seconds T]

The shell has three moments of inertia, the ball a mass centre beside its own centre.
Speeds are both angular velocities on the bodies' axes, coordinates two quaternions, the
direction from the shell's centre to the contact (fixed axes) and the shell's place.
Prints the time to derive and to make functions, and of a run by SciPy's DOP853 at rtol
1e-9, as JSON.
"""

import argparse
import json
import time

import numpy as np
import sympy
from scipy.integrate import solve_ivp
from sympy.physics import mechanics as me

M, m, R, r, g = 1.0, 0.7, 0.3, 0.1, 9.81
I1, I2 = (0.05, 0.045, 0.055), 2.8e-3
CENTER = (0.01, 0.02, -0.015)
SHELL_W, U = (0.5, 1.0, 2.0), (1.3, 0.7, -0.5)


def derived():
    """Mass matrix, forcing and rates of the coordinates, as one NumPy function."""
    n = me.dynamicsymbols("n1:4")
    x = me.dynamicsymbols("x1:3")
    p, q = me.dynamicsymbols("p0:4"), me.dynamicsymbols("q0:4")
    u = me.dynamicsymbols("u1:7")
    t = me.dynamicsymbols._t
    N = me.ReferenceFrame("N")
    frames, known = [], {}
    for name, unit, w in (("A", p, u[:3]), ("B", q, u[3:])):
        frame = N.orientnew(name, "Quaternion", unit)
        frame.set_ang_vel(
            N, sum((a * e for a, e in zip(w, frame, strict=True)), 0 * N.x)
        )
        s, v = unit[0], sympy.Matrix(unit[1:])
        w = sympy.Matrix(w)
        moved = (s * w + v.cross(w)) / 2
        known |= dict(
            zip([a.diff(t) for a in unit], (-v.dot(w) / 2, *moved), strict=True)
        )
        frames.append(frame)
    A, B = frames
    w1, w2 = A.ang_vel_in(N), B.ang_vel_in(N)
    out = n[0] * N.x + n[1] * N.y + n[2] * N.z
    C1, C2 = me.Point("C1"), me.Point("C2")
    v1 = w1.cross(R * N.z)
    C1.set_vel(N, v1)
    v_ball = v1 + w1.cross(R * out) - w2.cross(r * out)
    arm = sum((c * e for c, e in zip(CENTER, B, strict=True)), 0 * N.x)
    C2.set_vel(N, v_ball + w2.cross(arm))
    rates = [(v_ball - v1).dot(e) / (R - r) for e in N] + [v1.dot(N.x), v1.dot(N.y)]
    known |= dict(zip([a.diff(t) for a in (*n, *x)], rates, strict=True))
    bodies = [
        me.RigidBody("shell", C1, A, M, (me.inertia(A, *I1), C1)),
        me.RigidBody("ball", C2, B, m, (me.inertia(B, I2, I2, I2), C2)),
    ]
    loads = [(C1, -M * g * N.z), (C2, -m * g * N.z)]
    places = [*p, *q, *n, *x]
    kane = me.KanesMethod(
        N,
        q_ind=places,
        u_ind=list(u),
        kd_eqs=[a.diff(t) - known[a.diff(t)] for a in places],
        bodies=bodies,
        forcelist=loads,
    )
    kane.kanes_equations()
    matrix, forcing = kane.mass_matrix.subs(known), kane.forcing.subs(known)
    moved = sympy.Matrix([known[a.diff(t)] for a in places])
    return sympy.lambdify([[*places, *u]], [matrix, forcing, moved], cse=True)


def main():
    """Derive, run, and say how long it took."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    seconds = parser.parse_args().seconds
    began = time.perf_counter()
    function = derived()
    built = time.perf_counter() - began

    def rates(t, y):
        matrix, forcing, moved = function(y)
        return np.concatenate([moved.ravel(), np.linalg.solve(matrix, forcing).ravel()])

    w2 = np.add(SHELL_W, U)
    straight, down = np.eye(4)[0], (0.0, 0.0, -1.0)
    start = np.concatenate([straight, straight, down, [0.0, 0.0], SHELL_W, w2])
    times = np.linspace(0.0, seconds, 11)
    began = time.perf_counter()
    run = solve_ivp(
        rates, (0.0, seconds), start, "DOP853", times, rtol=1e-9, atol=1e-11
    )
    ran = time.perf_counter() - began
    last = run.y[:, -1]
    centre = np.array([*last[11:13], R]) + (R - r) * last[8:11]
    print(json.dumps({"build": built, "run": ran, "ball": centre.tolist()}))


if __name__ == "__main__":
    main()
