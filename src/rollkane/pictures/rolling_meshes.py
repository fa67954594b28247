"""What the viewer draws of bodies that roll on or in the rolling body."""

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import equinox as eqx
import numpy as np

from ..dynamics.abstract_supported import rolling_parts
from ..dynamics.rolling_bodies import RollingBody
from ..dynamics.scene import Scene
from ..geometry.surfaces import AbstractSurface
from .mesh import Mesh, body_size, plate_mesh, surface_mesh
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


def rolling_meshes(scene: Scene, motion: MotionSamples) -> list[RollingMeshes]:
    """Of every rolling body, in the order of ``MotionSamples.rolling``."""
    found: list[RollingMeshes] = []
    for k, (part, carrier, outer) in enumerate(_bodies(scene)):
        column: Callable[[str], np.ndarray] = functools.partial(
            motion.rolling_column, k
        )
        touched = column("contact_on_body")
        size = body_size(part.body, touched)
        body = _mesh(part.body.surface, touched, column("body_outward"), size)
        on = None
        moved = part.position is not None or part.rotation is not None
        if moved or not eqx.tree_equal(part.on, outer):
            places = column("contact_on_carrier")
            on = _mesh(part.on, places, column("carrier_outward"), 1.3 * size)
        place = np.zeros(3) if part.position is None else np.asarray(part.position)
        turn = np.eye(4)[0] if part.rotation is None else np.asarray(part.rotation)
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


def _mesh(
    surface: AbstractSurface, touched: np.ndarray, outward: np.ndarray, size: float
) -> Mesh:
    if surface.is_flat:
        return plate_mesh(touched, size)
    return surface_mesh(surface, touched, outward, size)
