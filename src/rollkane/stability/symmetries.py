"""Symmetries of a scene: groups of motions under which its equations keep their form.

Rigid motions that carry the base's surface or the body's into itself, and shifts of
what is carried, are candidates; a combination of them is a symmetry where the
right-hand side is equivariant: the Lie bracket of both vector fields vanishes at random
states that the contact allows, and near given ones. So a surface, a load or a carried
mass of the user's counts like any other.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..dynamics.abstract_supported import refuse_rolling_parts
from ..dynamics.rolling import rolling_derivative
from ..dynamics.rolling_problem import corners
from ..dynamics.scene import Scene, require_scene
from ..kinematics.coordinates import State
from ..validation.checks import FieldError, is_traced
from .equivariance import Tested, carried_rates, equivariant, tested
from .group_actions import Action, carried_by, carrying_with, moved_by, tangent
from .independent_coordinates import refuse_kind
from .state_draws import Draws, any_draws, both_draws, near_draws, rows_of
from .surface_motions import LOOSE, SurfaceMotions, echelon, surface_motions
from .time_dependence import differing, uses_time, wide_times


class Symmetries(eqx.Module):
    """The symmetries of a scene: generators by name, and what they generate.

    Attributes:
        names: Of the generators, in order.
        scene: Whose they are.
        action: What they do, one row for each name.
        drift: What time itself does beside carrying the state along with the base, one
            row; None: the scene depends on time and no motion takes that out.
        twists: Of each generator on the base: velocity of the base's origin [m/s] and
            angular velocity [rad/s], base axes, shape (K, 6).
        placed: Whether they were looked for near given states, too.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    scene: Scene
    action: Action
    drift: Action | None
    twists: Float[Array | np.ndarray, "K 6"]
    placed: bool = eqx.field(static=True)

    def __len__(self) -> int:
        """How many."""
        return len(self.names)

    def __iter__(self) -> Iterator[str]:
        """Their names."""
        return iter(self.names)

    def __contains__(self, name: object) -> bool:
        """Whether there is one of a name."""
        return name in self.names

    def __getitem__(self, name: str) -> Callable[..., State]:
        """The generator of a name, a function of a state that gives its tangent.

        Raises:
            FieldError: none has the name.
        """
        if name not in self.names:
            known = ", ".join(map(repr, self.names)) or "none"
            remedy = f"there are {known}"
            raise FieldError("symmetries", name, "is no symmetry of the scene", remedy)
        weights = np.eye(len(self))[self.names.index(name)]

        def generator(state: State, time: ArrayLike = 0.0) -> State:
            return self.generator(state, weights, time)

        return generator

    def generator(
        self, state: State, velocities: ArrayLike, time: ArrayLike = 0.0
    ) -> State:
        """Tangent of a state that moves with given group velocities.

        Args:
            state: Any that the contact allows.
            velocities: One for each name [m/s] or [rad/s], shape (K,).
            time: [s]; it places a base that moves.
        """
        weights = jnp.asarray(velocities, state.orientation.dtype)
        return tangent(self.scene, time, state, self.action, weights)

    def moved(self, state: State, steps: ArrayLike, time: ArrayLike = 0.0) -> State:
        """The state moved by a group element: ``exp(sum steps_k G_k)`` of it, exactly.

        Args:
            state: Any that the contact allows.
            steps: Of each name [m] or [rad], shape (K,).
            time: [s].
        """
        weights = jnp.asarray(steps, state.orientation.dtype)
        return moved_by(self.scene, time, state, self.action, weights)

    def carrying(self, state: State, time: ArrayLike = 0.0) -> State:
        """Tangent of a state that time itself carries along.

        The base takes it with it; rates less this do not depend on time. Zero on a base
        at rest.

        Raises:
            FieldError: the scene depends on time and no motion takes that out.
        """
        return carrying_with(self.scene, time, state, self.known_drift)

    def carried(self, state: State, time: ArrayLike, start: ArrayLike = 0.0) -> State:
        """A state at a start, carried along by time itself to another time [s].

        Raises:
            FieldError: the scene depends on time and no motion takes that out.
        """
        begin, end = (jnp.asarray(t, state.orientation.dtype) for t in (start, time))
        return carried_by(self.scene, begin, end, state, self.known_drift)

    @property
    def known_drift(self) -> Action:
        """The drift; refused where there is none."""
        if self.drift is None:
            problem = "depends on time in a way that no motion with its base takes out"
            remedy = (
                "leave out forces and prescribed motions that are functions of time, "
                "and let the base rest, glide or turn steadily"
            )
            raise FieldError("scene", self.scene.base.motion, problem, remedy)
        return self.drift


def symmetries(
    scene: Scene, state: State | None = None, time: ArrayLike = 0.0
) -> Symmetries:
    """The symmetries of a scene, by name.

    ``"translation x"`` and ``"turn about z"`` move the body on its base, in base axes
    (a plane, a cylinder, any surface of revolution); ``"screw about z"`` does both;
    ``"spin about z"`` turns the axes of a body of revolution in it, so that of -8 rad/s
    the body itself turns by +8 about its z;
    ``"alpha[0]"`` shifts a coordinate of what is carried. Combinations that are
    symmetries only together have a name that says of what.

    Args:
        scene: What rolls on what, under any loads; a base may glide or turn steadily.
        state: Where the equations are compared, too, and close by. Without it what
            breaks a symmetry far from the origin, or in a narrow place only (a magnet,
            a wall, a detent), may be missed: they are compared at random states.
        time: Of the state [s].

    Returns:
        ``Symmetries``: group velocities are in [m/s] and [rad/s].

    Raises:
        FieldError: a traced scene, one in which bodies roll on the rolling body, a
            state of another kind, one where the equations give no finite numbers.

    Source: docs/theory.md, (10.1).
    """
    require_scene("symmetries.scene", scene)
    if is_traced(scene, state, time):
        problem, remedy = "is traced", "find symmetries outside of jit and derivatives"
        raise FieldError("symmetries.scene", "a traced scene", problem, remedy)
    refuse_rolling_parts("symmetries.scene", scene.supported)
    if state is None:
        return _remembered(_FOUND, scene, None, _symmetries)
    refuse_kind(scene, state)
    first: Callable[[Any], np.ndarray] = lambda part: np.asarray(part)[None]
    return symmetries_at(scene, np.ravel(time), jax.tree.map(first, state))


def symmetries_at(scene: Scene, times: ArrayLike, states: State) -> Symmetries:
    """The symmetries of a scene that hold near all given states, too.

    Args:
        scene: Not traced, and without bodies that roll on the rolling body.
        times: Of the states [s], shape (P,).
        states: Of the scene's kind, every array with a leading P.

    Raises:
        FieldError: near none of them the equations give finite numbers.
    """
    places = np.asarray(times, float), jax.tree.map(np.asarray, states)
    return _remembered(_FOUND, scene, places, _symmetries)


_FOUND: dict[Any, Any] = {}  # by scene and states, the last few
_ANYWHERE: dict[Any, Any] = {}  # what no state belongs to, by scene
_KEPT = 32


def _remembered(kept: dict[Any, Any], scene: Scene, places: Any, make: Any) -> Any:
    """What is made of a scene and places, once."""
    leaves, tree = cast(tuple[list[Any], Any], jax.tree.flatten((scene, places)))
    known = [np.asarray(x) for x in leaves]
    key: Any = tree, tuple((x.shape, x.dtype.str, x.tobytes()) for x in known)
    if key not in kept:
        while len(kept) >= _KEPT:
            kept.pop(next(iter(kept)))
        kept[key] = make(scene, places)
    return kept[key]


class _Anywhere(NamedTuple):
    """Candidates of a scene, and their brackets at draws of any kind."""

    base: SurfaceMotions
    body: SurfaceMotions
    action: Action
    draws: Draws
    found: Tested


def _anywhere(scene: Scene, places: None) -> _Anywhere:
    del places
    base = surface_motions(scene.base.surface)
    body = surface_motions(scene.body.surface)
    own = scene.has_contact_coordinates
    counts = base.twists.shape[0], body.twists.shape[0], scene.coordinate_count
    dtype = np.dtype(scene.body.mass.dtype)
    action = _candidates(base, body, counts, own, dtype)
    draws = any_draws(scene, dtype)
    return _Anywhere(base, body, action, draws, tested(scene, action, draws))


def _symmetries(scene: Scene, places: tuple[np.ndarray, State] | None) -> Symmetries:
    base, body, action, draws, found = cast(
        _Anywhere, _remembered(_ANYWHERE, scene, None, _anywhere)
    )
    loose = LOOSE[np.dtype(scene.body.mass.dtype).itemsize]
    if places is not None:
        close = near_draws(scene, *places)
        draws = both_draws(draws, close)
        found = found.with_more(tested(scene, action, close))
    _refuse_unusable(found, places is not None)
    free, drift = _parted(equivariant(found, loose))
    others = np.zeros(0)
    if drift is not None:
        usable = rows_of(draws, np.nonzero(found.good)[0])
        others = _unsteady(scene, action.combined(drift[None]), usable)
    if others.size:  # at times that the draws were not at, so that they are compared
        times = np.resize(others, draws.times.shape).astype(draws.times.dtype)
        more = tested(scene, action, draws._replace(times=times))
        free, drift = _parted(equivariant(found.with_more(more), loose))[0], None
    rows = echelon(free)
    labels = [*_base_names(base), *_body_names(body)]
    labels += [f"alpha[{k}]" for k in range(scene.coordinate_count)]
    twists = rows[:, : base.twists.shape[0]] @ base.twists
    return Symmetries(
        tuple(_combination(row, labels) for row in rows),
        scene,
        action.combined(rows),
        None if drift is None else action.combined(drift[None]),
        np.asarray(twists, draws.times.dtype),
        places is not None,
    )


def _refuse_unusable(found: Tested, placed: bool) -> None:
    """Refuse what no draw tells of: the lack of numbers is no lack of symmetry."""
    if placed and not np.any(found.good & found.near):
        problem = "has no finite rates and derivatives of them, nor a state near it"
        remedy = (
            "give a state inside of where the scene's functions and their first "
            "derivatives are finite"
        )
        raise FieldError("symmetries.state", "...", problem, remedy)
    if not np.any(found.good):
        problem = (
            f"has finite rates at none of {found.good.size} random states (alpha about "
            "1), so that no symmetry of it can be told"
        )
        remedy = "give a state of its motion: rollkane.symmetries(scene, state)"
        raise FieldError("symmetries.scene", "a Scene", problem, remedy)


def _unsteady(scene: Scene, drift: Action, draws: Draws) -> np.ndarray:
    """Times [s] at which the rates are not those at zero, carried along."""
    first: Callable[[Array], Array] = lambda part: part[0]
    one = jax.tree.map(first, draws.states)
    if not uses_time(rolling_derivative, scene, one):
        return np.zeros(0)
    motion = scene.base.motion
    times = wide_times(corners(scene)[0], None if motion is None else motion.span)
    found = differing(carried_rates(scene, drift, times, draws))
    spread = found[np.linspace(0, found.size - 1, min(found.size, 16)).astype(int)]
    return times[spread]


def _candidates(
    base: SurfaceMotions,
    body: SurfaceMotions,
    counts: tuple[int, int, int],
    own: bool,
    dtype: np.dtype[Any],
) -> Action:
    """All rigid motions of both surfaces and all shifts of alpha, one row each."""
    total = sum(counts)
    first, second = counts[0], counts[0] + counts[1]
    body_maps = body.maps if own else np.zeros((counts[1], 1, 1))
    parts = {
        "turn": (slice(0, first), base.twists[:, 3:]),
        "on_base": (slice(0, first), base.maps),
        "spin": (slice(first, second), body.twists[:, 3:]),
        "on_body": (slice(first, second), body_maps),
        "shift": (slice(second, total), np.eye(counts[2])),
    }
    made: dict[str, Any] = {}
    for name, (rows, values) in parts.items():
        whole = np.zeros((total, *values.shape[1:]), dtype)
        whole[rows] = values
        made[name] = whole
    return Action(**made)


# Of a null vector of unit length: the part of time that counts. Null vectors are known
# to 1e-9 (``LOOSE``); with a drift of w [rad/s] or [m/s] that part is 1 / w.
_IN_TIME = 1e-6
# What null vectors are known to: less is zero in drifts and in axes.
_EXACT = 1e-9


def _parted(null: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Symmetries without time, and what goes with a unit of time."""
    with_time = null[:, -1:]
    if not null.shape[0]:
        return null[:, :-1], None
    left, values, _ = np.linalg.svd(with_time)
    if values[0] < _IN_TIME:
        return null[:, :-1], None
    lead, free = left[:, 0] @ null, left[:, 1:].T @ null
    drift = (lead / lead[-1])[:-1]
    if free.shape[0]:  # as little of the symmetries in it as there can be
        drift = drift - np.linalg.pinv(free[:, :-1]) @ (free[:, :-1] @ drift)
    drift[np.abs(drift) < _EXACT * max(1.0, np.abs(drift).max(initial=0.0))] = 0.0
    return free[:, :-1], drift


def _base_names(motions: SurfaceMotions) -> list[str]:
    return [_twist_name(twist, "turn") for twist in motions.twists]


def _body_names(motions: SurfaceMotions) -> list[str]:
    own = [_twist_name(twist, "spin") for twist in motions.twists]
    return [f"body {name}" if "spin" not in name else name for name in own]


def _twist_name(twist: np.ndarray, turning: str) -> str:
    v, w = twist[:3], twist[3:]
    if not w.any():
        return f"translation {_axis(v)}"
    pitch = float(v @ w) / float(w @ w)
    small = _EXACT * max(float(np.abs(v).max()), 1e-300)
    if abs(pitch) > small and np.any(v):
        return f"screw about {_axis(w)}"
    return f"{turning} about {_axis(w)}"


def _axis(vector: np.ndarray) -> str:
    unit = vector / np.linalg.norm(vector)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        if np.abs(unit - axis).max() < _EXACT:
            return name
    return "({:.6g}, {:.6g}, {:.6g})".format(*unit)


def _combination(row: np.ndarray, labels: list[str]) -> str:
    text = ""
    for weight, label in zip(row, labels, strict=True):
        if weight:
            told = f"{abs(weight):.6g} "
            size = "" if told == "1 " else told
            sign = " - " if weight < 0.0 else " + "
            text += (sign if text or weight < 0.0 else "") + size + label
    return text.strip()
