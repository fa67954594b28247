"""Points of a sweep: numbers of a scene file that take a range of values each.

Points whose scenes have the same structure are one ensemble: one compiled loop.
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

from .option_values import finite_number, refuse
from .preparation import changes_of, refuse_undone

# each is loaded as a file of its own is, in about 3 ms
MOST_POINTS = 100_000
_EXACT = 2.0**53  # whole numbers below it are those that were written
_Flat: TypeAlias = tuple[list[Any], Any]


class Varied(NamedTuple):
    """A number of the scene file, and its values.

    Attributes:
        path: Such as ``body.mass``.
        values: In the order of the option.
    """

    path: str
    values: tuple[float, ...]


class Group(NamedTuple):
    """Points whose scenes have the same structure.

    Attributes:
        places: Their numbers among all points.
        files: Their scene files.
    """

    places: list[int]
    files: list[Any]


class Point(NamedTuple):
    """A point that cannot be used.

    Attributes:
        values: By path.
        error: What is wrong with its scene.
    """

    values: dict[str, str]
    error: Exception


def varied(given: Sequence[str]) -> list[Varied]:
    """What options ``PATH=LOW:HIGH:COUNT`` or ``PATH=A,B,...`` say.

    Raises:
        click.BadParameter: an option of another form, a path twice, too many points.
    """
    parts = list(_apart(given))
    refuse_undone("--vary", [path for path, _ in parts])
    found = [_one(path, text) for path, text in parts]
    count = math.prod(len(one.values) for one in found)
    if count > MOST_POINTS:
        refuse("--vary", f"asks for {count:,} points, more than {MOST_POINTS:,}")
    return found


def _apart(given: Sequence[str]) -> Iterable[tuple[str, str]]:
    for one in given:
        path, equals, text = (part.strip() for part in one.partition("="))
        if not (path and equals and text):
            refuse(
                "--vary",
                f"{one!r} is not PATH=LOW:HIGH:COUNT, such as body.mass=1:2:11",
            )
        yield path, text


def _one(path: str, text: str) -> Varied:
    parts = text.split(":")
    if len(parts) == 1:
        return Varied(
            path, tuple(finite_number("--vary", x, path) for x in text.split(","))
        )
    if len(parts) != 3 or not parts[2].strip().isdigit() or int(parts[2]) < 2:
        refuse(
            "--vary",
            f"{path}={text} is neither LOW:HIGH:COUNT, with a COUNT >= 2, nor A,B",
        )
    low, high = (finite_number("--vary", x, path) for x in parts[:2])
    count = int(parts[2])
    if count > MOST_POINTS:
        refuse("--vary", f"asks for {count:,} points, more than {MOST_POINTS:,}")
    step = (high - low) / (count - 1)
    return Varied(path, (*(low + step * k for k in range(count - 1)), high))


def groups_of(
    scene: str, changes: tuple[str, ...], over: Sequence[Varied]
) -> list[Group] | Point:
    """The scene at every point, the last number varying fastest; or what is wrong.

    Args:
        scene: Name or path.
        changes: Options ``PATH=VALUE`` for all points.
        over: What varies.
    """
    from ..files.scene_files import SceneFileError, load_scene

    shared = changes_of(changes)
    found: dict[Any, Group] = {}
    parts: dict[Any, Any] = {}
    for place, point in enumerate(itertools.product(*(one.values for one in over))):
        own = {one.path: _text(x) for one, x in zip(over, point, strict=True)}
        try:
            file = load_scene(scene, shared | own, parts)
        except SceneFileError as error:
            return Point(own, error)
        group = found.setdefault(_structure(file), Group([], []))
        group.places.append(place)
        group.files.append(file)
    return list(found.values())


def _text(x: float) -> str:
    """As a user writes it: some fields take whole numbers alone, and all take them."""
    return repr(int(x) if x.is_integer() and abs(x) < _EXACT else x)


def _structure(file: Any) -> Any:
    """What scenes that can be members of one ensemble have in common."""
    import jax
    import numpy as np

    leaves, tree = cast(_Flat, jax.tree.flatten((file.scene, file.start)))
    shapes = tuple((np.shape(x), str(np.asarray(x).dtype)) for x in leaves)
    run = (file.rtol, file.atol, file.method, file.times.tobytes())
    # modes and events are those of all members
    own, kind = cast(_Flat, jax.tree.flatten((file.modes, file.events)))
    own = tuple(np.asarray(x).tobytes() for x in own)
    return (tree, shapes, run, file.second_contact, kind, own)


def stacked(scenes: Sequence[Any]) -> tuple[Any, Any]:
    """Scenes of one structure as one, and the axes of their members in it.

    Numbers that are the same in all of them (tables of a record) stay as they are.
    """
    import jax
    import numpy as np

    tree = cast(Any, jax.tree.structure(scenes[0]))
    leaves: list[Any] = []
    axes: list[int | None] = []
    for own in zip(*map(jax.tree.leaves, scenes), strict=True):
        arrays = [np.asarray(x) for x in own]
        same = all(np.array_equal(arrays[0], x) for x in arrays)
        leaves.append(own[0] if same else jax.numpy.asarray(np.stack(arrays)))
        axes.append(None if same else 0)
    return jax.tree.unflatten(tree, leaves), jax.tree.unflatten(tree, axes)
