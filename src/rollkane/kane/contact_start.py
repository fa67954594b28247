"""A start at which every contact closes, and which constraints determine what there.

NumPy, once for a system: contacts that follow from others are found by their rank.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..codegen.compile_effort import for_one_call
from ..kinematics.surface_fit import fit_of, refuse_fit
from ..validation.checks import FieldError
from .contact_functions import Chosen, Corrections, Gaps, Shared, Slips, split
from .contact_rates import Pose, Touching, all_poses, gap_of
from .equations import kane_equations
from .system import KaneSystem
from .system_arguments import chosen_numbers

# of the largest singular value: below it, a row follows from others. Rows that do are
# equal to roundings; contacts that nearly fit lose as many digits of their forces
_RANK = 1e-9
# of lengths and turns of order one: a thousand roundings
_CLOSED = 1e-13
_TRIES = 60
# of a rotation's columns: a matrix made of a quaternion that a loose run has stretched
_TURNED = 1e-6
# contacts are moved this much farther than bodies
_REACH = 100.0


class Measured(NamedTuple):
    """Of all constraints, at a place.

    Attributes:
        gaps: Configuration, shape (c,).
        by_place: Its derivative by the directions of ``moves``, shape (c, k).
        moves: Directions in which coordinates are moved, shape (n, k).
        slips: Velocity constraints at rest, shape (d,).
        by_speeds: Their derivative, shape (d, m).
        slopes: Derivative of the configuration by the coordinates, shape (c, n).
    """

    gaps: Any
    by_place: Any
    moves: Any
    slips: Any
    by_speeds: Any
    slopes: Any


@for_one_call
def measured(shared: Shared, corrections: Corrections, t: Array, q: Array) -> Measured:
    """All constraints at a place, and their derivatives.

    Args:
        shared: The system and its contacts.
        corrections: How coordinates may be moved.
        t: Time [s].
        q: Own and contact coordinates.
    """
    base = shared.base
    rest = jnp.zeros(base.speeds + base.auxiliary, q.dtype)

    def gaps(q: Array) -> Array:
        now = shared(t, q, rest, base.parameters)
        return Gaps(base.configuration, None)(t, q, rest, now)

    def slips(u: Array) -> Array:
        now = shared(t, q, u, base.parameters)
        return Slips(base.constraints, None)(t, q, u, now)

    moves = corrections(t, q, rest, shared(t, q, rest, base.parameters))
    slopes = cast(Array, jax.jacfwd(gaps)(q))
    by_speeds = cast(Array, jax.jacfwd(slips)(rest))[:, : base.speeds]
    found = gaps(q), slopes @ moves, moves, slips(rest), by_speeds
    return Measured(*found, slopes)


def root_of(base: KaneSystem, t: Array, q: Array, u: Array) -> np.ndarray:
    """``M^-1/2`` of a system, of order one [1], shape (m, m).

    Args:
        base: Without contacts.
        t: Time [s].
        q: Its coordinates.
        u: Its speeds.

    Raises:
        FieldError: it has none there.
    """
    if not np.isfinite(t):
        problem, remedy = "must be finite", "give the time of the start in seconds"
        raise FieldError("rolling_contacts.time", t, problem, remedy)
    masses = np.asarray(kane_equations(base, t, q, u).mass_matrix)
    if not np.isfinite(masses).all():
        raise FieldError(
            "rolling_contacts.q",
            q,
            "leaves the system without a mass matrix of finite numbers",
            "start where every velocity is defined (a quaternion must not be zero)",
        )
    size, axes = np.linalg.eigh(masses)
    largest = size[-1] if size[-1] > 0.0 else 1.0
    size = np.maximum(size, 1e-6 * largest)  # what moves no mass is moved freely
    return axes / np.sqrt(size / largest)


def known_poses(shared: Shared, t: Array, q: Array) -> list[tuple[Pose, Pose]]:
    """Poses of both bodies of every pair.

    Raises:
        FieldError: axes that are not turned alone, but mirrored or stretched.
    """
    base, pairs = shared.base, shared.pairs
    rest = jnp.zeros(base.speeds + base.auxiliary, q.dtype)
    poses = all_poses(pairs, t, q, rest, shared.more(t, q, rest, base.parameters))
    for k, both in enumerate(poses):
        for name, (_, turn) in zip(("body_a", "body_b"), both, strict=True):
            R = np.asarray(turn, float)
            alike = np.abs(R.T @ R - np.eye(3)).max()
            # a state that a run ended with has errors, and so has its rotation
            known = max(_TURNED, 100.0 * float(np.finfo(turn.dtype).eps))
            if not (alike < known and np.linalg.det(R) > 0.0):
                raise FieldError(
                    f"rolling_contacts.contacts[{k}].{name}.rotation",
                    R.tolist(),
                    "is no rotation: its columns must be orthogonal, of length one and "
                    "right-handed",
                    "give the body's axes on fixed axes, by columns",
                )
    return poses


def correction_of(root: np.ndarray) -> Corrections:
    """Directions of change, contacts before bodies."""
    return Corrections(jnp.asarray(root), _REACH * float(np.abs(root).max()))


def closed_start(
    shared: Shared, corrections: Corrections, t: Array, q: np.ndarray, names: list[str]
) -> tuple[np.ndarray, Measured]:
    """Coordinates at which every contact closes, nearest to given ones.

    Args:
        shared: The system and its contacts.
        corrections: How coordinates may be moved.
        t: Time [s].
        q: Own and contact coordinates.
        names: Of the rows of the configuration.

    Raises:
        FieldError: there are none near.
    """

    def at(q: np.ndarray) -> Measured:
        found = measured(shared, corrections, t, jnp.asarray(q))
        return Measured(*(np.asarray(x, float) for x in found))

    # contacts alone first: else bodies go along, until contacts are where they belong
    now = at(q)
    of_contacts = ~now.moves[: shared.base.coordinates].any(axis=0)
    for moved in (of_contacts, np.ones_like(of_contacts)):
        q, now = _closed(at, q, now, moved)
    left = np.abs(now.gaps)
    if not np.all(left < 100.0 * _CLOSED * (1.0 + np.abs(q).max())):
        worst = int(np.argmax(np.where(np.isnan(left), np.inf, left)))
        raise FieldError(
            "rolling_contacts.q",
            q[: shared.base.coordinates],
            f"leaves a contact open that cannot be closed from there: {names[worst]} "
            f"is {left[worst]:.1e}",
            "start nearer to a place where all contacts touch, or give `near` to the "
            "contact, the place where it is",
        )
    return q, now


def _closed(
    at: Callable[[np.ndarray], Measured],
    q: np.ndarray,
    now: Measured,
    moved: np.ndarray,
) -> tuple[np.ndarray, Measured]:
    """Coordinates with gaps as small as these directions can make them, by Newton."""
    for _ in range(_TRIES):
        size = np.abs(now.gaps).max(initial=0.0)
        if not np.isfinite(size) or size < _CLOSED * (1.0 + np.abs(q).max()):
            break
        step = now.moves[:, moved] @ _least(now.by_place[:, moved], now.gaps)
        share, then = 1.0, now
        for _ in range(12):  # no farther than it helps
            then = at(q - share * step)
            if np.abs(then.gaps).max() < size:
                break
            share *= 0.5
        else:
            break
        q, now = q - share * step, then
    return q, now


def normals_of(shared: Shared, t: Array, q: Array, names: list[str]) -> np.ndarray:
    """Normals of the contacts [1], fixed axes, shape (k, 3).

    Refused are contacts whose surfaces fit, or whose normals are not opposite.

    Raises:
        FieldError: a contact is one of these.
    """
    base, pairs = shared.base, shared.pairs
    own, places = split(base, pairs, q)
    rest = jnp.zeros(base.speeds + base.auxiliary, q.dtype)
    poses = all_poses(pairs, t, own, rest, shared.more(t, own, rest, base.parameters))
    normals: list[np.ndarray] = []
    for name, pair, pose, place in zip(names, pairs, poses, places, strict=True):
        fit, against, normal = _fit(pair, pose, place)
        normals.append(np.asarray(normal))
        refuse_fit(f"RollingContact.surface_b of {name}", fit, pair.b)
        if not float(against) < 0.0:
            raise FieldError(
                f"RollingContact.surface_a of {name}",
                pair.a,
                "lies on the wrong side of surface_b: their normals are not opposite",
                "let both normals point out of the material (inside=True for a cavity) "
                "or start nearer",
            )
    return np.stack(normals)


@for_one_call
def _fit(pair: Touching, pose: Any, place: Any) -> tuple[Array, Array, Array]:
    gap = gap_of(pair, pose, place)
    shell = gap.shell
    if shell is None:
        # along the normal's turns, as the surface's own coordinates
        shell = pair.a.geometry(_own_coordinates(pair, gap.normal))
    turned = gap.to_base @ shell.normal
    against = jnp.sum(turned * gap.ground.normal)
    normal = pose[1][1] @ gap.ground.normal
    return fit_of(shell, gap.ground, gap.to_base), against, normal


def _own_coordinates(pair: Touching, normal: Array) -> Array:
    if pair.a.is_by_normal:
        return normal
    point = pair.a.normal_map(pair.b.is_flat)
    assert point is not None
    return pair.a.at_edge(point(normal), normal)


def consistent_speeds(now: Measured, root: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The speeds nearest to given ones (by their energy) that the contacts allow.

    Raises:
        FieldError: no speeds do.
    """
    C = now.by_speeds @ root[: u.shape[0], : u.shape[0]]
    violated = now.by_speeds @ u + now.slips
    change, rank = _least(C, violated), _rank(C)
    left = np.abs(C @ change - violated).max(initial=0.0)
    # of the velocities that the contacts have at these speeds
    size = np.abs(now.by_speeds) @ np.abs(u) + np.abs(now.slips)
    if left > 1e-9 * size.max(initial=1e-300):
        raise FieldError(
            "rolling_contacts.contacts",
            C.shape[0],
            f"cannot all hold: their {C.shape[0]} velocity constraints have rank "
            f"{rank}, and leave {left:.1e} m/s between bodies that touch",
            "let the motions of what is driven agree, or leave out a contact",
        )
    if rank == u.shape[0]:
        raise FieldError(
            "rolling_contacts.contacts",
            C.shape[0],
            f"leave nothing that can move: their {C.shape[0]} velocity constraints "
            f"have rank {rank}, as many as there are speeds",
            "leave out a contact, or give a body another joint",
        )
    return u - root[: u.shape[0], : u.shape[0]] @ change


def chosen_of(
    now: Measured,
    root: np.ndarray,
    own: int,
    kept: tuple[Iterable[int], Iterable[int]],
    along: np.ndarray,
) -> Chosen:
    """Which constraints count and what they determine, by pivots.

    Args:
        now: All constraints at the start.
        root: ``M^-1/2`` of the speeds.
        own: How many coordinates are no contact's.
        kept: Coordinates, and speeds, that should stay independent.
        along: Velocity constraints along the normals of contacts, as combinations of
            all velocity constraints, shape (contacts, d).

    Raises:
        FieldError: these cannot all be independent, or are not there.
    """
    sizes = now.slopes.shape[1], now.by_speeds.shape[1]
    coordinates, speeds = (
        chosen_numbers(f"rolling_contacts.independent_{what}", some, size)
        for what, some, size in zip(("coordinates", "speeds"), kept, sizes, strict=True)
    )
    gaps = _rows(now.by_place)
    weight = np.ones(now.slopes.shape[1])
    weight[own:] = 1e3  # contacts are determined before bodies
    weight[list(coordinates)] = 0.0
    bound = _columns("coordinates", now.slopes[list(gaps)] * weight, coordinates)
    rows = _rows(now.by_speeds @ root[: now.by_speeds.shape[1]])
    normals = _rows(along @ now.by_speeds @ root[: now.by_speeds.shape[1]])
    weight = np.linalg.norm(root[: now.by_speeds.shape[1]], axis=1)
    weight[list(speeds)] = 0.0
    taken = _columns("speeds", now.by_speeds[list(rows)] * weight, speeds)
    return Chosen(rows, taken, gaps, bound, normals)


def _rows(matrix: np.ndarray) -> tuple[int, ...]:
    """Rows that do not follow from others."""
    lengths = np.linalg.norm(matrix, axis=1, keepdims=True)
    alike = matrix / np.where(lengths > 0.0, lengths, 1.0)
    rank = _rank(alike)
    # of rows that are alike the first counts
    first = np.linspace(1.0, 1.0 - 1e-6, matrix.shape[0])
    order, _ = _pivots((alike * first[:, None]).T)
    return tuple(sorted(int(k) for k in order[:rank]))


def _columns(what: str, matrix: np.ndarray, kept: tuple[int, ...]) -> tuple[int, ...]:
    """As many columns as rows, that determine them best."""
    count = matrix.shape[0]
    order, lengths = _pivots(matrix)
    if not (len(order) == count and min(lengths) > _RANK * max(lengths)):
        raise FieldError(
            f"rolling_contacts.independent_{what}",
            kept,
            "cannot all be independent: the contacts determine some of them",
            "name fewer, or others",
        )
    return tuple(sorted(int(k) for k in order[:count]))


def _least(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """The least solution in the sense of least squares."""
    return np.linalg.pinv(matrix, rcond=_RANK) @ rhs


def _pivots(matrix: np.ndarray) -> tuple[list[int], list[float]]:
    """Columns in the order of what each adds to those before, and how much it is."""
    left, order, lengths = matrix.copy(), cast("list[int]", []), cast("list[float]", [])
    for _ in range(min(matrix.shape)):
        sizes = np.linalg.norm(left, axis=0)
        sizes[order] = -1.0
        k = int(np.argmax(sizes))
        size = float(sizes[k])
        order.append(k)
        lengths.append(size)
        if size > 0.0:
            way = left[:, k] / size
            for _ in range(2):  # once more, of what roundings leave
                left = left - np.outer(way, way @ left)
    return order, lengths


def _rank(matrix: np.ndarray) -> int:
    spread = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(spread > _RANK * spread.max(initial=0.0)))
