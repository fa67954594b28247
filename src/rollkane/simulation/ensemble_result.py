"""What came out of an ensemble: motions of many members."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..dynamics.scene import Scene
from ..hybrid.modes import ModedState
from ..kinematics.coordinates import State
from ..validation.checks import FieldError
from ..validation.codes import Fields, outcome_of
from .ensemble_members import by_axis
from .event_record import EventRecord
from .motion import AbstractMotion, Observable
from .samples import Axis, Samples, of_members
from .trajectory import Trajectory

_Flat: TypeAlias = tuple[list[tuple[tuple[Any, ...], Any]], Any]


class Ensemble(AbstractMotion, eqx.Module):
    """Motions of N members at T times, as NumPy arrays.

    ``position``, ``velocity``, ``energy`` and all other quantities of a
    :class:`Trajectory` are computed when asked for, with the members in front, shape
    (N, T, ...); ``final`` has the same at each member's own end, shape (N, ...).

    Attributes:
        time: [s], shape (T,).
        state: States at these times, every array with (N, T) in front, NaN where not
            reached; None where something else was observed and they were not kept.
        observed: What ``observe`` gave, every array with (N, T) in front; None without.
        code: Why each motion ended, one of :class:`Code`, shape (N,); 0 is success.
        final_time: Time that was reached [s], shape (N,).
        final_state: State at that time, every array with (N,) in front.
        steps: Accepted steps, shape (N,).
        rejected_steps: Rejected steps, shape (N,).
        fault: Which number of the scene, the start or the times cannot be used, as
            ``reasons`` names it, shape (N,); -1: none.
        first: Number of the first member: of a block, its place in the ensemble.
        scene: What moved; arrays in which members differ with (N,) in front.
        scene_axes: For each array of the scene: 0 where members differ, else None.
        method: ``"native"`` or ``"diffrax"``: which integrated.
        why: Why it was not the native loop; empty if it was, or if diffrax was asked.
        fields: Names of the numbers that ``fault`` counts.
        event_record: Events of the members, as ``events`` shows them; None without.
    """

    time: Float[Array, " T"]
    state: State | ModedState | None
    observed: Any
    code: Int[Array, " N"]
    final_time: Float[Array, " N"]
    final_state: State | ModedState
    steps: Int[Array, " N"]
    rejected_steps: Int[Array, " N"]
    fault: Int[Array, " N"]
    first: int
    scene: Scene
    scene_axes: tuple[int | None, ...] = eqx.field(static=True)
    method: str = eqx.field(static=True)
    why: str = eqx.field(static=True)
    fields: Fields = eqx.field(static=True)
    event_record: EventRecord | None = None

    def _samples(self) -> Samples:
        if self.state is None:
            problem = "was not kept, as something else was observed"
            remedy = "give keep_states=True to rollkane.ensemble"
            raise FieldError("Ensemble.state", None, problem, remedy)
        axes = of_members(self.scene_axes)
        return Samples(self.scene, self.time, self.state, axes)

    @property
    def final(self) -> "FinalMotion":
        """Each member at its own end: ``final.position`` and so on, shape (N, ...)."""
        return FinalMotion(self)

    @property
    def final_position(self) -> Float[Array, "N 3"]:
        """Body origin O at the end [m], fixed axes, shape (N, 3)."""
        return self.final.position

    @property
    def observed_by_name(self) -> dict[str, Any]:
        """Arrays of what was observed by the keys that lead to them in its tree.

        ``observed`` where it is one array; several keys are joined by "_".
        """
        flat = cast("_Flat", jax.tree_util.tree_flatten_with_path(self.observed))
        found: dict[str, Any] = {}
        for path, value in flat[0]:
            keys = [jax.tree_util.keystr((key,), simple=True) for key in path]
            found["_".join(keys) or "observed"] = value
        return found

    @property
    def members(self) -> np.ndarray:
        """Numbers of the members, shape (N,)."""
        return self.first + np.arange(self.code.shape[-1])

    @property
    def reasons(self) -> dict[str, int]:
        """Why motions ended, and how many ended so."""
        ends = self._ends().reshape(-1, 3)
        rows, counts = np.unique(ends, axis=0, return_counts=True)
        every = zip(rows.tolist(), counts.tolist(), strict=True)
        return {
            self.fields.reason(code, fault, self._event(by)): n
            for (code, fault, by), n in every
        }

    @property
    def outcomes(self) -> np.ndarray:
        """Why each motion ended, in a word or two, shape (N,).

        Such as "completed", "stopped: lift-off" (of an event), "max steps",
        "bad scene: scene.body.mass".
        """
        ends = self._ends().reshape(-1, 3)
        rows, place = np.unique(ends, axis=0, return_inverse=True)
        names = [
            outcome_of(code, self._event(by), self.fields.name_of(fault))
            for code, fault, by in rows.tolist()
        ]
        return np.array(names)[place.reshape(np.shape(self.code))]

    def member(self, number: int) -> Trajectory:
        """One member's run, as ``rollkane.simulate`` gives it.

        Args:
            number: From 0 to N - 1.

        Raises:
            FieldError: no such member, or states that were not kept.
        """
        count = self.code.shape[-1]
        if not 0 <= number < count:
            remedy = f"give 0 to {count - 1}"
            raise FieldError("Ensemble.member", number, "is not there", remedy)
        samples = self._samples()
        own: Callable[[Any], Any] = lambda x: jnp.asarray(x[number])
        leaf: Callable[[int | None, Any], Any]
        leaf = lambda axis, x: x if axis is None else own(x)
        names = "code", "final_time", "final_state", "steps", "rejected_steps", "fault"
        parts = {name: jax.tree.map(own, getattr(self, name)) for name in names}
        return Trajectory(
            time=jnp.asarray(self.time),
            state=jax.tree.map(own, samples.state),
            scene=cast("Scene", by_axis(leaf, self.scene_axes, self.scene)),
            event_record=jax.tree.map(own, self.event_record),
            method=self.method,
            why=self.why,
            **parts,
        )

    def view(
        self, path: str | Path, title: str = "", member: int = 0, ghosts: int = 12
    ) -> None:
        """Write a page that shows a member in three dimensions, others as veils.

        Args:
            path: HTML file to write, .html or .htm.
            title: Of the page.
            member: Number of the one whose traces, forces and graphs are shown.
            ghosts: How many others, spread over the members; 32 at most.

        Raises:
            FieldError: no such member, states that were not kept, another ending.
        """
        shown = self.member(member)
        others = np.delete(np.arange(self.code.shape[-1]), member)
        places = np.linspace(0, max(others.size - 1, 0), min(ghosts, others.size))
        every = np.unique(others[places.round().astype(int)]).tolist()
        shown.view(path, title, [self.member(k) for k in every])

    def _ends(self) -> np.ndarray:
        """Code, fault and the event that ended it, of each member; shape (N, 3)."""
        code, found = np.asarray(self.code), self.event_record
        by = np.full(code.shape, -1) if found is None else np.asarray(found.by)
        return np.stack([code, np.asarray(self.fault), by], axis=-1)

    def _event(self, by: int) -> str:
        found = self.event_record
        return "" if found is None else found.name_of_end(by)

    def to_xarray(self) -> Any:
        """The ensemble as an ``xarray.Dataset`` over ``member`` and ``time``.

        See :func:`rollkane.files.export_ensemble.ensemble_to_xarray` (extra
        ``results``).
        """
        from ..files.export_ensemble import ensemble_to_xarray

        return ensemble_to_xarray(self)

    def plot(
        self,
        path: str | Path | None = None,
        of: str | Observable = "position",
        kind: str = "fan",
        title: str = "",
    ) -> Any:
        """Draw the ensemble (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            of: A quantity by its name, such as ``"position"`` or ``"energy"``; the name
                of something observed; or a function of the scene, the time [s] and one
                state.
            kind: ``"fan"``: median and the bands that hold 50 % and 90 % of the members
                against time. ``"histogram"``: of the values at each member's end.
                ``"scatter"``: the first two of them against each other, coloured by
                how the members ended.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.

        Raises:
            FieldError: no such quantity or kind, or states that were not kept.
        """
        from ..pictures.plot_ensemble import figure_ensemble, plot_ensemble

        if path is None:
            return figure_ensemble(self, of, kind, title)
        return plot_ensemble(self, path, of, kind, title)


class FinalMotion(AbstractMotion):
    """Each member of an ensemble at the time that it reached.

    All quantities of a :class:`Trajectory`, shape (N, ...) instead of (T, ...).
    """

    def __init__(self, ensemble: Ensemble):
        """Of an ensemble.

        Args:
            ensemble: Its states need not have been kept.
        """
        self.ensemble = ensemble
        self.code, self.event_record = ensemble.code, ensemble.event_record

    def _samples(self) -> Samples:
        runs = self.ensemble
        axes = (Axis(runs.scene_axes, 0),)
        return Samples(runs.scene, runs.final_time, runs.final_state, axes)


def joined(parts: Sequence[Ensemble], scene: Scene | None = None) -> Ensemble:
    """Blocks that follow each other, as one ensemble.

    Args:
        parts: Blocks of NumPy arrays; scenes differ in the same arrays in all of them.
        scene: That of all members; None: put together, too.
    """
    if len(parts) == 1:
        return parts[0]
    begun = parts[0]
    if scene is None:

        def of_leaf(axis: int | None, *own: Any) -> Any:
            return own[0] if axis is None else np.concatenate(own)

        scene = by_axis(of_leaf, begun.scene_axes, *(part.scene for part in parts))

    def together(name: str) -> Any:
        own = [getattr(part, name) for part in parts]
        return jax.tree.map(lambda *x: np.concatenate(x), *own)

    names = "state", "observed", "code", "final_time", "final_state", "steps"
    names += "rejected_steps", "fault", "event_record"
    values = {name: together(name) for name in names}
    shared = "time", "first", "scene_axes", "method", "why", "fields"
    values |= {name: getattr(begun, name) for name in shared}
    return Ensemble(scene=cast("Scene", scene), **values)
