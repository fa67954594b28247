"""Peer: MuJoCo's soft contact on the ball on a turntable (P1), the disc and rattleback.

A script for a virtual environment of its own with numpy and mujoco. The last line of
its output is a JSON list, one row per problem and setting.

`tuned` is the best found for rolling without slip: an elliptic friction cone, a large
friction coefficient, the stiffest contact the step allows (time constant of two steps,
critically damped) and a tight solver. `defaults` leaves all of that to MuJoCo.
"""

import json
import math
import statistics
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from peers.problems import GRAVITY, INITIAL, PROBLEMS, arm, end_error

THIN = 1e-6  # half thickness of the disc [m]: a cylinder must have one
REPEATS, LONG = 3, 3.0  # timed runs; a run over LONG seconds is not repeated
SETTINGS = (
    ("Euler", "defaults", 1e-3, ("P1", "P2", "P3")),
    ("Euler", "tuned", 1e-3, ("P1", "P2", "P3")),
    ("Euler", "tuned", 1e-4, ("P1", "P2", "P3")),
    ("Euler", "tuned", 1e-5, ("P3",)),
    ("RK4", "tuned", 1e-3, ("P1", "P2", "P3")),
    ("RK4", "tuned", 1e-4, ("P1", "P2", "P3")),
)

# P1: a ball of mass 1 kg on a turntable about the vertical through the origin
RADIUS, RATE, T_BALL = 0.1, 3.0, 10.0  # [m], [rad/s], [s]
PLACE, SPEED = 0.3, 0.2  # the centre starts at x = PLACE [m] with v_y = SPEED [m/s]
# Without slip the ball's lowest point moves with the table, hence its angular velocity
ROLL = (RATE * PLACE - SPEED) / RADIUS

PLANE = '<geom type="plane" size="5 5 1"/>'
# The inertia is large, so that the ball does not change the rate of the turntable
TABLE = """<body pos="0 0 -0.1">
<joint name="table" type="hinge" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1e8 1e8 1e8"/>
<geom type="box" size="1 1 0.1"/></body>"""


def numbers(values):
    """Return numbers as an attribute of the model's XML, to the last digit."""
    return " ".join(repr(float(v)) for v in values)


def options(integrator, tuned, dt):
    """Return the model's options and its defaults for geoms."""
    extra, geom = "", 'condim="3"'
    if tuned:
        extra = 'cone="elliptic" impratio="100" solver="Newton" tolerance="1e-12"'
        geom += f' friction="10 0.005 0.0001" solref="{numbers((2.0 * dt, 1.0))}"'
    return (
        f'<option timestep="{dt!r}" integrator="{integrator}" '
        f'gravity="0 0 {-GRAVITY!r}" {extra}/><default><geom {geom}/></default>'
    )


def body(mass, inertia, geom):
    """Return a free body whose origin is its centre of mass.

    `inertia` is xx, yy, zz, xy, xz, yz [kg m^2].
    """
    return (
        f'<body><freejoint name="free"/><inertial pos="0 0 0" mass="{mass!r}" '
        f'fullinertia="{numbers(inertia)}"/><geom {geom}/></body>'
    )


def rolling_body(problem):
    """Return the body of P2 or P3."""
    surface = problem["surface"]
    if surface["kind"] == "rim":
        shape, size = "cylinder", (surface["radius"], THIN)
    else:
        shape, size = "ellipsoid", surface["semi_axes"]
    centre = numbers(-c for c in problem["com"])
    geom = f'type="{shape}" size="{numbers(size)}" pos="{centre}"'
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = problem["inertia"]
    return body(problem["mass"], (xx, yy, zz, xy, xz, yz), geom)


def ball():
    """Return the body of P1, homogeneous."""
    moment = 0.4 * RADIUS**2
    geom = f'type="sphere" size="{RADIUS!r}"'
    return body(1.0, (moment, moment, moment, 0.0, 0.0, 0.0), geom)


def compiled(head, world):
    """Return the compiled model."""
    xml = f"<mujoco>{head}<worldbody>{world}</worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(xml)


def place(data, position, orientation, velocity, omega):
    """Set the free body; `omega` is in body axes, all else in world axes."""
    free = data.joint("free")
    free.qpos[:] = (*position, *orientation)
    free.qvel[:] = (*velocity, *omega)


def start_ball(data):
    """Set P1's initial state."""
    data.joint("table").qvel[0] = RATE
    upright = (1.0, 0.0, 0.0, 0.0)
    position, velocity = (PLACE, 0.0, RADIUS), (0.0, SPEED, 0.0)
    place(data, position, upright, velocity, (ROLL, 0.0, 0.0))


def start_rolling(data, problem):
    """Set the initial state of P2 or P3: touching, the contact point at rest."""
    y = np.array(INITIAL[problem["name"]])
    orientation, omega = y[:4], y[4:7]
    velocity = np.empty(3)
    # without slip the centre of mass turns about the contact point
    mujoco.mju_rotVecQuat(velocity, np.cross(omega, arm(problem, y)), orientation)
    place(data, problem["position"], orientation, velocity, omega)


def ball_error(data):
    """Return the distance from the exact end [m]: the centre goes round a circle."""
    rate = 2.0 / 7.0 * RATE
    angle, radius = rate * T_BALL, SPEED / rate
    exact = PLACE + radius * (math.cos(angle) - 1.0), radius * math.sin(angle)
    return math.dist(exact, data.joint("free").qpos[:2])


def rolling_error(data, problem):
    """Return the larger of the errors of place [m] and of orientation [rad]."""
    free = data.joint("free")
    error = end_error(problem, [*free.qpos[3:], *free.qvel[3:], *free.qpos[:2]])
    return max(error.position, error.rotation)


def run(name, head, dt):
    """Run a problem once; return its error, the wall time of the loop and the steps."""
    problem = PROBLEMS.get(name)  # none for P1
    world = PLANE + rolling_body(problem) if problem else TABLE + ball()
    model = compiled(head, world)
    data = mujoco.MjData(model)
    if problem:
        start_rolling(data, problem)
    else:
        start_ball(data)
    steps = round((problem["t_end"] if problem else T_BALL) / dt)
    begin = time.perf_counter()
    mujoco.mj_step(model, data, nstep=steps)
    seconds = time.perf_counter() - begin
    error = rolling_error(data, problem) if problem else ball_error(data)
    return error, seconds, steps


def row(name, integrator, style, dt):
    """Return one row of the table, its time the median of the runs."""
    head = options(integrator, style == "tuned", dt)
    error, first, steps = run(name, head, dt)
    times = [first]
    if first < LONG:
        times += [run(name, head, dt)[1] for _ in range(REPEATS - 1)]
    return {
        "problem": name,
        "peer": f"MuJoCo {integrator}, {style}",
        "setting": f"dt 1e-{round(-math.log10(dt))}",
        "error": error,
        "seconds": statistics.median(times),
        "steps": steps,
    }


def main():
    """Run all settings and print the rows."""
    rows = [
        row(name, integrator, style, dt)
        for integrator, style, dt, names in SETTINGS
        for name in names
    ]
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
