"""What the viewer draws of bodies that roll on or in the rolling body."""

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import equinox as eqx
import numpy as np

from ..dynamics.abstract_supported import rolling_parts
from ..dynamics.rolling_bodies import RollingBody
from ..dynamics.scene import Scene
from ..geometry.numpy_rotations import rotated
from ..geometry.surfaces import AbstractSurface
from .mesh import Mesh, body_mesh, body_size
from .motion_samples import MotionSamples


class RollingMeshes(NamedTuple):
    """Of one rolling body.

    Attributes:
        body: Its surface, own axes.
        on: The surface on which it rolls, on that surface's axes; None: it is the
            carrier's own.
        carrier: Number of its carrier; -1: the outermost body.
        place: Origin of the surface's axes in the carrier [m], shape (3,).
        turn: Unit quaternion, the surface's to the carrier's axes [1], shape (4,).
    """

    body: Mesh
    on: Mesh | None
    carrier: int
    place: np.ndarray
    turn: np.ndarray


def rolling_meshes(
    scene: Scene, motion: MotionSamples, outermost: Mesh
) -> list[RollingMeshes]:
    """Of every rolling body, in the order of ``MotionSamples.rolling``.

    Args:
        scene: Of the motion.
        motion: What is drawn.
        outermost: Mesh of the body in or on which they all roll.
    """
    found: list[RollingMeshes] = []
    for k, (part, carrier, outer) in enumerate(_bodies(scene)):
        column: Callable[[str], np.ndarray] = functools.partial(
            motion.rolling_column, k
        )
        touched = column("contact_on_body")
        size = body_size(part.body, touched)
        body = body_mesh(part.body.surface, touched, column("body_outward"), size)
        on = None
        place = np.zeros(3) if part.position is None else np.asarray(part.position)
        turn = np.eye(4)[0] if part.rotation is None else np.asarray(part.rotation)
        moved = part.position is not None or part.rotation is not None
        if moved or not eqx.tree_equal(part.on, outer):
            places, out = column("contact_on_carrier"), column("carrier_outward")
            around = outermost if carrier < 0 else found[carrier].body
            box = _box(around, place, turn)
            on = body_mesh(part.on, places, out, 1.3 * size, box)
        found.append(RollingMeshes(body, on, carrier, place, turn))
    return found


def _bodies(
    scene: Scene, carrier: int = -1, first: int = 0
) -> Iterator[tuple[RollingBody, int, AbstractSurface]]:
    """Each rolling body, the number of its carrier, and the carrier's own surface."""
    for part in rolling_parts(scene.supported):
        assert isinstance(part, RollingBody)
        yield part, carrier, scene.body.surface
        inner = list(_bodies(part.scene, first, first + 1))
        yield from inner
        first += 1 + len(inner)


def _box(carrier: Mesh, place: np.ndarray, turn: np.ndarray) -> np.ndarray | None:
    """Box of a carrier on the axes of a surface in it, shape (2, 3)."""
    if not carrier.points.size:
        return None
    back = turn * np.array([1.0, -1.0, -1.0, -1.0])
    points = rotated(back, carrier.points - place)
    return np.stack([points.min(axis=0), points.max(axis=0)])
