"""Members of an ensemble: what they share, and what each has of its own."""

import dataclasses
import functools
import typing
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jaxtyping import Array

from ..codegen.dependence import reached_outputs
from ..dynamics.scene import Scene, require_scene
from ..hybrid.modes import HybridScene, Modes, in_one_law, modes_of
from ..kinematics.coordinates import State
from ..validation.checks import FieldError, is_traced, whole
from ..validation.program_digest import digest_of_traced

# For each leaf of a tree: 0 where members differ, else None.
_Axes: TypeAlias = list[int | None]
_Leaf: TypeAlias = tuple[tuple[Any, ...], Any]  # of a tree: its path, and itself
# Of the axis of members of a leaf, and of the leaf.
OfLeaf: TypeAlias = Callable[[int | None, Any], Any]


class Members(NamedTuple):
    """Scenes and starts of an ensemble.

    Attributes:
        size: How many.
        scene: Scene, of which leaves may have an axis of members in front; or what
            a function makes of a member's number. A ``HybridScene`` where its contact
            may change.
        starts: State, likewise.
        scene_axes: For each leaf of one scene: 0 where members differ, else None.
        start_axes: For each leaf of one state, likewise.
    """

    size: int
    scene: Any
    starts: Any
    scene_axes: _Axes
    start_axes: _Axes

    def example(self) -> tuple[Scene, State]:
        """The scene and the start of the first member."""
        first: OfLeaf = lambda axis, x: x if axis is None else _at(x, 0)
        return self.mapped(first, *self.block(0, 1))

    def mapped(
        self, function: OfLeaf, scene: Scene, starts: State
    ) -> tuple[Scene, State]:
        """``function(axis, leaf)`` of every leaf of a block."""
        return (
            by_axis(function, self.scene_axes, scene),
            by_axis(function, self.start_axes, starts),
        )

    def block(self, first: int, last: int) -> tuple[Scene, State]:
        """Scenes and starts of some members; leaves that all share as they are."""
        return (
            _block(self.scene, self.scene_axes, first, last),
            _block(self.starts, self.start_axes, first, last),
        )

    def axes(self) -> tuple[Any, Any]:
        """For ``jax.vmap``: axes as trees like one scene and one start."""
        return (
            jax.tree.unflatten(_structure(self.scene), self.scene_axes),
            jax.tree.unflatten(_structure(self.starts), self.start_axes),
        )

    @property
    def modes(self) -> Modes | None:
        """How their contacts may change, each its own way or all the same; or None."""
        return modes_of(self.scene.one if isinstance(self.scene, _Made) else self.scene)

    @property
    def given_scene(self) -> Scene | None:
        """The scene of all members as it was given; None where it is made."""
        return None if isinstance(self.scene, _Made) else self.scene


def members_of(
    scene: Any,
    starts: Any,
    count: int | None,
    scene_axes: Any = None,
    modes: Any = None,
) -> Members:
    """Find out which leaves have an axis of members.

    Args:
        scene: Scene, batched or not, or a function of a member's number.
        starts: State, batched or not, or a function of a member's number.
        count: How many members; needed where functions alone say it.
        scene_axes: As ``in_axes`` of ``jax.vmap`` for the scene; None: found out by
            the shapes that its fields declare.
        modes: Modes, batched or not, or None.

    Raises:
        FieldError: members that do not fit together, or none at all.
    """
    if isinstance(starts, Scene) and not isinstance(scene, Scene):
        remedy = "scene and starts are swapped: call ensemble(scene, starts, times)"
        require_scene("ensemble.scene", scene, remedy)
    if isinstance(scene, list | tuple) and scene_axes is None:
        scene_axes = 0  # as they are put together here
    scene = _stacked("scene", _in_one_law(scene), Scene)
    starts = _stacked("starts", starts, State)
    scene_found = _axes_of("scene", scene, Scene, scene_axes)
    start_found = _axes_of("starts", starts, State, None)
    mode_found = [] if modes is None else _axes_of("modes", modes, Modes, None)
    sizes = _sizes(scene, scene_found) | _sizes(starts, start_found)
    sizes |= _sizes(modes, mode_found)
    if count is not None:
        sizes.add(whole("ensemble.count", count, 1, "give one"))
    if scene_axes is None and not isinstance(scene, _Made):
        _refuse_unclear(scene, scene_found, sizes)
    remedy = "give every batched number the same first axis, one entry for each member"
    if len(sizes) > 1:
        raise FieldError(
            "ensemble", sorted(sizes), "has members of several counts", remedy
        )
    if sizes == {0}:
        remedy = "give at least one start or scene"
        raise FieldError("ensemble", 0, "has no members", remedy)
    if not sizes:
        raise FieldError(
            "ensemble.starts",
            starts,
            "has no axis of members",
            "map rollkane.place over it (jax.vmap), or give count= with a function of "
            "the member's number; a single motion is rollkane.simulate's",
        )
    if modes is not None:
        scene, scene_found = _in_modes(scene, scene_found, modes, mode_found)
    return Members(sizes.pop(), scene, starts, scene_found, start_found)


def _in_one_law(scene: Any) -> Any:
    """Scenes without modes of a run that they were of, as ``simulate`` takes them."""
    if isinstance(scene, list | tuple):
        return [in_one_law(one) for one in cast("Sequence[Any]", scene)]
    if callable(scene) and not isinstance(scene, Scene):
        made = cast("Callable[[Array], Scene]", scene)
        plain: Callable[[Array], Scene] = lambda i: in_one_law(made(i))
        return plain
    return in_one_law(scene)


def _in_modes(
    scene: Any, axes: _Axes, modes: Modes, own: _Axes
) -> tuple[Any, list[int | None]]:
    """Scenes whose contacts may change, and which leaves members have of their own."""
    shared = -1  # for None would be no leaf
    marks: Callable[[_Axes], list[int]] = lambda axes: [
        shared if axis is None else axis for axis in axes
    ]
    marked = HybridScene(
        jax.tree.unflatten(_structure(scene), marks(axes)),
        jax.tree.unflatten(_structure(modes), marks(own)),
    )
    found = [None if x == shared else 0 for x in jax.tree.leaves(marked)]
    if not isinstance(scene, _Made):
        return HybridScene(scene, modes), found
    made, structure = scene, _structure(scene)

    def leaves(numbers: Array) -> list[Array]:
        rows: OfLeaf = lambda axis, x: x if axis is None else jnp.asarray(x)[numbers]
        whole = jax.tree.unflatten(structure, made.leaves(numbers))
        return jax.tree.leaves(HybridScene(whole, by_axis(rows, own, modes)))

    one: OfLeaf = lambda axis, x: x if axis is None else _at(x, 0)
    whole = HybridScene(made.one, by_axis(one, own, modes))
    return _Made(whole, tuple(found), leaves), found


def _stacked(name: str, whole: Any, kind: type) -> Any:
    """A list of scenes or states as one, with an axis of members in front.

    A function of a member's number as what it makes, found out anew in each call: what
    it looks at may have changed.
    """
    if callable(whole) and not isinstance(whole, (Scene, State)):
        return _made(whole)
    if not isinstance(whole, list | tuple):
        return whole
    each, field = cast("Sequence[Any]", whole), f"ensemble.{name}"
    if not each:
        remedy = f"give at least one {kind.__name__}"
        raise FieldError(field, whole, "has no members", remedy)
    form: Callable[[Any], Any] = lambda one: (
        jax.tree.structure(one),
        [jnp.shape(leaf) for leaf in jax.tree.leaves(one)],
    )
    for i, one in enumerate(each):
        _check_kind(f"{field}[{i}]", one, kind)
        if form(one) != form(each[0]):
            raise FieldError(
                f"{field}[{i}]",
                one,
                "is of another form than the first, so they cannot run side by side",
                "let members differ in numbers only, or run an ensemble of each form",
            )
    stack = jnp.stack if is_traced(*each) else np.stack
    return jax.tree.map(lambda *leaves: stack(leaves), *each)


def _refuse_unclear(scene: Scene, axes: _Axes, sizes: set[int]) -> None:
    """Parameters of a user's functions may have any shape: one that fits is unclear."""
    leaves = cast(list[_Leaf], jax.tree_util.tree_flatten_with_path(scene)[0])
    for (path, leaf), axis in zip(leaves, axes, strict=True):
        unknown = axis is None and _declared_rank(scene, path) is None
        if unknown and jnp.ndim(leaf) and leaf.shape[0] in sizes:
            raise FieldError(
                "ensemble.scene" + jax.tree_util.keystr(path),
                leaf.shape,
                "may be one value of each member, or one array that all share",
                "say it by scene_axes=, as in_axes of jax.vmap: 0 where every number "
                "of the scene has the axis, as jax.vmap makes it; else a Scene of 0 "
                "and None",
            )


def by_axis(
    function: Callable[..., Any], axes: Sequence[int | None], *trees: Any
) -> Any:
    """``function(axis, *leaves)`` of every leaf of trees of one structure.

    Args:
        function: Of 0 or None, as members differ in a leaf or not, and of the leaves.
        axes: For each leaf.
        trees: Of which the leaves are.
    """
    shape = cast(Any, jax.tree.structure(trees[0]))
    each = zip(axes, *map(jax.tree.leaves, trees), strict=True)
    return jax.tree.unflatten(shape, [function(*leaf) for leaf in each])


def _block(whole: Any, axes: _Axes, first: int, last: int) -> Any:
    if isinstance(whole, _Made):
        return whole.block(first, last)
    some = slice(first, last)
    part: OfLeaf = lambda axis, x: x if axis is None else _at(x, some)
    return by_axis(part, axes, whole)


def _at(x: Any, place: Any) -> Any:
    """A part of an array; NumPy takes it in a hundredth of the time."""
    if is_traced(x) or jax.default_backend() != "cpu":
        return x[place]
    return np.asarray(np.asarray(x)[place])


def _structure(whole: Any) -> Any:
    one = whole.one if isinstance(whole, _Made) else whole
    return cast(Any, jax.tree.structure(one))


class _Made(NamedTuple):
    """What a function makes of a member's number, and how of many at once."""

    one: Any
    axes: tuple[int | None, ...]
    leaves: Callable[[Array], list[Array]]

    def block(self, first: int, last: int) -> Any:
        """Of the members from one to another."""
        numbers = self.leaves(jnp.arange(first, last))
        return jax.tree.unflatten(cast(Any, jax.tree.structure(self.one)), numbers)


class _Traced:
    """A traced function of a member's number, the same as another by what it does."""

    def __init__(self, function: Callable[..., Any]):
        """Trace it."""
        number = jax.ShapeDtypeStruct((), jnp.int_)
        anew: Callable[[Array], Any] = lambda i: function(i)  # JAX remembers functions
        self.program, self.one = jax.make_jaxpr(anew, return_shape=True)(number)
        structure = cast(Any, jax.tree.structure(self.one))
        self._key = digest_of_traced(self.program), structure
        self._known = not is_traced(*self.program.consts)

    def __hash__(self) -> int:
        """Of its program."""
        return hash(self._key[0])

    def __eq__(self, other: object) -> bool:
        """Whether it makes the same; traced numbers are never the same."""
        if self is other or not isinstance(other, _Traced):
            return self is other
        return self._known and other._known and self._key == other._key


def _made(function: Callable[..., Any]) -> _Made:
    """What does not depend on the member's number is shared by all."""
    return _compiled(_Traced(function))


@functools.lru_cache(maxsize=16)
def _compiled(traced: _Traced) -> _Made:
    program = traced.program
    axes = tuple(0 if own else None for own in reached_outputs(program.jaxpr))
    again = cast("Callable[[Array], list[Array]]", jaxpr_as_fun(program))
    return _Made(traced.one, axes, jax.jit(jax.vmap(again, out_axes=list(axes))))


def _sizes(whole: Any, axes: _Axes) -> set[int]:
    if isinstance(whole, _Made):
        return set()
    leaves = zip(jax.tree.leaves(whole), axes, strict=True)
    return {x.shape[0] for x, axis in leaves if axis is not None}


def _axes_of(name: str, whole: Any, kind: type, given: Any) -> list[int | None]:
    field = f"ensemble.{name}"
    if isinstance(whole, _Made):
        _check_kind(field, whole.one, kind)
        return list(whole.axes)
    _check_kind(field, whole, kind)
    if given is not None:
        return _spread(field, given, whole)
    found: _Axes = []
    leaves = cast(list[_Leaf], jax.tree_util.tree_flatten_with_path(whole)[0])
    for path, leaf in leaves:
        rank, shape = _declared_rank(whole, path), jnp.shape(leaf)
        if rank is None or len(shape) == rank:
            found.append(None)
        elif len(shape) == rank + 1:
            found.append(0)
        else:
            raise FieldError(
                field + jax.tree_util.keystr(path),
                shape,
                f"must have {rank} axes, or one more for the members",
                "look at the field's shape in its documentation",
            )
    return found


def _check_kind(field: str, value: Any, kind: type) -> None:
    if not isinstance(value, kind):
        remedy = (
            f"give a {kind.__name__}, or a function that makes one of a member's number"
        )
        if kind is State:
            remedy += " (rollkane.to_pole_free makes it of Voronets coordinates)"
        raise FieldError(field, value, f"is no {kind.__name__}", remedy)


def _spread(field: str, given: Any, whole: Any) -> list[int | None]:
    """Axes for every leaf from a prefix of the tree, as ``jax.vmap`` takes them."""
    spread: Callable[[Any, Any], list[Any]] = lambda axis, below: [
        axis for _ in jax.tree.leaves(below)
    ]
    try:
        tree = jax.tree.map(spread, given, whole, is_leaf=lambda x: x is None)
    except ValueError as error:
        raise FieldError(
            f"{field}_axes", given, "does not fit the scene", "give 0 or None"
        ) from error
    axes = jax.tree.leaves(tree, is_leaf=lambda x: x is None)
    if any(axis not in (0, None) for axis in axes):
        remedy = "put the members first"
        raise FieldError(f"{field}_axes", given, "must be made of 0 and None", remedy)
    return axes


def _declared_rank(whole: Any, path: tuple[Any, ...]) -> int | None:
    """How many axes a leaf has by the field that holds it; None where none says it."""
    owner, rank = whole, None
    for key in path:
        rank = None
        if isinstance(key, jax.tree_util.GetAttrKey):
            rank = _rank_of_field(cast(Any, type(owner)), key.name)
            owner = getattr(owner, key.name)
        elif isinstance(key, jax.tree_util.SequenceKey):
            owner = owner[key.idx]
        elif isinstance(key, jax.tree_util.DictKey):
            owner = owner[key.key]
        else:
            return None
    return rank


@functools.cache  # of a class and its field
def _rank_of_field(owner: Any, name: str) -> int | None:
    if not dataclasses.is_dataclass(owner):
        return None
    declared = {f.name: f.type for f in dataclasses.fields(owner)}.get(name)
    for option in (declared, *typing.get_args(declared)):
        dims: Any = getattr(option, "dims", None)
        if isinstance(dims, tuple) and getattr(option, "index_variadic", 0) is None:
            return len(cast(tuple[Any, ...], dims))
    return None
