"""What every motion can be asked for: quantities of its states, when asked."""

import abc
from collections.abc import Callable
from typing import Any, TypeAlias, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..codegen.compile_effort import for_many_numbers, for_one_call
from ..dynamics import observables
from ..dynamics.rolling import contact_force
from ..dynamics.scene import Scene
from ..geometry.rotations import in_one_sense
from ..hybrid.by_mode import by_mode
from ..hybrid.modes import Mode, ModedState
from ..kinematics.coordinates import State
from ..validation.codes import Code
from .event_record import Crossings
from .first_pull import first_pull_of
from .rolling_body_result import RollingBodyResult
from .samples import Axis, Samples, over_axes
from .unreached_outputs import of_reached

Observable: TypeAlias = Callable[[Scene, Float[Array, ""], Any], Any]


class AbstractMotion(abc.ABC):
    """States at some times, of one motion or of many, and what follows from them.

    Quantities have the axes of the states in front: (T, ...) of one motion, (N, T, ...)
    of N members of an ensemble, the batch before it under ``vmap``.
    """

    code: Any
    event_record: Any

    @abc.abstractmethod
    def _samples(self) -> Samples:
        """States, with their scene and times."""

    def each(self, observable: Observable) -> Any:
        """An observable of one state, at every time of every motion.

        Args:
            observable: Function of the scene, the time [s] and one state, such as
                those of ``rollkane.dynamics.observables``.

        Returns:
            Its values, shape (T, ...), with the members or the batch in front if there
            are some. Numbers are NaN where the motion was not reached, and so are
            derivatives that use them.

        Raises:
            FieldError: the motion has no states.
        """
        samples = self._samples()
        many = samples.state.angular_velocity.size > 3 * _MANY
        values = (evaluated if many else _evaluated_once)(observable, *samples)
        return samples.as_given(values)

    def rolling_body(self, *path: int) -> RollingBodyResult:
        """Motion of a body that rolls on or in the rolling body.

        Args:
            *path: Which: index among the bodies that roll on the rolling body (0 when
                left out); then among those that roll on that one, and so on.

        Raises:
            FieldError: there is no such body.
        """
        return RollingBodyResult(self, self._samples(), path or (0,))

    @property
    def first_pull(self) -> Float[Array, ""]:
        """When the contact would first have to pull [s]; NaN where it never does.

        The contact is bilateral and the motion runs on. The time is found by runs from
        each output to the next, at the default tolerance, whose steps end where the
        normal force is zero or least: it does not depend on which outputs were asked
        for. What is behind the last that was reached is not looked at. It is
        differentiable; where the force jumps through zero its derivative is NaN.

        Raises:
            FieldError: of ends alone, or of many runs with modes.
        """
        return first_pull_of(self._samples(), observables.normal_force)

    @property
    def mode(self) -> Int[Array, " T"]:
        """Whether it rolls, slips or flies, one of :class:`Mode`, shape (T,)."""
        scene, _, state, _ = self._samples()
        if isinstance(state, ModedState):
            return state.mode
        mode = Mode.SLIPPING if scene.contact.slips else Mode.ROLLING
        return jnp.full(state.angular_velocity.shape[:-1], mode)

    @property
    def succeeded(self) -> Any:
        """Whether the last time was reached, by motion."""
        return self.code == Code.COMPLETED

    @property
    def events(self) -> dict[str, Crossings]:
        """Where each event happened, by its name: ``times`` [s], ``states``, ``count``.

        Differentiable, where it crosses its zero (NaN where it only grazes it, or
        jumps). Of a run with known numbers only what happened; of many runs, traced, or
        under ``vmap``, all that is kept, unused places NaN.

        Source: docs/theory.md, (8.13).
        """
        return {} if self.event_record is None else self.event_record.by_name()

    @property
    def position(self) -> Float[Array, "T 3"]:
        """Body origin O [m], fixed axes, shape (T, 3)."""
        return self.each(observables.position)

    @property
    def velocity(self) -> Float[Array, "T 3"]:
        """Of the body origin O [m/s], fixed axes, shape (T, 3)."""
        return self.each(observables.velocity)

    @property
    def orientation(self) -> Float[Array, "T 4"]:
        """Unit quaternion, scalar first, body to fixed axes [1], shape (T, 4).

        Continuous in sign.
        """
        orientation = self.each(observables.orientation)
        if isinstance(self._samples().state, (State, ModedState)):
            return orientation  # integrated, and so continuous
        sense = in_one_sense
        for _ in range(orientation.ndim - 2):
            sense = jax.vmap(sense)
        return sense(orientation)

    @property
    def angular_velocity(self) -> Float[Array, "T 3"]:
        """[rad/s], fixed axes, shape (T, 3)."""
        return self.each(observables.angular_velocity)

    @property
    def slip(self) -> Float[Array, "T 3"]:
        """``U``, of the body's point at the contact over the base [m/s], shape (T, 3).

        FIXED axes; zero where the body rolls.
        """
        return self.each(observables.slip)

    @property
    def contact_on_body(self) -> Float[Array, "T 3"]:
        """Contact point from the body origin [m], body axes, shape (T, 3)."""
        return self.each(observables.contact_on_body)

    @property
    def contact_on_base(self) -> Float[Array, "T 3"]:
        """Contact point [m], base axes, shape (T, 3)."""
        return self.each(observables.contact_on_base)

    @property
    def contact_force(self) -> Float[Array, "T 3"]:
        """Force of the base on the body [N], fixed axes, shape (T, 3), (6.2).

        While a slip begins (below 1e-5 m/s, at most about a millisecond) friction's
        direction leaves out how it lags, some 1e-4 of the friction: (8.5).
        """
        return self.each(contact_force)

    @property
    def normal_force(self) -> Float[Array, " T"]:
        """Normal part of the contact force [N], shape (T,); > 0 while pressed together.

        Source: docs/theory.md, (6.2), N = -Rc . e_out.
        """
        return self.each(observables.normal_force)

    @property
    def friction_ratio(self) -> Float[Array, " T"]:
        """Friction coefficient that rolling needs, ``|T| / N`` [1], shape (T,)."""
        return self.each(observables.friction_ratio)

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
        """``E - v_Oc . P - w_c . J_Oc`` [J], shape (T,): kept on a steady turntable."""
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
        return self.each(observables.base_position)

    @property
    def base_rotation(self) -> Float[Array, "T 3 3"]:
        """Base to fixed axes [1], shape (T, 3, 3)."""
        return self.each(observables.base_rotation)

    @property
    def alpha(self) -> Float[Array, "T n"]:
        """Coordinates of what is supported, shape (T, n)."""
        return self._samples().state.alpha

    @property
    def alpha_dot(self) -> Float[Array, "T n"]:
        """Their rates [1/s], shape (T, n)."""
        return self._samples().state.alpha_dot


def _evaluated(
    observable: Observable, scene: Scene, time: Any, state: Any, axes: tuple[Axis, ...]
) -> Any:
    """An observable of states; see :class:`Samples`."""
    if isinstance(state, ModedState):
        observable = cast("Observable", by_mode(cast("Any", observable)))
    mapped = over_axes(observable, scene, axes, state.angular_velocity.ndim - 1)
    times = jnp.asarray(time)
    return of_reached(lambda y: mapped(scene, times, y), state)


# in one program, of blocks that follow each other
evaluated = for_many_numbers(_evaluated)
_evaluated_once = for_one_call(_evaluated)
# States of which a program that was compiled with little effort takes 20 to 90 ms
# longer, and compiling 200 to 600 ms less
_MANY = 100_000
