"""Peer: SymPy's KanesMethod, lambdified, solved by SciPy; P2 and P3.

Written as SymPy's users write it: Euler angles, angular velocity on body axes as
speeds, the constraint eliminated by the velocity of the mass centre from the contact.

    python benchmarks/peers/sympy_rolling.py

prints rows as JSON: error against time, with deriving and lambdifying apart.
"""

import json
import statistics
import sys
import time
from pathlib import Path

import numpy as np
import sympy as sp
import sympy.physics.mechanics as me
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from peers.problems import GRAVITY, INITIAL, PROBLEMS, end_error

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
# axes and angles at the start: sequences whose poles these motions do not meet
ANGLES = {
    "P2": ("ZXZ", (0.0, np.deg2rad(70.0), 0.0)),
    "P3": ("XYZ", (np.deg2rad(0.5), np.deg2rad(0.5), 0.0)),
}


def derived(problem: dict, sequence: str):
    """Right-hand side of (angles, speeds, x, y) as a NumPy function."""
    angles, speeds = me.dynamicsymbols("q1:4"), me.dynamicsymbols("u1:4")
    fixed, body = me.ReferenceFrame("N"), me.ReferenceFrame("B")
    body.orient_body_fixed(fixed, angles, sequence)
    turning = body.ang_vel_in(fixed)
    spin = sum((u * e for u, e in zip(speeds, body, strict=True)), me.Vector(0))
    slopes = [q.diff() for q in angles]
    turns = sp.Matrix([turning.dot(e) for e in body]).jacobian(slopes)
    # left to SymPy, the inverse would divide by the sine of an angle that begins at 0
    inverse = turns.adjugate() / sp.trigsimp(turns.det())
    known_rates = list(inverse * sp.Matrix(speeds))
    kinematics = [a - b for a, b in zip(slopes, known_rates, strict=True)]
    rates = dict(zip(slopes, known_rates, strict=True))
    body.set_ang_vel(fixed, spin)

    up = [fixed.z.dot(e) for e in body]
    surface, com = problem["surface"], problem["com"]
    if surface["kind"] == "rim":
        scale = surface["radius"] / sp.sqrt(up[0] ** 2 + up[1] ** 2)
        point = [-scale * up[0], -scale * up[1], 0]
    else:
        half = surface["semi_axes"]
        size = sp.sqrt(sum((a * k) ** 2 for a, k in zip(half, up, strict=True)))
        point = [-a * a * k / size for a, k in zip(half, up, strict=True)]
    arm = sum(
        ((c - p) * e for c, p, e in zip(com, point, body, strict=True)), me.Vector(0)
    )
    centre = me.Point("C")
    velocity = spin.cross(arm)
    centre.set_vel(fixed, velocity)
    moving = velocity.diff(me.dynamicsymbols._t, body) + spin.cross(velocity)
    centre.set_acc(fixed, moving.subs(rates))

    (a, d, e), (_, b, f), (_, _, c) = problem["inertia"]
    inertia = (me.inertia(body, a, b, c, d, f, e), centre)
    stone = me.RigidBody("S", centre, body, problem["mass"], inertia)
    weight = (centre, -problem["mass"] * GRAVITY * fixed.z)
    kane = me.KanesMethod(fixed, q_ind=angles, u_ind=speeds, kd_eqs=kinematics)
    kane.kanes_equations([stone], [weight])
    horizontal = [velocity.dot(axis) for axis in (fixed.x, fixed.y)]
    known = [*angles, *speeds]
    matrix = sp.lambdify(known, kane.mass_matrix_full, cse=True)
    forcing = sp.lambdify(known, kane.forcing_full, cse=True)
    moved = sp.lambdify(known, horizontal, cse=True)

    def rhs(_t, y):
        solved = np.linalg.solve(matrix(*y[:6]), forcing(*y[:6]))
        return np.concatenate([solved[:, 0], moved(*y[:6])])

    return rhs


def quaternion_of(sequence: str, angles) -> list[float]:
    """The unit quaternion of turns about body-fixed axes, one after the other."""
    a, v = 1.0, np.zeros(3)
    for axis, angle in zip(sequence, angles, strict=True):
        c, w = np.cos(angle / 2), np.zeros(3)
        w["XYZ".index(axis)] = np.sin(angle / 2)
        a, v = a * c - v @ w, a * w + c * v + np.cross(v, w)
    return [a, *v]


def main() -> None:
    """Derive, run, print."""
    rows = []
    for name, problem in PROBLEMS.items():
        began = time.perf_counter()
        sequence, angles = ANGLES[name]
        rhs = derived(problem, sequence)
        building = time.perf_counter() - began
        start = INITIAL[name]
        y0 = [*angles, *start[4:7], 0.0, 0.0]
        assert np.allclose(quaternion_of(sequence, angles), start[:4])
        assert np.isfinite(rhs(0.0, np.array(y0))).all()
        for rtol in TOLERANCES:
            spans = []
            for _ in range(3):
                began = time.perf_counter()
                end = solve_ivp(
                    rhs, (0, problem["t_end"]), y0, "DOP853", rtol=rtol, atol=rtol / 100
                )
                spans.append(time.perf_counter() - began)
                if spans[-1] > 3.0:
                    break
            y = [*quaternion_of(sequence, end.y[:3, -1]), *end.y[3:, -1]]
            error = end_error(problem, y)
            rows.append(
                {
                    "problem": name,
                    "peer": "SymPy Kane + SciPy DOP853",
                    "setting": f"rtol {rtol:.0e}",
                    "error": max(error.position, error.rotation),
                    "seconds": statistics.median(spans),
                    "steps": len(end.t) - 1,
                    "first": building,
                }
            )
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
