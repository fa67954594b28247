"""Runs in one floating-point precision: the widest of a scene and its start."""

from typing import Any, TypeVar, cast

import jax
import numpy as np

from ..dynamics.scene import Scene
from ..kinematics.coordinates import State
from ..kinematics.voronets import VoronetsState
from ..validation.remembered import remembered

_T = TypeVar("_T")


def in_one_precision(scene: Scene, start: _T) -> tuple[Scene, _T]:
    """Scene and start in the widest precision of both.

    In a narrower one than its rates have, a start's steps would round to nothing.

    Args:
        scene: Of any precision.
        start: Its state, or what else is in its place, which is left alone.

    Returns:
        Those given, where they have it.
    """
    if not isinstance(start, (State, VoronetsState)):
        return scene, start
    known = _of_scene(scene) | _floats(start)
    if len(known) < 2:
        return scene, start
    widest = np.result_type(*known)
    return in_precision(widest, scene), in_precision(widest, start)


def in_precision(dtype: np.dtype[Any], tree: _T) -> _T:
    """A tree with its floating-point numbers in a type; itself where they are."""
    if not _floats(tree) - {dtype}:
        return tree

    def converted(x: Any) -> Any:
        return x.astype(dtype) if _is_real(x) else x

    return cast(_T, jax.tree.map(converted, tree))


def _is_real(x: Any) -> bool:
    # a key's type has no kind
    return getattr(getattr(x, "dtype", None), "kind", None) == "f"


def _floats(tree: Any) -> set[np.dtype[Any]]:
    return {x.dtype for x in jax.tree.leaves(tree) if _is_real(x)}


_of_scene = remembered(lambda scene: True)(_floats)  # types do not change
