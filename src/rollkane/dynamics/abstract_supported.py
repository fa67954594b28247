"""What every supported part gives to the mechanics, whatever moves it."""

import abc
from collections.abc import Callable, Iterator, Sequence
from typing import Any, cast

import equinox as eqx
import jax
from jaxtyping import Array, Float

from ..geometry.small_linear import components, dot
from ..kinematics.contact import Contact
from ..kinematics.coordinates import State
from ..validation.checks import FieldError
from .carried import Carried, Pairing
from .coordinate_functions import Apart


class AbstractSupported(eqx.Module):
    """Something carried, with ``count`` quasi-velocities.

    They are the rates of as many coordinates alpha, or, of a body that rolls on its
    carrier, those of its ``State``, which then stands for alpha in all methods.
    """

    count: eqx.AbstractVar[int]

    @property
    def part(self) -> "AbstractSupported":
        """What is carried, whether its motion is prescribed or not."""
        return self

    @property
    def apart(self) -> Apart | None:
        """How its coordinates are shared out among its masses; None: they are not."""
        return None

    @abc.abstractmethod
    def carried(self, t: Array, alpha: Any, alpha_dot: Float[Array, " n"]) -> Carried:
        """Its masses at one instant."""

    def carried_apart(
        self,
        apart: Apart | None,
        t: Array,
        alpha: Any,
        alpha_dot: Float[Array, " n"],
    ) -> Carried:
        """Its masses at one instant, with fewer columns where they are ``apart``.

        A column for the first coordinate of every mass, one for the second, ...
        """
        del apart  # None: only a part that says otherwise shares them out
        return self.carried(t, alpha, alpha_dot)

    @abc.abstractmethod
    def generalized_force(
        self, t: Array, alpha: Any, alpha_dot: Float[Array, " n"]
    ) -> Float[Array, " n"] | None:
        """``Q_s`` of springs, dampers and motors [J per unit of alpha]; None: none.

        The part with a potential is not in it.
        """

    @abc.abstractmethod
    def potential_energy(self, alpha: Any) -> Float[Array, ""] | None:
        """Energy of its springs [J]; None where it gives no potential."""

    @property
    @abc.abstractmethod
    def does_work(self) -> bool:
        """Whether it gives energy to the system or takes some, springs excepted."""

    def applied(
        self, t: Array, alpha: Any, alpha_dot: Array, pairing: Pairing | None = None
    ) -> list[Array] | None:
        """``Q_s``, springs included, one entry for each quasi-velocity; None: none.

        Args:
            t: Time [s].
            alpha: Its coordinates.
            alpha_dot: Their rates.
            pairing: Its contact with the carrier; None: it does not roll.
        """
        del pairing
        if not self.count:
            return None
        force = self.generalized_force(t, alpha, alpha_dot)
        if self.potential_energy(alpha) is not None:
            stored: Callable[[Array], Array | None] = lambda a: self.potential_energy(a)
            spring = -cast(Array, jax.grad(stored)(alpha))
            force = spring if force is None else force + spring
        return None if force is None else components(force)

    def drive_power(self, t: Array, alpha: Any, alpha_dot: Array) -> Array | None:
        """Power of springs without a potential, dampers and motors [W]; None: none."""
        if not self.count:
            return None
        force = self.generalized_force(t, alpha, alpha_dot)
        return None if force is None else dot(force, alpha_dot)


class AbstractRollingPart(AbstractSupported):
    """A part that rolls on its carrier: a ``State`` relative to it is its alpha."""

    @property
    @abc.abstractmethod
    def scene(self) -> Any:
        """The ``Scene`` of the pair alone."""

    @abc.abstractmethod
    def axes(self, contact: Contact) -> tuple[Array, ...]:
        """Along which its relative angular velocity may be, its own axes.

        Args:
            contact: Of the pair.
        """

    @abc.abstractmethod
    def velocities(self, t: Array, state: State) -> list[Array]:
        """Its quasi-velocities, and those of what it carries.

        Args:
            t: Time [s].
            state: Its own.
        """

    @abc.abstractmethod
    def rates(
        self, state: State, pairing: Pairing, accelerations: Sequence[Array]
    ) -> State:
        """Rates of its state.

        Args:
            state: Its own.
            pairing: Its contact.
            accelerations: Of its quasi-velocities, and of those of what it carries.
        """


def rolling_parts(supported: Sequence[AbstractSupported]) -> list[AbstractRollingPart]:
    """The parts that roll on their carrier."""
    return [part for part in supported if isinstance(part, AbstractRollingPart)]


def refuse_rolling_parts(field: str, supported: Sequence[AbstractSupported]) -> None:
    """Refuse a scene in which bodies roll on the rolling body, where none may.

    Args:
        field: Name used in the error.
        supported: Parts of the scene.

    Raises:
        FieldError: one of them rolls on its carrier.
    """
    for k, part in enumerate(supported):
        if isinstance(part, AbstractRollingPart):
            raise FieldError(
                field,
                f"a {type(part).__name__}, supported[{k}]",
                "cannot be used where bodies roll on the rolling body",
                "leave these out, or use simulate or ensemble without it",
            )


def rates_of_rolling(
    supported: Sequence[AbstractSupported],
    states: Sequence[State],
    pairings: Sequence[Pairing],
    accelerations: Sequence[Array],
) -> tuple[State, ...]:
    """Rates of the states of all parts that roll on one carrier.

    Args:
        supported: All its parts.
        states: Of those that roll.
        pairings: Their contacts.
        accelerations: Of their quasi-velocities, one after another.
    """
    found: list[State] = []
    first = 0
    parts = rolling_parts(supported)
    for part, state, pairing in zip(parts, states, pairings, strict=True):
        own = accelerations[first : first + part.count]
        found.append(part.rates(state, pairing, own))
        first += part.count
    return tuple(found)


def shares(
    supported: Sequence[AbstractSupported],
    alpha: Array,
    alpha_dot: Array,
    rolling: Sequence[State] = (),
) -> Iterator[tuple[AbstractSupported, Any, Array]]:
    """Each supported part with its own coordinates and rates; those that roll last.

    Args:
        supported: The parts.
        alpha: Coordinates of those that do not roll on their carrier, shape (n,).
        alpha_dot: Their rates, shape (n,).
        rolling: A ``State`` for each part that rolls; for it the rates are empty.
    """
    start = 0
    for part in supported:
        if not isinstance(part, AbstractRollingPart):
            end = start + part.count
            yield part, alpha[start:end], alpha_dot[start:end]
            start = end
    for part, state in zip(rolling_parts(supported), rolling, strict=True):
        yield part, state, alpha[:0]
