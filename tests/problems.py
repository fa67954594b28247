"""Scenes with known answers: reference cases, the benchmark problems, and their makers.

The reference trajectories in tests/data were computed from first principles by code
that shares nothing with rollkane (see tests/data/README.md).
"""

import functools
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import rollkane as rk

DATA = Path(__file__).parent / "data"
# records of c22, which may not be redistributed
RECORDS = Path(__file__).parents[2] / "shared" / "data"
CASES = ("c09", "c13", "c14d", "c16", "c24", "x01")


def surface_of(entry: dict):
    kind = entry["kind"]
    if kind == "ellipsoid":
        return rk.Ellipsoid(entry["semi_axes"], entry["center_body"])
    if kind == "sphere":
        return rk.Sphere(entry["radius"], entry["center_body"])
    if kind == "sphere_outside":
        return rk.Sphere(entry["radius"], entry["center_base"])
    if kind == "disc_edge":
        return rk.DiscEdge(entry["radius"])
    assert kind == "plane"
    return rk.Plane()


@functools.cache
def load(name: str) -> dict:
    return json.loads((DATA / f"{name}.json").read_text())


def reference_case(name: str):
    """Scene, start and reference of a case in tests/data."""
    case = load(name)
    body = case["body"]
    scene = rk.Scene(
        rk.Body(
            mass=body["mass"],
            inertia=body["inertia_com_body"],
            surface=surface_of(body["surface"]),
            center_of_mass=body["com_body"],
        ),
        rk.Base(surface_of(case["base"])),
        loads=(rk.Gravity(case["gravity"]),),
    )
    initial = case["initial"]
    start = rk.place(
        scene, initial["quaternion"], initial["omega_inertial"], initial["contact_base"]
    )
    return scene, start, case


def moving_case(name: str):
    """Scene, start and reference of a case with a moving base or masses inside."""
    case = load(name)
    body, motion, supported = case["body"], None, ()
    alpha = ((), ())
    moves = case["base"]["motion"]
    if moves["kind"] == "spin_about_base_z":
        motion = rk.Spin(moves["Omega"])
    elif moves["kind"] == "translate":
        count = moves["n_samples"]
        x, y = (rk.read_at2(RECORDS / moves[name]) for name in ("record_x", "record_y"))
        motion = rk.RecordedMotion(
            x.time[:count],
            np.concatenate([a.acceleration[:count] for a in (x, y)], axis=1),
        )
    if case["internal_parts"]:
        (part,) = case["internal_parts"]
        arm, stiffness = part["length"], part["torsion_spring"]
        supported = rk.PointMasses(
            [part["mass"]],
            lambda a: jnp.stack(
                [arm * jnp.stack([jnp.sin(a[0]), 0.0 * a[0], -jnp.cos(a[0])])]
            ),
            potential=lambda a: 0.5 * stiffness * a[0] ** 2,
        )
        angle, rate = case["initial"]["internal_state"]
        alpha = (angle,), (rate,)
    scene = rk.Scene(
        rk.Body(
            mass=body["mass"],
            inertia=body["inertia_com_body"],
            surface=surface_of(body["surface"]),
            center_of_mass=body["com_body"],
        ),
        rk.Base(rk.Plane(), motion),
        supported,
        (rk.Gravity(case["gravity"]),),
    )
    initial = case["initial"]
    start = rk.place(
        scene,
        initial["quaternion"],
        initial["omega_inertial"],
        initial["contact_base"],
        *alpha,
    )
    return scene, start, case


def turn(axis: int, degrees: float) -> np.ndarray:
    half = 0.5 * np.deg2rad(degrees)
    quaternion = np.zeros(4)
    quaternion[0], quaternion[1 + axis] = np.cos(half), np.sin(half)
    return quaternion


def product(p, q) -> np.ndarray:
    a, b, c, d = p
    e, f, g, h = q
    return np.array(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ]
    )


def quaternion(R):
    """Shepperd's method: divides by the largest component only."""
    K = np.array(
        [
            [np.trace(R), R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [0, 2 * R[0, 0] - np.trace(R), R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]],
            [0, 0, 2 * R[1, 1] - np.trace(R), R[1, 2] + R[2, 1]],
            [0, 0, 0, 2 * R[2, 2] - np.trace(R)],
        ]
    )
    K = np.triu(K) + np.triu(K, 1).T
    largest = np.argmax(np.diag(K))
    q = K[largest] + np.eye(4)[largest]
    return q / np.linalg.norm(q)


def matrix(q) -> np.ndarray:
    w, v = q[0], np.asarray(q[1:])
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * K + 2 * K @ K


def disc(spin=None, radius=0.25):
    """P2: thin sharp disc on a plane, J = x of the centre; spin is body omega_3."""
    spin = 6.0 + 1.5 * np.cos(np.deg2rad(70.0)) if spin is None else spin
    scene = rk.Scene(
        rk.Body(
            mass=1.0,
            inertia=np.diag([0.25, 0.25, 0.5]) * radius**2,
            surface=rk.DiscEdge(radius),
        )
    )
    q = turn(0, 70.0)
    omega = jnp.stack(
        [
            jnp.asarray(0.0),
            jnp.asarray(1.5 * np.sin(np.deg2rad(70.0))),
            jnp.asarray(spin),
        ]
    )
    contact = matrix(q) @ [0.0, -radius, 0.0]
    start = rk.place(
        scene, q, jnp.asarray(matrix(q)) @ omega, [contact[0], contact[1], 0.0]
    )
    return scene, start


def rattleback(spin=None):
    """P3: Kane and Levinson's stone; spin is body omega_3 (None: the given start)."""
    scene = rk.Scene(
        rk.Body(
            mass=1.0,
            inertia=[[2e-4, -2e-5, 0.0], [-2e-5, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]],
            surface=rk.Ellipsoid((0.2, 0.03, 0.02)),
            center_of_mass=(0.0, 0.0, -0.01),
        )
    )
    q = product(turn(0, 0.5), turn(1, 0.5))
    R = matrix(q)
    omega = jnp.asarray(R.T @ [0.0, 0.0, -5.0])
    if spin is not None:
        omega = jnp.stack([omega[0], omega[1], jnp.asarray(spin)])
    normal = -R.T @ [0.0, 0.0, 1.0]
    squares = np.array([0.2, 0.03, 0.02]) ** 2
    rho = squares * normal / np.sqrt(normal @ (squares * normal))
    contact = R @ (rho - [0.0, 0.0, -0.01])  # centre of mass starts above the origin
    start = rk.place(scene, q, jnp.asarray(R) @ omega, [contact[0], contact[1], 0.0])
    return scene, start


def mass_centre(result: rk.Trajectory):
    """Mass centre at every time, fixed axes [m]."""
    R = jnp.stack([jnp.asarray(matrix(q)) for q in np.asarray(result.orientation)])
    return result.position + R @ result.scene.body.center_of_mass


def quaternion_error(q, reference) -> np.ndarray:
    """Largest component difference, whatever the sign, by sample."""
    q, reference = np.asarray(q), np.asarray(reference)
    return np.minimum(
        np.abs(q - reference).max(axis=-1), np.abs(q + reference).max(axis=-1)
    )
