"""The test problem of the collected equations, section 10, in lines of curvature."""

import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.geometry.rotations import rotation_matrix

DATA = Path(__file__).parent / "data"


def curvature_chart(semi_axes):
    """First octant of an ellipsoid by its lines of curvature, (u, v)."""
    A, B, C = (x * x for x in semi_axes)

    def position(q):
        u, v = q[0], q[1]
        return jnp.stack(
            [
                jnp.sqrt(A * (A - u) * (A - v) / ((A - B) * (A - C))),
                jnp.sqrt(B * (B - u) * (B - v) / ((B - A) * (B - C))),
                jnp.sqrt(C * (C - u) * (C - v) / ((C - A) * (C - B))),
            ]
        )

    return position


def turning(t, parameters):
    """A rotation with the given angular velocity and acceleration at t = 0."""
    spin, change = parameters["spin"], parameters["change"]
    half = 0.5 * (spin * t + 0.5 * change * t * t)
    return rotation_matrix(jnp.concatenate([jnp.ones(1, half.dtype), half]))


def moving(t, parameters):
    return parameters["velocity"] * t + 0.5 * parameters["acceleration"] * t * t


def moving_base(velocity, acceleration, spin, change):
    """A base with given derivatives of its motion at t = 0, both axes agreeing."""
    parameters = {
        "velocity": jnp.asarray(velocity),
        "acceleration": jnp.asarray(acceleration),
        "spin": jnp.asarray(spin),
        "change": jnp.asarray(change),
    }
    return rk.BaseMotion(moving, turning, parameters)


BODY_AXES, BASE_AXES = (1.3, 1.0, 0.7), (4.0, 3.3, 2.5)
MASS_PLACE = lambda a: jnp.stack(
    [jnp.stack([0.2 + 0.1 * a[0], 0.3 * jnp.sin(a[0]), 0.4 * jnp.cos(a[0])])]
)


def scene_and_state(sign: int):
    body = rk.Body(
        mass=2.0,
        center_of_mass=(0.1, -0.05, 0.08),
        inertia=[[0.5, 0.02, -0.01], [0.02, 0.6, 0.03], [-0.01, 0.03, 0.7]],
        surface=rk.Parametric(
            curvature_chart(BODY_AXES), domain=((1.01, 1.68), (0.5, 0.99))
        ),
    )
    base = rk.Parametric(
        curvature_chart(BASE_AXES),
        domain=((10.9, 15.9), (6.3, 10.8)),
        inside=sign > 0,
    )
    motion = moving_base(
        (0.3, -0.2, 0.5), (0.2, 0.1, -0.4), (0.4, 0.1, -0.3), (-0.2, 0.3, 0.1)
    )
    carried = rk.PointMasses([0.5], MASS_PLACE, lambda t, a, a_dot: -1.5 * a)
    scene = rk.Scene(
        body, rk.Base(base, motion), carried, (rk.Gravity((0.5, -1.0, -9.7)),)
    )
    state = rk.VoronetsState(
        contact_on_body=jnp.array([1.35, 0.8]),
        contact_on_base=jnp.array([13.0, 8.0]),
        angle=jnp.asarray(0.7),
        angular_velocity=jnp.array([0.8, -0.6, 1.1]),
        alpha=jnp.array([0.4]),
        alpha_dot=jnp.array([0.9]),
        sign=sign,
    )
    return scene, state


def printed_values() -> dict[str, tuple[float, float]]:
    """Quantity -> (value for s = +1, value for s = -1)."""
    values = {}
    for line in (DATA / "section10.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 3 and re.fullmatch(r"-?\d+\.\d{12}", cells[1]):
            values[cells[0]] = float(cells[1]), float(cells[2])
    return values


def chart_values() -> dict[str, np.ndarray]:
    """a11, a22, b11, b22, d2 a11, d1 a22 of body (S) and base (Sc)."""
    values = {}
    for line in (DATA / "section10.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 7 and cells[0] in ("S", "Sc"):
            values[cells[0]] = np.array([float(x) for x in cells[1:]])
    return values
