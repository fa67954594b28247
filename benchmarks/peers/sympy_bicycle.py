"""Whipple's bicycle by SymPy's KanesMethod: the model and the matrices of rollkane's.

Written as SymPy's users write it, with the choices that SymPy's own test of this model
makes for speed (Cramer's rule, wheels without angles, an operating point given before
the linearization).
"""

import math

import numpy as np
import sympy as sp
import sympy.physics.mechanics as me

TILT = math.pi / 10
VALUES = {
    "tilt": TILT, "g": 9.81,
    "r_rear": 0.3, "m_rear": 2.0, "rear_xx": 0.0603, "rear_yy": 0.12,
    "m_frame": 85.0, "frame_xx": 9.2, "frame_yy": 11.0, "frame_zz": 2.8,
    "frame_xz": 2.4, "m_fork": 4.0, "fork_xx": 0.05892, "fork_yy": 0.06,
    "fork_zz": 0.00708, "fork_xz": -0.00756,
    "r_front": 0.35, "m_front": 3.0, "front_xx": 0.1405, "front_yy": 0.28,
}  # fmt: skip


def tilted(x, z):
    """Across and along the steering axis."""
    s, c = math.sin(TILT), math.cos(TILT)
    return x * c - z * s, x * s + z * c


# from the rear axle to the steering axis; then places, from the rear axle or from there
HEAD = tilted(1.02 + 0.08, 0.3)[0]
VALUES["head_x"] = HEAD
for name, place, origin in (
    ("frame", (0.3, -0.9 + 0.3), 0.0),
    ("fork", (0.9, -0.7 + 0.3), HEAD),
    ("front", (1.02, -0.35 + 0.3), HEAD),
):
    across, along = tilted(*place)
    VALUES[f"{name}_x"], VALUES[f"{name}_z"] = across - origin, along


def model():
    """KanesMethod of the bicycle, its symbols, and its operating point."""
    p = {name: sp.Symbol(name) for name in VALUES}
    q = yaw, lean, pitch, steer = me.dynamicsymbols("yaw lean pitch steer")
    names = "u_yaw u_lean u_pitch u_steer u_rear u_front"
    u = u_yaw, u_lean, u_pitch, u_steer, u_rear, u_front = me.dynamicsymbols(names)
    N = me.ReferenceFrame("N")
    heading = N.orientnew("heading", "Axis", [yaw, N.z])
    leaning = heading.orientnew("leaning", "Axis", [lean, heading.x])
    # axes along the steering axis, so that steering is an elementary rotation
    frame = leaning.orientnew("frame", "Axis", [pitch + p["tilt"], leaning.y])
    fork = frame.orientnew("fork", "Axis", [steer, frame.z])
    frame_level = frame.orientnew("frame_level", "Axis", [-p["tilt"], frame.y])
    fork_level = fork.orientnew("fork_level", "Axis", [-p["tilt"], fork.y])
    rear, front = me.ReferenceFrame("rear"), me.ReferenceFrame("front")
    heading.set_ang_vel(N, u_yaw * heading.z)
    leaning.set_ang_vel(heading, u_lean * leaning.x)
    frame.set_ang_vel(leaning, u_pitch * frame.y)
    fork.set_ang_vel(frame, u_steer * fork.z)
    rear.set_ang_vel(frame, u_rear * frame.y)
    front.set_ang_vel(fork, u_front * fork.y)

    contact = me.Point("contact")
    rear_axle = contact.locatenew("rear_axle", -p["r_rear"] * leaning.z)
    head = rear_axle.locatenew("head", p["head_x"] * frame.x)

    def placed(origin, axes, name):
        x, z = p[f"{name}_x"], p[f"{name}_z"]
        return origin.locatenew(name, x * axes.x + z * axes.z)

    frame_centre = placed(rear_axle, frame, "frame")
    fork_centre = placed(head, fork, "fork")
    front_axle = placed(head, fork, "front")
    in_wheel = N.z - me.dot(fork.y, N.z) * fork.y
    touching = front_axle.locatenew("touching", p["r_front"] * in_wheel.normalize())
    contact.set_vel(N, 0)
    rear_axle.v2pt_theory(contact, N, rear)
    head.v2pt_theory(rear_axle, N, frame)
    frame_centre.v2pt_theory(rear_axle, N, frame)
    fork_centre.v2pt_theory(head, N, fork)
    front_axle.v2pt_theory(head, N, fork)
    touching.v2pt_theory(front_axle, N, front)

    def inertia(axes, name):
        xx, yy = p[f"{name}_xx"], p[f"{name}_yy"]
        zz = p.get(f"{name}_zz", xx)
        return me.inertia(axes, xx, yy, zz, izx=p.get(f"{name}_xz", 0))

    parts = [
        ("frame", frame_centre, frame, frame_level),
        ("fork", fork_centre, fork, fork_level),
        ("rear", rear_axle, rear, frame),
        ("front", front_axle, front, fork),
    ]
    bodies = [
        me.RigidBody(name, point, turns, p[f"m_{name}"], (inertia(axes, name), point))
        for name, point, turns, axes in parts
    ]
    weights = [(b.masscenter, b.mass * p["g"] * N.z) for b in bodies]
    slip = touching.vel(N)
    kane = me.KanesMethod(
        N,
        q_ind=[yaw, lean, steer],
        q_dependent=[pitch],
        configuration_constraints=[me.dot(touching.pos_from(contact), N.z)],
        u_ind=[u_lean, u_rear, u_steer],
        u_dependent=[u_yaw, u_pitch, u_front],
        velocity_constraints=[me.dot(slip, axis) for axis in heading],
        kd_eqs=[a.diff() - b for a, b in zip(q, u[:4], strict=True)],
        constraint_solver="CRAMER",
    )
    kane.kanes_equations(bodies, weights)
    speed = sp.Symbol("v")
    point = {x.diff(): 0 for x in u} | {x: 0 for x in (*q, *u)}
    point |= {u_rear: -speed / p["r_rear"], u_front: -speed / p["r_front"]}
    return kane, p, point, speed


def matrices(speeds) -> list:
    """A of (lean, steer, their rates) at each speed [m/s]."""
    kane, p, point, speed = model()
    A, _, _ = kane.linearize(A_and_B=True, op_point=point, linear_solver="CRAMER")
    values = {p[name]: value for name, value in VALUES.items()}
    A = A.xreplace(values).evalf().extract([1, 2, 3, 5], [1, 2, 3, 5])
    return [np.array(A.xreplace({speed: v}).evalf(), float).tolist() for v in speeds]
