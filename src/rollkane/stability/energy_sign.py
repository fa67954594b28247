"""Sign of the kept energy at a steady motion: what stability follows from it.

Of an energy that is kept, less multiples of momenta that are kept as well, so that the
first variation vanishes, the second one is a quantity of the linear model. Where it is
definite, modulo symmetry, no motion near by goes away: stability in Lyapunov's sense.

Sources: J. E. Marsden, "Lectures on Mechanics" (1992), for energy and momentum; D. V.
Zenkov, A. M. Bloch, J. E. Marsden, "The energy-momentum method for the stability of
nonholonomic systems", Dyn. Stab. Syst. 13 (1998), for what rolling changes: a symmetry
need not keep a momentum. Jellett's and Routh's integrals of a loaded ball: E. J. Routh,
"Advanced Rigid Dynamics" (1884); that they are kept is checked, not assumed.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics import observables
from ..dynamics.rolling import rolling_derivative
from .momenta import MOMENTA, momenta, units
from .newton import Asked, Point
from .problem import RollingProblem

_Observable: TypeAlias = Callable[[Any, Array, Any], Array]
_Join: TypeAlias = Callable[[Array, Array], Array]

# Random states around the motion at which a quantity has to be kept, and how far away
# [rad], [m] over lengths of one: far enough that what is kept at the motion alone, by
# its symmetry, is not taken for kept.
_STATES, _SPREAD = 8, 0.1
# Of the sizes of both vectors in a rate that has to vanish: rounding of some 1e3
# operations is 1e-13, and of what is not kept few states give less than 1e-4.
_KEPT = 1e-9
# Of the slope of the energy, or of the unit of energy or momentum: what no momentum
# takes off, beside rounding (1e-13) and a motion that is solved to 1e-10 of its steps.
_FIRST = 1e-8
# Of the largest of the second variation's eigenvalues, of coordinates scaled to a
# diagonal of ones: second derivatives are known to some 1e-12.
_ZERO = 1e-9
# Of an eigenvalue: those nearer than that are taken for one. A double one is known to
# the root of its rounding, 1e-7.
_SAME = 1e-6


class EnergySign(NamedTuple):
    """Second variation of a kept energy at a steady motion, modulo symmetry.

    Attributes:
        energy: Which energy: "energy", "moving energy"; "" where there is none.
        momenta: Multiples of kept momenta that are taken off [J per their unit].
        positive: How many independent changes raise it.
        negative: How many lower it.
        zero: How many leave it, to second order.
        modes: Sign of the energy of each oscillating mode, in the order of the motion's
            eigenvalues (Krein's sign): 1, -1; 0 where it grows or decays, or where the
            energy leaves it open.
        reason: Why there is none; "" where there is one.
    """

    energy: str
    momenta: dict[str, float]
    positive: int
    negative: int
    zero: int
    modes: tuple[int, ...]
    reason: str

    @property
    def definite(self) -> bool:
        """Whether it has one sign: the motion is stable in Lyapunov's sense."""
        one = min(self.positive, self.negative) == 0
        return not self.reason and one and not self.zero

    def __str__(self) -> str:
        """A line."""
        if self.reason:
            return f"energy: none, {self.reason}"
        less = "".join(
            f" {'-' if value > 0.0 else '+'} {abs(value):.6g} {name}"
            for name, value in self.momenta.items()
        )
        count = f"{self.positive} positive, {self.negative} negative, {self.zero} zero"
        kind = "definite" if self.definite else "not definite"
        return f"{self.energy}{less}: {count}, {kind}"


def _none(reason: str) -> EnergySign:
    return EnergySign("", {}, 0, 0, 0, (), reason)


_ENERGIES: dict[str, _Observable] = {
    "energy": observables.energy,
    "moving energy": observables.moving_energy,
}


def energy_sign(
    asked: Asked, point: Point, eigenvalues: np.ndarray, errors: np.ndarray
) -> EnergySign:
    """The sign of the energy at a steady motion.

    Args:
        asked: The problem.
        point: The solution.
        eigenvalues: Of the linear model, without those of group and family [1/s].
        errors: How far rounding may move each [1/s].

    Returns:
        ``EnergySign``, with a reason in place of counts where no energy is kept, or
        where its first variation, less kept momenta, does not vanish on the constraint
        manifold: then its second variation says nothing.

    Source: docs/theory.md, (10.6).
    """
    problem = asked.problem
    if not isinstance(problem, RollingProblem):
        return _none("no energy is known of a KaneSystem")
    kind = observables.kept_energy(problem.scene) or _kept_there(problem, point)
    if not kind:
        return _none("the scene keeps no energy")
    size = point.size
    measures = units(problem.scene, point.rate)
    slopes = np.asarray(_slopes(problem, kind, point.state), float) * size
    slopes = slopes / measures[:, None]
    kept = [False] * len(MOMENTA)
    if np.linalg.norm(slopes[0]) > _first(slopes):  # at rest no momentum is needed
        kept = _kept(problem, point)
    chosen, weights = _multiples(slopes, kept)
    rest = slopes[0] - weights @ slopes[chosen]
    if np.linalg.norm(rest) > _first(slopes):
        reason = (
            "its first variation, less momenta that are known to be kept, does not "
            "vanish on the constraint manifold"
        )
        return _none(reason)
    needed = np.zeros(len(MOMENTA) + 1)
    needed[0], needed[chosen] = 1.0, -weights
    rows = np.stack([needed, *_spare(slopes, kept, chosen)])
    second = _second(problem, kind, any(kept), point.state, rows / measures)
    seconds = np.asarray(second, float) * size[:, None] * size[None]
    S = point.group.moved
    basis = _complement(np.concatenate([S, slopes[chosen].T], axis=1))
    best = _best(basis.T @ seconds @ basis)
    weights, Q = best @ rows, np.tensordot(best, seconds, 1)
    counts = _inertia(basis.T @ Q @ basis)
    A = point.local.slope / size[:, None] * size[None]
    signs = _signs(A, Q, _complement(S), eigenvalues, errors)
    multiples = -weights[1:] * measures[0] / measures[1:]
    taken = {name: float(w) for name, w in zip(MOMENTA, multiples, strict=True) if w}
    found = EnergySign(kind, taken, *counts, signs, "")
    if found.definite and np.any(np.real(eigenvalues) > errors):
        return _none("rounding hides it: of a motion that grows none is definite")
    return found


def _first(slopes: np.ndarray) -> float:
    """What a slope of the energy may be, in its unit, that counts as none."""
    return _FIRST * max(float(np.linalg.norm(slopes[0])), 1.0)


def _values(
    problem: RollingProblem, kind: str, state: Any, more: bool = True
) -> Float[Array, " q"]:
    """The energy, then the momenta."""
    t = jnp.zeros_like(state.orientation[0])
    energy = _ENERGIES[kind](problem.scene, t, state)[None]
    if not more:
        return energy
    return jnp.concatenate([energy, momenta(problem.scene, t, state)])


@for_one_call
def _slopes(problem: RollingProblem, kind: str, state: Any) -> Array:
    still = jnp.zeros(len(problem.coordinates(state)[0]), state.orientation.dtype)

    def at(x: Array) -> Array:
        return _values(problem, kind, problem.moved(state, x))

    return cast(Array, jax.jacfwd(at)(still))


@for_one_call
def _second(
    problem: RollingProblem, kind: str, more: bool, state: Any, rows: Array
) -> Array:
    still = jnp.zeros(len(problem.coordinates(state)[0]), state.orientation.dtype)

    def at(x: Array) -> Array:
        values = _values(problem, kind, problem.moved(state, x), more)
        return rows[:, : values.shape[0]] @ values

    return cast(Array, jax.jacfwd(jax.jacfwd(at))(still))


@for_one_call
def _changes(problem: RollingProblem, state: Any, steps: Array) -> tuple[Array, Array]:
    """Momenta at states, and how they change along flow and group."""
    group = jnp.eye(len(problem.group), dtype=steps.dtype)

    def at(x: Array) -> tuple[Array, Array]:
        y = problem.moved(state, x)
        t = jnp.zeros_like(x[0])

        def told(y: Any) -> Array:
            return momenta(problem.scene, t, y)

        values, along = cast(Any, jax.linearize(told, y))
        generated: Callable[[Array], Any] = lambda xi: problem.generator(y, xi)
        join: _Join = lambda a, b: jnp.concatenate([a[None], b])
        moves = jax.tree.map(join, problem.rates(y), jax.vmap(generated)(group))
        return values, cast(Array, jax.vmap(along)(moves))

    return jax.vmap(at)(steps)


def _draws(point: Point) -> np.ndarray:
    """Steps to random states around a motion."""
    draw = np.random.default_rng(3)
    return _SPREAD * draw.standard_normal((_STATES, point.size.size)) * point.size


def _kept_there(problem: RollingProblem, point: Point) -> str:
    """Which energy motions keep around a state, though no law of the scene's says so.

    As of a potential that is round about a turntable's axis, or of a force that is
    across the velocity; "" for none. What they do far away does not count.
    """
    found = _energy_changes(problem, point.state, _draws(point))
    values, changes = (np.asarray(x, float) for x in found)
    good = np.all(np.isfinite(values) & np.isfinite(changes), axis=1)
    names = [*_ENERGIES]
    if problem.scene.base.motion is None:
        names = names[:1]  # both are one
    if np.sum(good) < 2:
        return ""
    # beside what energies differ by: their zero is anywhere
    sizes = np.ptp(values[good], axis=0) * point.rate
    kept = np.all(np.abs(changes[good]) <= _KEPT * sizes, axis=0)
    # the moving one first: at what rests on the base its slope is the smaller one
    return next((names[k] for k in range(len(names))[::-1] if kept[k]), "")


@for_one_call
def _energy_changes(
    problem: RollingProblem, state: Any, steps: Array
) -> tuple[Array, Array]:
    """Energies at states, and all of how they change in time."""

    def at(x: Array) -> tuple[Array, Array]:
        y, t = problem.moved(state, x), jnp.zeros_like(x[0])

        def told(t: Array, y: Any) -> Array:
            return jnp.stack([of(problem.scene, t, y) for of in _ENERGIES.values()])

        rates = rolling_derivative(problem.scene, t, y)
        return jax.jvp(told, (t, y), (jnp.ones_like(t), rates))

    return jax.vmap(at)(steps)


def _kept(problem: RollingProblem, point: Point) -> list[bool]:
    """Which momenta neither the motion nor a symmetry changes, around a state."""
    found = _changes(problem, point.state, _draws(point))
    values, changes = (np.asarray(x, float) for x in found)
    shifts = np.concatenate([[point.rate], point.rate / point.pace])
    good = np.all(np.isfinite(changes), axis=(1, 2))
    if not np.any(good):
        return [False] * values.shape[1]
    sizes = np.abs(values[good]).max(axis=0) * shifts[:, None]
    return np.all(np.abs(changes[good]) <= _KEPT * sizes, axis=(0, 1)).tolist()


def _multiples(
    slopes: np.ndarray, kept: Sequence[bool]
) -> tuple[list[int], np.ndarray]:
    """Momenta, and how much of each, so that the energy's slope vanishes at best.

    Returns:
        Their rows, and their multiples.
    """
    length = np.linalg.norm(slopes, axis=1)
    chosen: list[int] = []
    for k, one in enumerate(kept, 1):
        if not one or not length[k] > _FIRST:
            continue
        unit = slopes[[*chosen, k]] / length[[*chosen, k], None]
        if np.linalg.svd(unit, compute_uv=False)[-1] > _FIRST:
            chosen.append(k)
    return chosen, slopes[0] @ np.linalg.pinv(slopes[chosen])


def _spare(
    slopes: np.ndarray, kept: Sequence[bool], chosen: list[int]
) -> list[np.ndarray]:
    """Combinations of kept momenta whose slope vanishes: any multiple may be added."""
    length = np.linalg.norm(slopes, axis=1)
    found: list[np.ndarray] = []
    for k, one in enumerate(kept, 1):
        if not one or k in chosen or not length[k] > _FIRST:
            continue
        row = np.zeros(slopes.shape[0])
        row[k] = 1.0
        row[chosen] = -np.linalg.lstsq(slopes[chosen].T, slopes[k], rcond=None)[0]
        if np.linalg.norm(row @ slopes) <= _FIRST * length[k]:
            found.append(row * (length[0] / length[k]))  # of the energy's size
    return found


def _best(seconds: np.ndarray) -> np.ndarray:
    """Multiples of second variations, the first one's 1, that make the sum definite.

    At most one further one, none where none is needed or none will do.
    """
    alone = np.eye(seconds.shape[0])
    for k in range(1, 0 if _definite(seconds[0]) else seconds.shape[0]):
        for s in _between(seconds[0], seconds[k]):
            if _definite(seconds[0] + s * seconds[k]):
                return alone[0] + s * alone[k]
    return alone[0]


def _definite(Q: np.ndarray) -> bool:
    up, down, zero = _inertia(Q)
    return not zero and min(up, down) == 0


def _between(Q: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Multiples s between those at which ``Q + s more`` is singular, and beyond.

    Between two of these its inertia does not change.
    """
    sizes = np.linalg.norm(Q), np.linalg.norm(more)
    if sizes[1] <= _FIRST * sizes[0]:  # two names of one quantity
        return np.zeros(0)
    known = float(sizes[0] / sizes[1] / np.sqrt(7.0))  # where it is regular, as a rule
    inverse = np.linalg.pinv(Q + known * more)
    at = np.linalg.eigvals(inverse @ more)
    least = _SAME * np.abs(at).max()
    real = (np.abs(at.imag) <= least) & (np.abs(at) > least)
    ends = np.sort(known - 1.0 / np.real(at[real]))
    far = max(known, 2.0 * np.abs(ends).max(initial=0.0))
    ends = np.concatenate([[-2.0 * far], ends, [2.0 * far]])
    wide = np.diff(ends) > _SAME * far
    return (0.5 * (ends[1:] + ends[:-1]))[wide]


def _complement(columns: np.ndarray) -> np.ndarray:
    """Orthonormal directions at right angles to some, by their rank."""
    if not columns.shape[1]:
        return np.eye(columns.shape[0])
    length = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(length > 0.0, length, 1.0)
    left, values, _ = np.linalg.svd(unit)
    return left[:, int(np.sum(values > _FIRST)) :]


def _inertia(Q: np.ndarray) -> tuple[int, int, int]:
    """Numbers of positive, negative and zero eigenvalues."""
    if not Q.size:
        return 0, 0, 0
    largest = np.max(np.abs(Q), axis=1)
    scale = np.sqrt(np.maximum(largest, _ZERO * largest.max()))
    values = np.linalg.eigvalsh(0.5 * (Q + Q.T) / scale[:, None] / scale[None])
    far = np.abs(values) > _ZERO * np.abs(values).max()
    up, down = int(np.sum(far & (values > 0.0))), int(np.sum(far & (values < 0.0)))
    return up, down, values.size - up - down


def _signs(
    A: np.ndarray,
    Q: np.ndarray,
    basis: np.ndarray,
    eigenvalues: np.ndarray,
    errors: np.ndarray,
) -> tuple[int, ...]:
    """Sign of the energy on the modes of each eigenvalue, off the group."""
    inner, own = basis.T @ A @ basis, basis.T @ Q @ basis
    values, vectors = np.linalg.eig(inner)
    signs: list[int] = []
    for value, error in zip(eigenvalues, errors, strict=True):
        near = _SAME * abs(value)
        if abs(value.real) > max(error, near) or abs(value.imag) <= near:
            signs.append(0)
            continue
        V = np.linalg.qr(vectors[:, np.abs(values - value) <= 10.0 * near])[0]
        energies = np.linalg.eigvalsh(V.conj().T @ own @ V)
        far = np.abs(energies) > _ZERO * np.abs(own).max()
        same = far.all() and len(set(np.sign(energies))) == 1
        signs.append(int(np.sign(energies[0])) if same else 0)
    return tuple(signs)
