"""What came out: a trajectory, with everything else computed from it when asked."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..dynamics import observables
from ..dynamics.diagnosis import first_not_finite
from ..dynamics.rolling import contact_force, contact_of, rolling_derivative
from ..dynamics.scene import Scene
from ..geometry.rotations import in_one_sense, quaternion_of
from ..geometry.small_linear import matvec, norm
from ..hybrid.modes import HybridScene, Mode, ModedState, Switches, by_mode
from ..kinematics.coordinates import State
from ..kinematics.voronets import AnyState
from ..validation.codes import NO_FAULT, Code, Fields
from .event_record import Crossings, EventRecord


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
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
        """Shapes and types of everything."""
        return eqx.tree_pformat(self)

    def __eq__(self, other: object) -> Any:
        """Whether all numbers are equal."""
        return eqx.tree_equal(self, other)

    def each(self, observable: Callable[[Scene, Array, Any], Any]) -> Any:
        """An observable of one state, at every time of every lane.

        Args:
            observable: Function of the scene, the time [s] and one state, such as
                those of ``rollkane.dynamics.observables``.

        Returns:
            Its values, shape (T, ...), with the batch in front if there is one.
        """
        return _each(observable, self.scene, self.time, self.state)

    @property
    def mode(self) -> Int[Array, " T"]:
        """Whether it rolls, slips or flies, one of :class:`Mode`, shape (T,)."""
        if isinstance(self.state, ModedState):
            return self.state.mode
        slips = self.scene.contact.slips
        return jnp.full(self.time.shape, Mode.SLIPPING if slips else Mode.ROLLING)

    @property
    def succeeded(self) -> Array:
        """Whether the run reached its last time, by lane."""
        return self.code == Code.COMPLETED

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
    def events(self) -> dict[str, Crossings]:
        """Where each event happened, by its name: ``times`` [s], ``states``, ``count``.

        Differentiable, where it crosses its zero (NaN where it only grazes it, or
        jumps). Of a run with known numbers only what happened; traced, or under
        ``vmap``, all that is kept, unused places NaN.

        Source: docs/theory.md, (8.13).
        """
        return {} if self.event_record is None else self.event_record.by_name()

    @property
    def position(self) -> Float[Array, "T 3"]:
        """Body origin O [m], fixed axes, shape (T, 3)."""
        return self.each(_position)

    @property
    def orientation(self) -> Float[Array, "T 4"]:
        """Unit quaternion, scalar first, body to fixed axes [1], shape (T, 4).

        Continuous in sign.
        """
        orientation = self.each(_orientation)
        if isinstance(self.state, (State, ModedState)):
            return orientation  # integrated, and so continuous
        sense = in_one_sense
        for _ in range(orientation.ndim - 2):
            sense = jax.vmap(sense)
        return sense(orientation)

    @property
    def angular_velocity(self) -> Float[Array, "T 3"]:
        """[rad/s], fixed axes, shape (T, 3)."""
        return self.each(_angular_velocity)

    @property
    def slip(self) -> Float[Array, "T 3"]:
        """``U``, of the body's point at the contact over the base [m/s], shape (T, 3).

        FIXED axes; zero where the body rolls.
        """
        return self.each(_slip)

    @property
    def contact_on_body(self) -> Float[Array, "T 3"]:
        """Contact point from the body origin [m], body axes, shape (T, 3)."""
        return self.each(_contact_on_body)

    @property
    def contact_on_base(self) -> Float[Array, "T 3"]:
        """Contact point [m], base axes, shape (T, 3)."""
        return self.each(_contact_on_base)

    @property
    def contact_force(self) -> Float[Array, "T 3"]:
        """Force of the base on the body [N], fixed axes, shape (T, 3), (6.2)."""
        return self.each(contact_force)

    @property
    def normal_force(self) -> Float[Array, " T"]:
        """Normal part of the contact force [N], shape (T,); > 0 while pressed together.

        Source: docs/theory.md, (6.2), N = -Rc . e_out.
        """
        return self.each(observables.normal_force)

    @property
    def friction_ratio(self) -> Float[Array, " T"]:
        """Friction coefficient that rolling needs, |tangential| / N [1], shape (T,)."""
        return self.each(observables.friction_ratio)

    @property
    def first_pull(self) -> Float[Array, ""]:
        """When the contact would first have to pull [s]; NaN where it never does.

        The contact is bilateral and the motion runs on. The time is found between
        outputs on the cubic through values and slopes of the normal force, so its
        error falls with the fourth power of the distance of the outputs.
        """
        if self.switches is not None:
            return self.switches.first_lift
        return _first_pull(self.time, self.scene, self.state)

    @property
    def energy(self) -> Float[Array, " T"]:
        """Kinetic plus potential energy [J], shape (T,).

        Fields of loads and springs given by a potential count as potential energy.
        """
        return self.each(observables.energy)

    @property
    def power(self) -> Float[Array, " T"]:
        """Rate of the energy [W], shape (T,): of the base and of forces inside."""
        return self.each(observables.power)

    @property
    def moving_energy(self) -> Float[Array, " T"]:
        """``E - v_Oc . P - w_c . J`` [J], shape (T,): kept on a steady turntable."""
        return self.each(observables.moving_energy)

    @property
    def momentum(self) -> Float[Array, "T 3"]:
        """Of the whole system [kg m/s], fixed axes, shape (T, 3)."""
        return self.each(observables.momentum)

    @property
    def angular_momentum(self) -> Float[Array, "T 3"]:
        """Of the whole system about the fixed origin [kg m^2/s], fixed axes, (T, 3)."""
        return self.each(observables.angular_momentum)

    @property
    def base_position(self) -> Float[Array, "T 3"]:
        """Base origin [m], fixed axes, shape (T, 3)."""
        return self.each(_base_position)

    @property
    def base_rotation(self) -> Float[Array, "T 3 3"]:
        """Base to fixed axes [1], shape (T, 3, 3)."""
        return self.each(_base_rotation)

    @property
    def alpha(self) -> Float[Array, "T n"]:
        """Coordinates of what is supported, shape (T, n)."""
        return self.state.alpha

    @property
    def alpha_dot(self) -> Float[Array, "T n"]:
        """Their rates [1/s], shape (T, n)."""
        return self.state.alpha_dot

    def to_xarray(self) -> Any:
        """The trajectory as an ``xarray.Dataset`` with units (extra ``results``)."""
        from ..files.export import to_xarray

        return to_xarray(self)

    def plot(self, path: str | Path | None = None, title: str = "") -> Any:
        """Spin, tilt, energy error and normal force against time (extra ``plot``).

        Args:
            path: PNG file to write; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plotting import figure_overview, plot_overview

        if path is None:
            return figure_overview(self, title=title)
        return plot_overview(self, path, title=title)

    def view(self, path: str | Path, title: str = "") -> None:
        """Write one self-contained page that shows the motion in three dimensions.

        Args:
            path: HTML file to write; opens from disk, without a network.
            title: Of the page.
        """
        from ..pictures.viewer import write_view

        write_view(self, path, title=title)


def _pressing(scene: Scene, t: Array, state: Any) -> tuple[Array, Array]:
    """Normal force and its rate along the motion [N], [N/s]."""
    rates = rolling_derivative(scene, t, state)
    force: Callable[[Array, Any], Array] = lambda t, s: observables.normal_force(
        scene, t, s
    )
    return jax.jvp(force, (t, state), (jnp.ones_like(t), rates))


@eqx.filter_jit
def _first_pull(time: Array, scene: Scene, state: Any) -> Array:
    if time.ndim > 1:
        return jax.vmap(_first_pull)(time, scene, state)
    # one state after the other: mapped over all, it takes four times as long to compile
    one: Callable[[tuple[Array, Any]], tuple[Array, Array]] = lambda x: _pressing(
        scene, *x
    )
    values, slopes = cast(tuple[Array, Array], jax.lax.map(one, (time, state)))
    return _first_fall(time, values, slopes)


def _first_fall(time: Array, values: Array, slopes: Array) -> Array:
    """First time at which a sampled function with slopes is not positive; else NaN."""
    grid = jnp.linspace(0.0, 1.0, 17, dtype=time.dtype)

    def cubic(i: Array, x: Array) -> Array:
        span = time[i + 1] - time[i]
        v0, v1 = values[i], values[i + 1]
        d0, d1 = slopes[i] * span, slopes[i + 1] * span
        bend = (3.0 * (v1 - v0) - 2.0 * d0 - d1) + (d0 + d1 - 2.0 * (v1 - v0)) * x
        return v0 + x * (d0 + x * bend)

    intervals = jnp.arange(time.shape[0] - 1)

    def looked_at(i: Array) -> Array:
        at: Callable[[Array], Array] = lambda x: cubic(i, x)
        return jax.vmap(at)(grid)

    inside = jax.vmap(looked_at)(intervals)
    fallen = (inside <= 0).reshape(-1)
    first = jnp.argmax(fallen)
    i, k = first // 17, first % 17
    low, high = grid[jnp.maximum(k - 1, 0)], grid[k]

    def halve(_: Array, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        mid = 0.5 * (low + high)
        below = cubic(i, mid) <= 0
        return jnp.where(below, low, mid), jnp.where(below, mid, high)

    _, x = cast(tuple[Array, Array], jax.lax.fori_loop(0, 60, halve, (low, high)))
    found = time[i] + x * (time[i + 1] - time[i])
    return jnp.where(jnp.any(fallen), found, jnp.nan)


def _position(scene: Scene, t: Array, state: Any) -> Float[Array, "3"]:
    return contact_of(scene, t, state).position


def _orientation(scene: Scene, t: Array, state: Any) -> Float[Array, "4"]:
    contact = contact_of(scene, t, state)
    if contact.orientation is None:
        return quaternion_of(contact.rotation)
    return contact.orientation / norm(contact.orientation)


def _angular_velocity(scene: Scene, t: Array, state: Any) -> Float[Array, "3"]:
    contact = contact_of(scene, t, state)
    return matvec(contact.rotation, contact.angular_velocity)


def _slip(scene: Scene, t: Array, state: Any) -> Float[Array, "3"]:
    contact = contact_of(scene, t, state)
    slip = contact.slip
    zero = jnp.zeros_like(contact.normal)
    if slip is None or not state.touches:
        return zero
    return matvec(contact.rotation, slip)


def _contact_on_body(scene: Scene, t: Array, state: Any) -> Float[Array, "3"]:
    point = contact_of(scene, t, state).body_point
    return point if state.touches else jnp.full_like(point, jnp.nan)


def _contact_on_base(scene: Scene, t: Array, state: Any) -> Float[Array, "3"]:
    point = contact_of(scene, t, state).base_point
    return point if state.touches else jnp.full_like(point, jnp.nan)


def _base_position(scene: Scene, t: Array, state: Any) -> Float[Array, "3"]:
    still = jnp.zeros_like(state.angular_velocity)
    motion = scene.base.motion
    return still if motion is None else motion.at(t).placed(still)


def _base_rotation(scene: Scene, t: Array, state: Any) -> Float[Array, "3 3"]:
    motion = scene.base.motion
    rotation = None if motion is None else motion.at(t).rotation
    return jnp.eye(3, dtype=t.dtype) if rotation is None else rotation


@eqx.filter_jit
def _each(observable: Any, scene: Scene, time: Array, state: Any) -> Array:
    if isinstance(state, ModedState):
        observable = by_mode(observable)
    mapped = jax.vmap(observable, in_axes=(None, 0, 0))
    for _ in range(state.angular_velocity.ndim - 2):
        mapped = jax.vmap(mapped)
    return mapped(scene, time, state)
