"""Peer: diffrax on a right-hand side in the usual style of small arrays.

Quaternion, `jnp.cross`, `@` and `jnp.linalg.solve`, one motion at a time, `jax.vmap`
for a batch: what a user of JAX writes first.
"""

import diffrax as dfx
import jax.numpy as jnp
import numpy as np

from .problems import GRAVITY, PROBLEMS


def rhs_of(problem: dict):
    """Rates of quaternion, angular velocity (body axes), x and y of the mass centre."""
    mass, com = problem["mass"], jnp.array(problem["com"])
    inertia, surface = jnp.array(problem["inertia"]), problem["surface"]
    rim = surface["kind"] == "rim"
    axes = [surface["radius"]] * 2 + [0.0] if rim else surface["semi_axes"]
    squares = jnp.square(jnp.array(axes))

    def rhs(t, y, args):
        q, w = y[:4], y[4:7]
        q0, qv = q[0], q[1:]
        skew = jnp.array([[0, -qv[2], qv[1]], [qv[2], 0, -qv[0]], [-qv[1], qv[0], 0]])
        rotation = jnp.eye(3) + 2.0 * (q0 * skew + skew @ skew)
        n = -rotation[2]
        turning = jnp.cross(n, w)
        s = jnp.sqrt(n @ (squares * n))
        rho = squares * n / s
        velocity = (squares * turning - rho * (rho @ turning)) / s
        c = com - rho
        about = inertia + mass * ((c @ c) * jnp.eye(3) - jnp.outer(c, c))
        force = mass * (GRAVITY * n - jnp.cross(velocity, w))
        moment = jnp.cross(c, force) - jnp.cross(w, about @ w)
        rates = 0.5 * jnp.concatenate([-(qv @ w)[None], q0 * w + jnp.cross(qv, w)])
        moved = rotation @ jnp.cross(w, c)
        return jnp.concatenate([rates, jnp.linalg.solve(about, moment), moved[:2]])

    return rhs


def solver_of(name: str, end: float, rtol: float):
    """A function of a start that gives the end of the motion."""
    term = dfx.ODETerm(rhs_of(PROBLEMS[name]))

    def solve(start):
        solution = dfx.diffeqsolve(
            term,
            dfx.Tsit5(),
            0.0,
            end,
            1e-3,
            start,
            stepsize_controller=dfx.PIDController(rtol=rtol, atol=0.01 * rtol),
            max_steps=1_000_000,
        )
        return solution.ys[0], solution.stats["num_steps"]

    return solve


def end_of(y) -> list[float]:
    """The end as plain numbers, the quaternion of length one."""
    y = np.array(y)
    y[:4] /= np.linalg.norm(y[:4])
    return y.tolist()
