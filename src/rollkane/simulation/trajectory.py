"""What came out: a trajectory, with everything else computed from it when asked."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..dynamics.diagnosis import first_not_finite
from ..dynamics.scene import Scene
from ..hybrid.modes import HybridScene, ModedState, Switches
from ..kinematics.voronets import AnyState
from ..validation.checks import FieldError, is_traced
from ..validation.codes import NO_FAULT, Code, Fields, outcome_of
from ..validation.shown import described, in_a_line
from .event_record import EventRecord
from .motion import AbstractMotion
from .samples import Axis, Samples


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Trajectory(AbstractMotion):
    """Motion of a scene at T times; under ``vmap`` every array has the batch in front.

    Attributes:
        time: [s], shape (T,).
        state: States, every array with a leading T; NaN where not reached.
            :class:`State`, or :class:`VoronetsState` if those coordinates were asked.
        scene: The scene that moved.
        code: Why the run ended, one of :class:`Code`; 0 is success.
        final_time: Time that was reached [s].
        final_state: State at that time.
        steps: Accepted steps.
        rejected_steps: Rejected steps.
        switches: Changes between rolling, slipping and flight; None in a run without.
        fault: Which number of the scene, the start or the times cannot be used, as
            ``reason`` names it; -1: none.
        event_record: Events of the run, as ``events`` shows them; None without.
        method: Which loop made it, ``"native"`` (C) or ``"diffrax"`` (XLA).
        why: Why it is not the loop in C, in a sentence; empty where it is.
    """

    time: Float[Array, " T"]
    state: AnyState | ModedState
    scene: Scene
    code: Int[Array, ""]
    final_time: Float[Array, ""]
    final_state: AnyState | ModedState
    steps: Int[Array, ""]
    rejected_steps: Int[Array, ""]
    switches: Switches | None = None
    fault: Int[Array, ""] | int = NO_FAULT
    event_record: EventRecord | None = None
    method: str = dataclasses.field(metadata={"static": True}, default="diffrax")
    why: str = dataclasses.field(metadata={"static": True}, default="")

    def __repr__(self) -> str:
        """When, how it ended, what moved and where it came to, in a few lines."""
        several = len(np.shape(self.code)) > 0
        if several or is_traced(self.code, self.time, self.steps):
            return described(self)
        code, time, state = int(self.code), np.asarray(self.time), self.final_state
        scene, steps = self.scene, f"{int(self.steps)} steps ({self.method})"
        what = f"{type(scene.body.surface).__name__} of {float(scene.body.mass):g} kg"
        if isinstance(state, ModedState):
            state = state.in_its_mode
        return (
            f"Trajectory(\n  time={time[0]:g} to {time[-1]:g} s in {time.size} outputs,"
            f"\n  code={code} ({outcome_of(code)}), final_time="
            f"{float(self.final_time):g} s, {steps},"
            f"\n  scene={what} on {type(scene.base.surface).__name__},"
            f"\n  final_state={in_a_line(state)},\n)"
        )

    def __eq__(self, other: object) -> Any:
        """Whether all numbers are equal."""
        return eqx.tree_equal(self, other)

    def _samples(self) -> Samples:
        return Samples(
            self.scene, self.time, self.state, (Axis(None, 0, of_times=True),)
        )

    @property
    def reason(self) -> str:
        """Why a single run ended, and what to do about it.

        Where a number cannot be used it names the field; where the first rates are not
        finite, what gives them.
        """
        start, scene = self.final_state, self.scene
        if isinstance(start, ModedState):
            assert isinstance(scene, HybridScene)
            start, scene = start.parts, scene.in_modes.rolling
        if int(self.code) == Code.BAD_START and int(self.fault) == NO_FAULT:
            return first_not_finite(scene, self.final_time, start)
        event, found = "", self.event_record
        if found is not None:
            event = found.name_of_end(int(found.by))
        return Fields.of(self.scene, start).reason(self.code, self.fault, event)

    @property
    def first_pull(self) -> Float[Array, ""]:
        """As of any motion; with modes, when the contact was first lost [s]."""
        if self.switches is not None:
            return self.switches.first_lift
        return super().first_pull

    def with_its_end(self) -> "Trajectory":
        """A single run with its end among the outputs, in place of the next one.

        The outputs of a run that ended between two of them (by an event, say) do not
        hold it. Where they do, or none was reached, the run itself.

        Raises:
            FieldError: a batch.
        """
        if np.ndim(self.final_time):
            problem = "is a batch, of which every run ends at its own time"
            remedy = "take one run: jax.tree.map(lambda x: x[i], trajectory)"
            raise FieldError("trajectory", np.shape(self.final_time), problem, remedy)
        time, end = np.asarray(self.time), float(self.final_time)
        count = int(np.sum(np.abs(time - time[0]) <= abs(end - time[0])))
        if not 0 < count < time.size or time[count - 1] == end:
            return self

        def put(rows: Array, end: Array) -> Array:
            return jnp.asarray(rows).at[count].set(end)

        times = put(self.time, self.final_time)
        states = jax.tree.map(put, self.state, self.final_state)
        return dataclasses.replace(self, time=times, state=states)

    def to_xarray(self) -> Any:
        """The trajectory as an ``xarray.Dataset`` with units (extra ``results``)."""
        from ..files.export import to_xarray

        return to_xarray(self)

    def plot(self, path: str | Path | None = None, title: str = "") -> Any:
        """Spin, tilt, energy error and normal force against time (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plotting import figure_overview, plot_overview

        if path is None:
            return figure_overview(self, title=title)
        return plot_overview(self, path, title=title)

    def view(
        self,
        path: str | Path,
        title: str = "",
        ghosts: "Sequence[Trajectory]" = (),
    ) -> None:
        """Write one self-contained page that shows the motion in three dimensions.

        Args:
            path: HTML file to write, .html or .htm; opens from disk, without a network.
            title: Of the page.
            ghosts: Other runs of the same body, shown as veils; 32 at most.

        Raises:
            FieldError: another ending, a batch, or no state that could be shown.
        """
        from ..pictures.viewer import write_view

        write_view(self, path, title, ghosts)
