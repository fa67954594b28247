"""What moves in a picture: meshes, and where each is at every time.

The same meshes and samples as those of the viewer, for what draws by itself.
"""

from typing import NamedTuple

import numpy as np

from ..dynamics.scene import Scene
from ..geometry.numpy_rotations import product, rotated
from .mesh import Mesh, body_mesh, body_size, surface_mesh
from .motion_samples import MotionSamples
from .rolling_meshes import rolling_meshes

_SPHERE = 24, 13  # points round and along a drawn ball
_LEVEL = np.array([[1.0, 0.0, 0.0, 0.0]])


class Part(NamedTuple):
    """A mesh that moves.

    Attributes:
        name: Of what it is.
        kind: ``"body"``, ``"inside"`` (a surface in a carrier), ``"base"``,
            ``"mass"`` or ``"contact"``.
        mesh: On its own axes [m].
        position: Of its origin [m], fixed axes, shape (T, 3).
        orientation: Unit quaternion, scalar first, own to fixed axes [1], (T, 4).
        seen_through: Whether something is in it.
        one_sided: Whether the backs of its triangles are not drawn: they are hidden, or
            one looks through them into a hollow.
    """

    name: str
    kind: str
    mesh: Mesh
    position: np.ndarray
    orientation: np.ndarray
    seen_through: bool = False
    one_sided: bool = False


class Parts(NamedTuple):
    """All that moves.

    Attributes:
        parts: Those that have a mesh.
        size: Reach of the body from its origin [m].
    """

    parts: list[Part]
    size: float


def motion_parts(scene: Scene, motion: MotionSamples, like: MotionSamples) -> Parts:
    """Bodies, base, carried masses and the contact point of a motion.

    Args:
        scene: Of the motion.
        motion: At the times at which the parts are wanted.
        like: The outputs of the run, by which meshes are made: they have all of the
            contact's path.
    """
    size = body_size(scene.body, like.contact_on_body)
    outer = body_mesh(scene.body.surface, like.contact_on_body, like.body_outward, size)
    if outer.points.size:
        size = float(np.max(np.linalg.norm(outer.points, axis=1)))
    inner = rolling_meshes(scene, like, outer)
    within = any(own.carrier < 0 and own.on is not None for own in inner)
    carries = within or like.masses.size > 0
    place, turn = motion.position, motion.orientation
    parts = [_base(scene, motion, like, size)]
    hides = not carries and is_closed(outer)
    parts.append(Part("body", "body", outer, place, turn, carries, hides))
    poses = [(place, turn)]
    for k, own in enumerate(inner):
        at, along = (motion.rolling_column(k, x) for x in _POSE)
        poses.append((at, along))
        holds = any(other.carrier == k for other in inner)
        hides = not holds and is_closed(own.body)
        parts.append(Part(f"rolling {k}", "body", own.body, *poses[-1], holds, hides))
        if own.on is not None:
            at, along = poses[own.carrier + 1]  # of its carrier
            turned = product(along, own.turn[None])
            moved = at + rotated(along, own.place[None])
            parts.append(
                Part(f"inside {k}", "inside", own.on, moved, turned, True, True)
            )
    parts += _masses(motion, size)
    ball = ball_mesh(0.04 * size)
    level = np.repeat(_LEVEL, len(motion.time), axis=0)
    parts.append(Part("contact", "contact", ball, motion.contact, level))
    return Parts([part for part in parts if part.mesh.triangles.size], size)


_POSE = "position", "orientation"


def _base(
    scene: Scene, motion: MotionSamples, like: MotionSamples, size: float
) -> Part:
    """The base: as much of it as the motion uses, and some more."""
    touched = like.contact_on_base
    extent = float(np.max(np.ptp(touched, axis=0), initial=0.0))
    surface = scene.base.surface
    if surface.is_flat:
        mesh = ground_mesh(touched, 2.0 * size + 0.15 * extent)
    else:
        margin = 1.3 * size + 0.1 * extent
        mesh = surface_mesh(surface, touched, like.base_outward, margin)
    turn, place = motion.base_orientation, motion.base_origin
    return Part("base", "base", mesh, place, turn, one_sided=not surface.is_flat)


def _masses(motion: MotionSamples, size: float) -> list[Part]:
    """A ball for each carried mass, of its volume's share."""
    level = np.repeat(_LEVEL, len(motion.time), axis=0)
    found: list[Part] = []
    for k, mass in enumerate(motion.masses):
        radius = 0.1 * size * float(np.cbrt(mass / np.max(motion.masses)))
        place = motion.position + rotated(motion.orientation, motion.carried[:, k])
        found.append(Part(f"mass {k}", "mass", ball_mesh(radius), place, level))
    return found


def is_closed(mesh: Mesh) -> bool:
    """Whether every edge of a mesh is of two triangles; points that agree are one.

    Args:
        mesh: Of any surface.
    """
    grain = 1e-6 * max(float(np.max(np.ptp(mesh.points, axis=0), initial=0.0)), 1e-300)
    keys = np.rint(mesh.points / grain)
    same = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    a, b, c = same[mesh.triangles].T
    edges = np.sort(np.stack([np.r_[a, b, c], np.r_[b, c, a]], axis=1), axis=1)
    counts = np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0, return_counts=True)[1]
    return bool(counts.size) and bool(np.all(counts == 2))


def ground_mesh(touched: np.ndarray, margin: float) -> Mesh:
    """A piece of the plane z = 0 with squares of a round length.

    Args:
        touched: Points of it that the motion uses [m], shape (k, 3).
        margin: Round these [m].
    """
    low, high = touched[:, :2].min(axis=0) - margin, touched[:, :2].max(axis=0) + margin
    side = round_length(0.15 * float(np.max(high - low)))
    first = np.floor(low / side).astype(int)
    columns, rows = (int(x) for x in np.ceil(high / side).astype(int) - first)
    count = np.arange((columns + 1) * (rows + 1))
    steps = np.stack([count // (rows + 1), count % (rows + 1)], axis=1)
    places = side * (first + steps)
    points = np.concatenate([places, np.zeros((len(places), 1))], axis=1)
    number = count.reshape(columns + 1, rows + 1)
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    corners = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    marks = steps / np.array([columns, rows])
    return Mesh(points, normals, marks, corners, (columns, rows))


def round_length(length: float) -> float:
    """Length 1, 2 or 5 times a power of ten next below a length, as the viewer's."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * next(x for x in (5, 2, 1) if x * power <= length * 1.0001))


def ball_mesh(radius: float) -> Mesh:
    """A small ball.

    Args:
        radius: [m].
    """
    across, along = _SPHERE
    u, v = np.meshgrid(
        np.linspace(-np.pi, np.pi, across),
        np.linspace(0.0, np.pi, along),
        indexing="ij",
    )
    normals = np.stack(
        [np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1
    ).reshape(-1, 3)
    number = np.arange(across * along).reshape(across, along)
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    corners = np.concatenate([np.stack([a, d, c], 1), np.stack([a, c, b], 1)])
    return Mesh(radius * normals, normals, np.zeros((len(normals), 2)), corners, (1, 1))
