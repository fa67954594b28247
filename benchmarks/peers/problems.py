"""The two rolling problems of the peers, their exact data and error measures.

P2 is a thin sharp-edged disc on a horizontal plane, P3 the rattleback of Kane and
Levinson (1982). The plane is z = 0, z points up and the acceleration of free fall is
``GRAVITY`` [m/s^2].

A peer state is 9 numbers: unit quaternion, scalar first, body -> world (4); angular
velocity in body axes [rad/s] (3); x and y of the centre of mass [m] (2). The height of
the centre of mass follows from the contact.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

GRAVITY = 9.81

State = Sequence[float]
Vector = tuple[float, float, float]


class PeerResult(NamedTuple):
    """What a peer returns: the end state, steps and right-hand sides."""

    y_end: list[float]
    accepted: int
    rejected: int
    rhs: int


class EndError(NamedTuple):
    """Errors at the end: position [m], rotation [rad], relative energy [1]."""

    position: float
    rotation: float
    energy: float


def _half_angle(degrees: float) -> tuple[float, float]:
    """Return cos and sin of half of an angle [deg]."""
    half = math.radians(degrees) / 2.0
    return math.cos(half), math.sin(half)


def vertical(y: State) -> Vector:
    """Return the upward vertical in body axes, R^T e_z [1]."""
    a, b, c, d = y[:4]
    s = 1.0 / (a * a + b * b + c * c + d * d)
    return (
        2.0 * s * (b * d - a * c),
        2.0 * s * (c * d + a * b),
        s * (a * a - b * b - c * c + d * d),
    )


def _disc() -> dict[str, Any]:
    """P2: 20 deg off upright, yaw rate 1.5 rad/s, spin 6 rad/s, 10 s."""
    mass, radius = 1.0, 0.25
    c, s = _half_angle(70.0)
    tilt = math.radians(70.0)
    transverse = mass * radius**2 / 4.0
    return {
        "name": "P2",
        "title": "thin sharp-edged disc on a plane",
        "mass": mass,
        "inertia": (
            (transverse, 0.0, 0.0),
            (0.0, transverse, 0.0),
            (0.0, 0.0, 2.0 * transverse),
        ),
        "com": (0.0, 0.0, 0.0),
        "surface": {"kind": "rim", "radius": radius},
        "orientation": (c, s, 0.0, 0.0),
        "omega": (0.0, 1.5 * math.sin(tilt), 6.0 + 1.5 * math.cos(tilt)),
        "t_end": 10.0,
    }


def _rattleback() -> dict[str, Any]:
    """P3: -5 rad/s about the vertical, tilted by 0.5 deg twice, 5 s."""
    c, s = _half_angle(0.5)
    orientation = (c * c, s * c, c * s, s * s)
    return {
        "name": "P3",
        "title": "rattleback of Kane and Levinson",
        "mass": 1.0,
        "inertia": ((2e-4, -2e-5, 0.0), (-2e-5, 1.6e-3, 0.0), (0.0, 0.0, 1.7e-3)),
        "com": (0.0, 0.0, -0.01),
        "surface": {"kind": "ellipsoid", "semi_axes": (0.2, 0.03, 0.02)},
        "orientation": orientation,
        "omega": tuple(-5.0 * u for u in vertical(orientation)),
        "t_end": 5.0,
    }


def arm(problem: dict[str, Any], y: State) -> Vector:
    """Return the centre of mass relative to the contact, body axes [m]."""
    k = vertical(y)
    surface, com = problem["surface"], problem["com"]
    if surface["kind"] == "rim":
        scale = surface["radius"] / math.hypot(k[0], k[1])
        rho = (-scale * k[0], -scale * k[1], 0.0)
    else:
        half = surface["semi_axes"]
        scale = math.hypot(*(a * u for a, u in zip(half, k, strict=True)))
        rho = tuple(-a * a * u / scale for a, u in zip(half, k, strict=True))
    return (com[0] - rho[0], com[1] - rho[1], com[2] - rho[2])


def centre_of_mass(problem: dict[str, Any], y: State) -> Vector:
    """Return the centre of mass in world axes [m], its height from the contact."""
    height = sum(k * c for k, c in zip(vertical(y), arm(problem, y), strict=True))
    return (y[7], y[8], height)


def energy(problem: dict[str, Any], y: State) -> float:
    """Return kinetic plus potential energy, zero at height zero [J]."""
    w, c = y[4:7], arm(problem, y)
    velocity = (
        w[1] * c[2] - w[2] * c[1],
        w[2] * c[0] - w[0] * c[2],
        w[0] * c[1] - w[1] * c[0],
    )
    spin = sum(
        w[i] * problem["inertia"][i][j] * w[j] for i in range(3) for j in range(3)
    )
    kinetic = 0.5 * (problem["mass"] * sum(v * v for v in velocity) + spin)
    height = centre_of_mass(problem, y)[2]
    return kinetic + problem["mass"] * GRAVITY * height


def rotation_angle(p: State, q: State) -> float:
    """Return the angle between two orientations [rad], exact for small angles."""
    vector = (
        p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2],
        p[0] * q[2] - p[2] * q[0] - p[3] * q[1] + p[1] * q[3],
        p[0] * q[3] - p[3] * q[0] - p[1] * q[2] + p[2] * q[1],
    )
    scalar = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    return 2.0 * math.atan2(math.hypot(*vector), abs(scalar))


def end_error(problem: dict[str, Any], y_end: State) -> EndError:
    """Compare an end state with the reference; energy is signed, relative to t = 0."""
    reference = REFERENCE_END[problem["name"]]
    ours, theirs = centre_of_mass(problem, y_end), centre_of_mass(problem, reference)
    initial = energy(problem, INITIAL[problem["name"]])
    return EndError(
        math.dist(ours, theirs),
        rotation_angle(reference[:4], y_end[:4]),
        (energy(problem, y_end) - initial) / initial,
    )


# Lengths [m], mass [kg], inertia about the centre of mass in body axes [kg m^2], `com`
# from the centre of the surface in body axes, `orientation` a quaternion, scalar first,
# body -> world, `omega` in body axes [rad/s], `t_end` [s].
PROBLEMS = {"P2": _disc(), "P3": _rattleback()}

INITIAL = {
    name: (*problem["orientation"], *problem["omega"], 0.0, 0.0)
    for name, problem in PROBLEMS.items()
}

for _name, _problem in PROBLEMS.items():
    _problem["position"] = centre_of_mass(_problem, INITIAL[_name])

# Reference integration: SciPy DOP853 at rtol 1e-13 on an independent Newton-Euler
# formulation, checked against a SymPy Kane derivation.
REFERENCE_END = {
    "P2": (
        -0.07486798650288758,
        0.3025582394986584,
        0.23995251576401258,
        -0.9193889745298189,
        2.2484888085612216,
        4.5872202857760325,
        6.935080086917734,
        -0.41378024630822624,
        0.09616675701347344,
    ),
    "P3": (
        0.19694285521346158,
        0.0007841124824042461,
        0.026745481492856677,
        -0.9800497824945933,
        -1.6414053084424975,
        -2.0013929718001147,
        4.294938401356912,
        -0.001581587105351153,
        0.0017092353001855148,
    ),
}
