"""A system of :mod:`rollkane.kane` as a problem of steady motions."""

from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..kane.equations import kane_derivative
from ..kane.system import KaneState, KaneSystem
from ..kinematics.coordinates import pack
from ..validation.checks import FieldError
from .problem import AbstractProblem
from .surface_motions import LOOSE, echelon, null_space
from .time_dependence import differing, uses_time, wide_times

_STATES, _SPREAD = 12, 0.3  # random ones, and how far from the guess
_NEWTON = 8  # steps to the configuration, from beside it


class KaneProblem(AbstractProblem):
    """Steady motions of a system, at the time zero.

    Attributes:
        system: The system.
        laws: ``[M, b]`` of the generators ``q' = M q + b``, shape (K, n, n + 1).
        group: Their names.
    """

    system: KaneSystem
    laws: Float[Array, "K n m"]
    group: tuple[str, ...] = eqx.field(static=True)

    def coordinates(self, state: Any) -> tuple[tuple[str, ...], tuple[bool, ...]]:
        """Independent coordinates and speeds, by their numbers."""
        del state
        q = tuple(f"q[{k}]" for k in self.system.independent_coordinates)
        u = tuple(f"u[{k}]" for k in range(len(self.system.independent)))
        return q + u, (False,) * len(q) + (True,) * len(u)

    def sizes(self, state: Any) -> tuple[np.ndarray, float]:
        """One of its unit each, since nothing is known of these."""
        return np.ones(len(self.coordinates(state)[0])), 0.0

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


def violation(system: KaneSystem, q: Float[Array, " n"]) -> Float[Array, " c"]:
    """By how much coordinates miss the configuration; shape (0,) without one."""
    if system.configuration is None:
        return q[:0]
    rest = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    return system.at(system.configuration, jnp.zeros_like(q[0]), q, rest)


def configured(system: KaneSystem, q: Float[Array, " n"]) -> Float[Array, " n"]:
    """Coordinates whose dependent ones fulfil the configuration, by Newton's method."""
    if system.configuration is None:
        return q
    bound = np.asarray(system.dependent_coordinates, int)

    def violated(q: Array) -> Array:
        return violation(system, q)

    def advance(q: Array) -> Array:
        slope = cast(Array, jax.jacfwd(violated)(q))[:, bound]
        return q.at[bound].add(-cast(Array, jnp.linalg.solve(slope, violated(q))))

    near = jax.lax.stop_gradient(q)
    step: Callable[[Array, Array], Array] = lambda _, q: advance(q)
    near = cast(Array, jax.lax.fori_loop(0, _NEWTON, step, near))
    near = jax.lax.stop_gradient(near)
    # with the derivative of what is given, and of the system's numbers
    return advance(advance(q.at[bound].set(near[bound])))


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
    if not isinstance(guess, KaneState):
        remedy = "give KaneState(q, u) with the independent speeds"
        raise FieldError("steady_motion.guess", guess, "is no KaneState", remedy)
    state = KaneState(*(jnp.asarray(x, float) for x in (guess.q, guess.u)))
    if state.q.dtype != np.float64:
        problem = "is in single precision, in which no rank can be told"
        remedy = 'call jax.config.update("jax_enable_x64", True) first'
        raise FieldError("steady_motion.guess", "float32", problem, remedy)
    n = system.coordinates
    laws = _affine_motions(n)
    draw = np.random.default_rng(2)

    def near(y: Array) -> Array:
        return y[None] + _SPREAD * draw.standard_normal((_STATES, y.shape[0]))

    states = KaneState(near(state.q), near(state.u))
    found = _brackets(system, laws, states)
    brackets, in_time, sizes = (np.asarray(x, float) for x in found)
    good = np.all(np.isfinite(brackets), axis=(1, 2))
    scale = np.max(sizes[good], axis=0, initial=1e-300)
    steady = not np.any(np.abs(in_time[good]) > LOOSE[8] * scale)
    if not steady or _changes(system, states):
        problem = "depends on time"
        remedy = "leave out loads and motions that are functions of time"
        raise FieldError("steady_motion.scene", "a KaneSystem", problem, remedy)
    rows = (brackets[good] / scale[None, :, None]).reshape(-1, laws.shape[0])
    kept = echelon(null_space(rows, 10.0 * LOOSE[8]))
    names = tuple(_name(row, n) for row in kept)
    whole = jnp.asarray(np.tensordot(kept, laws, 1))
    return KaneProblem(group=names, system=system, laws=whole), state


def _changes(system: KaneSystem, states: KaneState) -> bool:
    """Whether rates of some states at other times are not those at zero."""
    one = KaneState(states.q[0], states.u[0])
    if not uses_time(kane_derivative, system, one):
        return False
    rates = _over_time(system, wide_times(system.kinks), states)
    return bool(differing(np.asarray(rates)).size)


@for_one_call
def _over_time(system: KaneSystem, times: Array, states: KaneState) -> Array:
    def at(t: Array, state: KaneState) -> Array:
        y = KaneState(configured(system, state.q), state.u)
        rates = pack(kane_derivative(system, t, y))
        return jnp.stack([rates, jnp.full_like(rates, jnp.max(jnp.abs(rates)))])

    over = jax.vmap(at, (None, 0))
    return jax.vmap(over, (0, None))(times, states)


def _affine_motions(n: int) -> np.ndarray:
    """``[M, b]`` with one entry each: shifts first, shape (n + n^2, n, n + 1)."""
    laws = np.zeros((n + n * n, n, n + 1))
    for k in range(n):
        laws[k, k, n] = 1.0
    for k in range(n * n):
        laws[n + k, k // n, k % n] = 1.0
    return laws


def _name(row: np.ndarray, n: int) -> str:
    shifts = [f"q[{k}]" for k in range(n) if row[k]]
    if len(shifts) > 1:
        shifts = [
            f"{row[k]:.6g} q[{k}]" if row[k] != 1.0 else f"q[{k}]"
            for k in range(n)
            if row[k]
        ]
    turned = [f"q[{k}]" for k in range(n) if np.any(row[n + n * k : n + n * k + n])]
    name = " + ".join(shifts)
    if not turned:
        return name
    return (f"{name} with " if name else "linear in ") + " and ".join(turned)


@for_one_call
def _brackets(
    system: KaneSystem, laws: Array, states: KaneState
) -> tuple[Array, Array, Array]:
    """Lie brackets with affine motions, rates of the rates by time, and their sizes.

    With them, by how much a motion leaves the configuration.
    """

    def at(state: KaneState) -> tuple[Array, Array, Array]:
        y = KaneState(configured(system, state.q), state.u)
        t = jnp.zeros_like(y.q[0])

        def rates(t: Array, y: KaneState) -> KaneState:
            return kane_derivative(system, t, y)

        def leaving(q: Array) -> Array:
            return violation(system, q)

        f, along = cast(tuple[KaneState, Any], jax.linearize(rates, t, y))

        def with_law(law: Array) -> tuple[Array, Array]:
            value = _generated(law, y)
            back = KaneState(law[:, :-1] @ f.q, 0.0 * f.u)
            left = jax.jvp(leaving, (y.q,), (value.q,))[1]
            ahead = pack(cast(KaneState, along(0.0 * t, value)))
            return (
                jnp.concatenate([ahead, left]),
                jnp.concatenate([pack(back), 0.0 * left]),
            )

        ahead, back = jax.vmap(with_law)(laws)
        still = KaneState(0.0 * y.q, 0.0 * y.u)
        in_time = pack(cast(KaneState, along(jnp.ones_like(t), still)))
        count = ahead.shape[1] - in_time.shape[0]
        more = jnp.zeros(count, in_time.dtype)
        size = jnp.max(jnp.abs(ahead) + jnp.abs(back), axis=0)
        size = size + jnp.abs(jnp.concatenate([pack(f), more]))
        return (ahead - back).T, jnp.concatenate([in_time, more]), size

    return jax.vmap(at)(states)
