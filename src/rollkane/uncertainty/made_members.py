"""Scenes and starts that a study makes of random draws: what differs among them."""

from collections.abc import Callable, Iterable
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.dependence import reached_outputs
from ..dynamics.scene import Scene
from ..hybrid.modes import HybridScene, Modes, in_one_law
from ..kinematics.coordinates import State
from ..simulation.ensemble_members import Members
from ..validation.checks import FieldError
from ..validation.function_errors import MissingEntryError, called, untraceable
from .draws import Draws
from .moded_views import Shown, rates, state_at, value_of

Make = Callable[
    [dict[str, Any]], tuple[Scene, State] | tuple[Scene, State, Modes | None]
]
_REMEDY = (
    "give a function of the draw that returns (scene, start), or (scene, start, "
    "modes), by jax.numpy"
)
_CLOSED = "gives a scene in which a function closes over a drawn number"
_HOLD = "let an equinox module hold the number and be the function"


class MadeMembers:
    """What ``make`` gives of any draw.

    Leaves of scene and start that no draw reaches are shared by all members, and so
    known where the motion is compiled.

    Attributes:
        draws: What is drawn.
        scene: Scene of the middle draw (every u = 1/2); a ``HybridScene`` where its
            contact may change.
        start: Its start.
    """

    def __init__(
        self, make: Make, draws: Draws, time: float = 0.0, modes: Modes | None = None
    ):
        """Make the middle member, and find what differs.

        Args:
            make: Of scene and start, of one draw.
            draws: What is drawn.
            time: At which motions begin [s].
            modes: How they may change between rolling, slipping and flight, where
                ``make`` does not say it.

        Raises:
            FieldError: no scene and start come out, ``make`` cannot be traced, or a
                function inside of the scene closes over a drawn number.
        """
        self.draws, self._make, self._modes = draws, make, modes
        middle = jnp.full(draws.dimension, 0.5)
        self.scene, self.start = made(make, draws.draw(middle), modes)
        self._leaves, self._tree = _flat(self.scene, self.start)
        self._places = _places((self.scene, self.start))
        self._time = jnp.asarray(time, self.start.angular_velocity.dtype)
        self._own = self._reached([rates])
        self._scenes = len(jax.tree.leaves(self.scene))
        self._made: Any = jax.jit(jax.vmap(self._of_own))

    def members(self, size: int) -> Members:
        """As an ensemble takes them, with the middle draw in every place."""
        expand: Callable[[Any, bool], Any] = lambda x, own: x[None] if own else x
        pairs = zip(self._leaves, self._own, strict=True)
        scene, start = jax.tree.unflatten(self._tree, [expand(*p) for p in pairs])
        axes = [0 if own else None for own in self._own]
        split = self._scenes
        return Members(size, scene, start, axes[:split], axes[split:])

    def block(self, u: Float[np.ndarray, "n d"]) -> tuple[Scene, State]:
        """Scenes and starts of some members; leaves that all share as they are."""
        return self._with(self._made(jnp.asarray(u)))

    def one(self, u: Float[Array, " d"]) -> tuple[Scene, State]:
        """Scene and start of one member; differentiable."""
        return self._with(self._of_own(u))

    def _with(self, own: Iterable[Any]) -> tuple[Scene, State]:
        """Scene and start, with leaves in the places of those that differ."""
        following = iter(own)
        pairs = zip(self._leaves, self._own, strict=True)
        leaves = [next(following) if mine else leaf for leaf, mine in pairs]
        return cast("tuple[Scene, State]", jax.tree.unflatten(self._tree, leaves))

    def _of_own(self, u: Float[Array, " d"]) -> list[Array]:
        """Those leaves of one member that differ."""
        leaves, _ = _flat(*self._pair(u))
        pairs = zip(leaves, self._own, strict=True)
        return [jnp.asarray(x) for x, own in pairs if own]

    def check(self, functions: Iterable[Shown]) -> None:
        """See that functions that look at motions see each member as it is.

        Args:
            functions: Of the scene, the time [s] and a state; they can be traced.

        Raises:
            FieldError: a function inside of the scene closes over a drawn number that
                one of them comes to.
        """
        seen: Callable[[Shown], Shown] = lambda f: (
            lambda scene, t, start: value_of(f, scene, t, state_at(scene, start))
        )
        self._reached([seen(f) for f in functions])

    def _reached(self, functions: list[Shown]) -> list[bool]:
        """Whether a draw reaches each leaf; it may reach nothing else."""
        t = self._time

        def seen(u: Array) -> tuple[list[Any], Any]:
            found = self._pair(u)
            self._check_alike(*found)
            leaves, tree = _flat(*found)
            # with the leaves known, nothing may depend on a draw
            scene, start = jax.tree.unflatten(tree, self._leaves)
            return leaves, [shown(scene, t, start) for shown in functions]

        middle = jnp.full(self.draws.dimension, 0.5)
        try:
            program, shape = jax.make_jaxpr(seen, return_shape=True)(middle)
        except (FieldError, MemoryError):
            raise
        except Exception as error:
            first = str(error).partition("\n")[0]
            problem = f"cannot be traced by JAX ({first})"
            raise FieldError("Study.make", self._make, problem, _REMEDY) from error
        reached = reached_outputs(program.jaxpr)
        count = len(jax.tree.leaves(shape[0]))
        if any(reached[count:]):
            raise FieldError("Study.make", self._make, _CLOSED, _HOLD)
        return reached[:count]

    def _pair(self, u: Any) -> tuple[Scene, State]:
        """Scene and start as ``make`` gives them."""
        return made(self._make, cast(Any, self.draws.draw(u)), self._modes)

    def _check_alike(self, scene: Scene, start: State) -> None:
        found, known = _places((scene, start)), self._places
        if found != known:
            closed = len(found) >= len(known)
            problem = _CLOSED if closed else "gives other numbers when it is traced"
            raise FieldError("Study.make", self._make, problem, _HOLD)


def _places(tree: Any) -> list[tuple[str, tuple[int, ...]]]:
    """Where the leaves of a tree are, and their shapes."""
    leaves = cast("list[Any]", jax.tree_util.tree_flatten_with_path(tree)[0])
    return [(jax.tree_util.keystr(path), jnp.shape(leaf)) for path, leaf in leaves]


def _flat(scene: Scene, start: State) -> tuple[list[Any], Any]:
    return cast("tuple[list[Any], Any]", jax.tree.flatten((scene, start)))


def made(make: Make, draw: Any, modes: Modes | None) -> tuple[Scene, State]:
    """Scene and start of a draw: with modes, of ``make`` or else these, in them.

    Raises:
        FieldError: something else comes out, modes that are given already, or it asks
            for what is not drawn.
    """
    try:
        found: Any = called(make, draw)
    except MissingEntryError as error:
        missing = untraceable("Study.make", make, error, _REMEDY, "distributions")
        raise missing from error
    if not isinstance(found, tuple) or len(cast(Any, found)) not in (2, 3):
        raise FieldError("Study.make", found, "is no (scene, start)", _REMEDY)
    scene, start, *own = cast("tuple[Any, ...]", found)
    kinds = zip((scene, start, *own), (Scene, State, Modes | None), strict=False)
    for one, kind in kinds:
        if not isinstance(one, kind):
            raise FieldError("Study.make", one, "is not what it must be", _REMEDY)
    if own and modes is not None:
        problem = "gives modes, which the study has, too"
        raise FieldError("Study.make", own[0], problem, "leave out Study's modes=")
    modes = own[0] if own else modes
    changing = in_one_law(scene) if modes is None else HybridScene(scene, modes)
    return changing, start
