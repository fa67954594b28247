"""A system of :mod:`rollkane.kane` as a problem of steady motions."""

from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..codegen.tracing import running_once
from ..kane.equations import kane_derivative
from ..kane.system import KaneState, KaneSystem
from ..kinematics.coordinates import pack
from ..validation.checks import FieldError
from .affine_symmetries import affine_symmetries
from .configured import configured
from .problem import AbstractProblem
from .time_dependence import differing, uses_time, wide_times


class KaneProblem(AbstractProblem):
    """Steady motions of a system, at the time zero.

    Attributes:
        system: The system.
        laws: ``[M, b]`` of the generators ``q' = M q + b``, shape (K, n, n + 1).
        group: Their names.
        units: Of all coordinates, then of the independent speeds: changes alike.
    """

    system: KaneSystem
    laws: Float[Array, "K n m"]
    units: Float[Array, " x"]
    group: tuple[str, ...] = eqx.field(static=True)

    def coordinates(self, state: Any) -> tuple[tuple[str, ...], tuple[bool, ...]]:
        """Independent coordinates and speeds, by their numbers."""
        del state
        q = tuple(f"q[{k}]" for k in self.system.independent_coordinates)
        u = tuple(f"u[{k}]" for k in range(len(self.system.independent)))
        return q + u, (False,) * len(q) + (True,) * len(u)

    def sizes(self, state: Any) -> tuple[np.ndarray, float]:
        """Of the guess, one where it has none, since nothing else is known of these."""
        del state
        units, count = np.asarray(self.units, float), self.system.coordinates
        free = np.asarray(self.system.independent_coordinates, int)
        return np.concatenate([units[free], units[count:]]), 0.0

    def moved(self, state: Any, x: Float[Array, " n"]) -> KaneState:
        """The state at coordinates x around another, on its configuration."""
        free = np.asarray(self.system.independent_coordinates, int)
        q = state.q.at[free].add(x[: free.size])
        return KaneState(configured(self.system, q), state.u + x[free.size :])

    def image(self, reference: Any, state: Any) -> Float[Array, " m"]:
        """All coordinates and speeds."""
        del reference
        return jnp.concatenate([state.q, state.u])

    def rates(self, state: Any) -> KaneState:
        """The right-hand side."""
        return kane_derivative(self.system, jnp.zeros_like(state.q[0]), state)

    def generator(self, state: Any, velocities: Float[Array, " K"]) -> KaneState:
        """Tangent of a state that moves with given group velocities."""
        law = jnp.tensordot(velocities, self.laws, 1)
        return _generated(law, state)

    def along_group(self, state: Any, steps: Float[Array, " K"]) -> KaneState:
        """The state moved by a group element."""
        law = jnp.tensordot(steps, self.laws, 1)
        whole = jnp.concatenate([law, jnp.zeros_like(law[:1])])
        flow = cast(Array, jax.scipy.linalg.expm(whole))
        n = state.q.shape[0]
        return KaneState(flow[:n, :n] @ state.q + flow[:n, n], state.u)

    def carried(self, state: Any, time: Float[Array, ""]) -> KaneState:
        """The state itself: nothing is carried by time."""
        del time
        return state

    @property
    def model(self) -> KaneSystem:
        """The system."""
        return self.system

    def with_model(self, model: Any) -> "KaneProblem":
        """Of a system with other numbers and the same symmetries."""
        return eqx.tree_at(lambda p: p.system, self, model)


def _generated(law: Float[Array, "n m"], state: KaneState) -> KaneState:
    return KaneState(law[:, :-1] @ state.q + law[:, -1], 0.0 * state.u)


def kane_problem(system: KaneSystem, guess: Any) -> tuple[KaneProblem, KaneState]:
    """The problem of a system, with its symmetries, and the guess on its configuration.

    Symmetries are looked for among all affine motions of the coordinates: shifts of
    those that the equations do not look at, turns of a plane with a heading.

    Args:
        system: The system.
        guess: A ``KaneState``.

    Raises:
        FieldError: another guess, of single precision, or a system that depends on
            time.
    """
    _refuse_multipliers(system)
    if not isinstance(guess, KaneState):
        remedy = "give KaneState(q, u) with the independent speeds"
        raise FieldError("steady_motion.guess", guess, "is no KaneState", remedy)
    state = KaneState(*(jnp.asarray(x, float) for x in (guess.q, guess.u)))
    if state.q.dtype != np.float64:
        problem = "is in single precision, in which no rank can be told"
        remedy = 'call jax.config.update("jax_enable_x64", True) first'
        raise FieldError("steady_motion.guess", "float32", problem, remedy)
    found = affine_symmetries(system, state)
    if found.by_time or _changes(system, found.states):
        problem = "depends on time"
        remedy = "leave out loads and motions that are functions of time"
        raise FieldError("steady_motion.scene", "a KaneSystem", problem, remedy)
    laws, units = jnp.asarray(found.laws), jnp.asarray(found.units)
    return KaneProblem(group=found.names, system=system, laws=laws, units=units), state


def _refuse_multipliers(system: KaneSystem) -> None:
    """Refuse speeds of which not all are free: small motions have other numbers."""
    if system.by_multipliers and system.constraints is not None:
        raise FieldError(
            "steady_motion.scene",
            "a KaneSystem",
            "has constraints that act by multipliers, so that none of its speeds is "
            "chosen as dependent",
            "name dependent speeds (of rolling contacts: RollingSystem.eliminated)",
        )


def _changes(system: KaneSystem, states: KaneState) -> bool:
    """Whether rates of some states at other times are not those at zero."""
    one = KaneState(states.q[0], states.u[0])
    if not uses_time(kane_derivative, system, one):
        return False
    rates = _over_time(system, wide_times(system.kinks), states)
    return bool(differing(np.asarray(rates)).size)


@for_one_call
@running_once()
def _over_time(system: KaneSystem, times: Array, states: KaneState) -> Array:
    def at(t: Array, state: KaneState) -> Array:
        y = KaneState(configured(system, state.q), state.u)
        rates = pack(kane_derivative(system, t, y))
        return jnp.stack([rates, jnp.full_like(rates, jnp.max(jnp.abs(rates)))])

    over = jax.vmap(at, (None, 0))
    return jax.vmap(over, (0, None))(times, states)
