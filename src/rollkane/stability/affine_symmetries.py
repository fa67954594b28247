"""Affine motions of coordinates that leave the equations of a Kane system as they are.

Lie brackets with every affine law are looked at beside a guess, from a hundred
millionth of its sizes to three times them, and at the guess itself. What is kept has to
pass at each of these states beside the sizes of its own terms there, so that a force
that acts close to the guess alone, or a soft spring beside a stiff one, is not
overlooked.
"""

from typing import NamedTuple, cast

import numpy as np

from ..kane.system import KaneState, KaneSystem
from ..validation.checks import FieldError
from .law_brackets import Seen, affine_laws, looked_at, states_of
from .law_names import named
from .surface_motions import echelon, null_space

# How far from the guess states are drawn, in units of one, of each coordinate's own
# size and of the largest one: none, from where a force may live (a saturated one, a
# detent) to where all others have changed.
_LEVELS = 0.0, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.3, 1.0, 3.0
# States are looked at twice, some roundings apart: what differs is rounding. A row
# counts for as much as it is known to this share: some hundred roundings, since they
# may differ by less than they are. So does, by ten of them, a tenth of what it is
# elsewhere.
_APART = 4.0 * np.finfo(float).eps
_KNOWN = 1e-13
_FAINT = 0.1
# Of states so near to the guess (the largest of the levels) most are slow, and some are
# beside singular places.
_NEAR, _TYPICAL = 1e-2, 0.75
# Of rows and columns whose largest terms are one: a hundred roundings that count as
# known, added over some 1e3 rows.
_LEFT = 1e-11
# Beside a generator's own terms: its coefficients come from what is left, 1e-11, beside
# columns that are told apart by 1e-2 or more.
_OWN = 1e-9
# Of a law's own terms and the largest ones: rows of rounding alone are 1e-5 of the
# latter, and what is lost is of its own size.
_GONE = 1e-4
# A tangent less than that, beside what its law has elsewhere, is none: configurations
# are solved to 1e-10 of their coordinates.
_STILL = 1e-8


class AffineSymmetries(NamedTuple):
    """Generators of a system's symmetries, and what else was seen on the way.

    Attributes:
        laws: ``[M, b]`` of ``q' = M q + b``, shape (K, n, n + 1).
        names: Theirs, each another one.
        states: The guess, and one of each distance from it.
        by_time: Whether rates change with time at one of them, by their derivatives.
        units: Of all coordinates, one or what they are at the guess, whichever is more;
            then of the speeds that move one of them by that in a second.
    """

    laws: np.ndarray
    names: tuple[str, ...]
    states: KaneState
    by_time: bool
    units: np.ndarray


class _Rows(NamedTuple):
    """Usable states, and which are near; of these all rows in one axis."""

    q: np.ndarray
    near: np.ndarray
    brackets: np.ndarray
    terms: np.ndarray
    noise: np.ndarray
    rates: np.ndarray
    in_time: np.ndarray


class _Weighed(NamedTuple):
    """Usable states, sizes of rows and columns, some of the states, units."""

    rows: _Rows
    scale: np.ndarray
    weight: np.ndarray
    few: KaneState
    units: np.ndarray


def affine_symmetries(system: KaneSystem, guess: KaneState) -> AffineSymmetries:
    """All affine motions of the coordinates that leave the equations as they are.

    Those that move nothing where the configuration holds are left out.

    Args:
        system: The system.
        guess: In double precision.

    Raises:
        FieldError: equations that have no values at the guess or beside it.
    """
    seen = _weighed(system, guess)
    rows, scale, weight = seen.rows, seen.scale, seen.weight
    centre = np.asarray(guess.q, float)
    n = centre.size
    scaled = rows.brackets / scale[:, None] / weight
    # at least as many rows as columns, for the triangle
    square = np.concatenate([scaled, np.zeros((weight.size, weight.size))])
    triangle = cast(np.ndarray, np.linalg.qr(square, mode="r"))
    kept = null_space(triangle, _LEFT)
    kept = _chosen(rows.q, centre, kept, weight)
    passes = [_passes(rows, scale, weight, _centred(row, centre)) for row in kept]
    found = kept[np.array(passes, bool)]
    by_time = bool(np.any(np.abs(rows.in_time) > _OWN * scale))
    whole = np.tensordot(found, affine_laws(n), 1)
    return AffineSymmetries(whole, named(found, n), seen.few, by_time, seen.units)


def lost(system: KaneSystem, state: KaneState, laws: np.ndarray) -> np.ndarray:
    """Which laws are no symmetries beside a state, by more than rounding, shape (K,).

    Args:
        system: The system.
        state: That.
        laws: ``[M, b]``, symmetries with other numbers, shape (K, n, n + 1).
    """
    seen = _weighed(system, state)
    n = laws.shape[1]
    flat = np.concatenate([laws[:, :, n], laws[:, :, :n].reshape(-1, n * n)], axis=1)
    gone: list[bool] = []
    for row in flat:
        law = _centred(row, np.asarray(state.q, float))
        left = np.abs(seen.rows.brackets @ law)
        own = seen.rows.terms @ np.abs(law)
        size = seen.scale * np.max(np.abs(law) * seen.weight)
        gone.append(bool(np.any((left > _GONE * own) & (left > _GONE * size))))
    return np.array(gone, bool)


def _weighed(system: KaneSystem, guess: KaneState) -> _Weighed:
    """Brackets beside a guess, and what rows and columns are divided by."""
    centre = np.asarray(guess.q, float)
    n = centre.size
    places = np.maximum(np.abs(centre), 1.0)
    speeds, rate = _speeds(system, guess, places)
    states, again = _beside(guess, rate * speeds)
    first, second = looked_at(system, states), looked_at(system, again)
    rows = _usable(first, second, guess)
    unit = np.concatenate([places, np.repeat(places, n) / np.tile(places, n)])
    scale, weight = _measures(rows, unit)
    few = states_of(*(np.asarray(x)[: len(_LEVELS)] for x in (states.q, states.u)))
    return _Weighed(rows, scale, weight, few, np.concatenate([places, speeds]))


def _speeds(
    system: KaneSystem, guess: KaneState, places: np.ndarray
) -> tuple[np.ndarray, float]:
    """Speeds that move a coordinate by its unit in a second, and the guess's rate."""
    n, m = places.size, guess.u.shape[0]
    q = np.tile(np.asarray(guess.q, float), (m + 2, 1))
    u = np.concatenate([np.asarray(guess.u, float)[None], np.zeros((1, m)), np.eye(m)])
    rates = looked_at(system, states_of(q, u)).rates[:, :n] / places
    fast = np.nan_to_num(np.max(np.abs(rates[2:] - rates[1]), axis=1))
    rate = float(np.nan_to_num(np.max(np.abs(rates[0])))) or 1.0
    return 1.0 / np.where(fast > 0.0, fast, 1.0), rate


def _beside(guess: KaneState, speeds: np.ndarray) -> tuple[KaneState, KaneState]:
    """States beside a guess, itself first, and the same some roundings aside.

    Args:
        guess: That.
        speeds: With which its coordinates move by their own sizes.
    """
    draw = np.random.default_rng(2)
    q, u = (np.asarray(x, float) for x in (guess.q, guess.u))
    # an affine law is known from n + 1 places; a third of the levels would give them
    each = max(6, q.size // 2 + 1)
    levels = np.tile(np.array(_LEVELS), each)
    mixed = np.concatenate([np.zeros(1), draw.permutation(levels)[1:]])
    largest = np.full_like(q, float(np.abs(q).max(initial=0.0)) or 1.0)
    places, again = _drawn(draw, q, levels, largest, np.maximum(np.abs(q), 1.0))
    fast, faster = _drawn(draw, u, mixed, speeds, speeds)
    return states_of(places, fast), states_of(again, faster)


def _drawn(
    draw: np.random.Generator,
    y: np.ndarray,
    levels: np.ndarray,
    other: np.ndarray,
    least: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers beside some, in units of one, of their own sizes and of others."""
    size = np.abs(y)
    units = np.stack([np.ones_like(y), np.where(size > 0.0, size, other), other])
    count = levels.size
    turns: np.ndarray = np.arange(count) // len(_LEVELS) + np.arange(count)
    far = levels[:, None] * units[turns % 3]
    drawn = y + far * draw.standard_normal((count, y.size))
    # of the size that terms have which cancel: a rounding of a small number moves none
    aside = _APART * (np.abs(drawn) + far + least)
    return drawn, drawn + aside * draw.choice([-1.0, 1.0], drawn.shape)


def _usable(first: Seen, second: Seen, guess: KaneState) -> _Rows:
    """Of both looks what has values and holds the configuration.

    Raises:
        FieldError: the guess is not among them, or too few beside it are.
    """
    good = np.ones(first.q.shape[0], bool)
    for seen in (first, second):
        for x in seen:
            good &= np.all(np.isfinite(x.reshape(x.shape[0], -1)), axis=1)
        good &= seen.misses <= 1.0
    apart = np.unique(first.q[good], axis=0).shape[0]
    # an affine law is told by n + 1 places
    if not good[0] or apart < first.q.shape[1] + 2:
        where = "there" if not good[0] else "beside it"
        problem = (
            f"is a state {where} of which the equations have no finite rates and "
            "derivatives, or the dependent coordinates do not close on the "
            f"configuration ({int(good.sum())} of {good.size} states are usable)"
        )
        remedy = (
            "begin from coordinates that fulfil the configuration, off singular places "
            "and ends of domains"
        )
        raise FieldError("steady_motion.guess", guess, problem, remedy)
    noise = np.abs(first.brackets[good] - second.brackets[good])
    count = noise.shape[2]
    near = np.resize(np.array(_LEVELS) <= _NEAR, good.size)
    return _Rows(
        q=first.q[good],
        near=near[good],
        brackets=first.brackets[good].reshape(-1, count),
        terms=first.terms[good].reshape(-1, count),
        noise=noise.reshape(-1, count),
        rates=first.rates[good].ravel(),
        in_time=first.in_time[good].ravel(),
    )


def _measures(rows: _Rows, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What rows and columns are divided by, so that their largest terms are one.

    Those of rounding alone stay as small as rounding is to count.
    """
    most = np.max(rows.terms * unit, axis=1, initial=0.0)
    most = np.maximum(most, np.abs(rows.rates))
    # what cancels in a row is of the size that it has near the guess at other speeds
    near = most.reshape(rows.q.shape[0], -1)[rows.near]
    typical = np.quantile(near, _TYPICAL, axis=0)
    loud = np.max(rows.noise * unit, axis=1, initial=0.0) / _KNOWN
    scale = np.maximum(np.maximum(most, loud), _FAINT * np.tile(typical, len(rows.q)))
    scale = np.where(scale > 0.0, scale, 1.0)
    terms = np.maximum(rows.terms, rows.noise / _KNOWN)
    weight = np.max(terms / scale[:, None], axis=0)
    return scale, np.maximum(weight, _FAINT / unit)


def _chosen(
    q: np.ndarray, centre: np.ndarray, kept: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Generators of what moves, each with a place of its own, shape (K, n + n^2).

    Args:
        q: Coordinates on the configuration, shape (S, n).
        centre: About which the laws were.
        kept: Weighted laws, orthonormal.
        weight: By which they are.
    """
    n = centre.size
    if not kept.shape[0]:
        return kept
    laws = np.tensordot(kept / weight, affine_laws(n), 1)
    tangents = laws[:, :, :n] @ (q - centre).T + laws[:, :, n:]
    tangents = tangents * weight[:n, None]
    _, sizes, ways = np.linalg.svd(tangents.reshape(kept.shape[0], -1).T, False)
    moves = np.zeros(kept.shape[0], bool)
    moves[: sizes.size] = sizes > _STILL * max(1.0, float(sizes[0]))
    # laws of the coordinates themselves: of none that is large by its place alone
    whole = ways @ kept / weight
    whole[:, :n] -= (whole[:, n:].reshape(-1, n, n) @ centre[None, :, None])[..., 0]
    own = weight.copy()
    reach = np.abs(centre)[None] * weight[:n, None]
    own[n:] = np.maximum(own[n:], reach.ravel())
    whole = _without(whole[moves] * own, whole[~moves] * own)
    if not whole.shape[0]:
        return whole
    whole = np.linalg.qr(whole.T)[0].T  # of equal weight, before places are chosen
    found = echelon(whole) / own
    # by unit velocity of the first coordinate that is shifted, or the largest turned
    shifts: np.ndarray = found[:, :n] != 0.0
    for row, shifted in zip(found, shifts, strict=True):
        sized = shifted if shifted.any() else np.abs(row)
        row /= row[int(np.argmax(sized))]
    return found


def _without(rows: np.ndarray, gone: np.ndarray) -> np.ndarray:
    """Rows less what they have of others, at as many places: linear ones first."""
    rows, gone = rows.copy(), np.linalg.qr(gone.T)[0].T
    prefer = np.linspace(0.5, 1.0, rows.shape[1])
    for k in range(gone.shape[0]):
        row, column = divmod(int(np.argmax(np.abs(gone[k:]) * prefer)), prefer.size)
        gone[[k, k + row]] = gone[[k + row, k]]
        gone[k] /= gone[k, column]
        rows -= np.outer(rows[:, column], gone[k])
        gone[k + 1 :] -= np.outer(gone[k + 1 :, column], gone[k])
    return rows


def _centred(row: np.ndarray, centre: np.ndarray) -> np.ndarray:
    n = centre.size
    found = row.copy()
    found[:n] += row[n:].reshape(n, n) @ centre
    return found


def _passes(
    rows: _Rows, scale: np.ndarray, weight: np.ndarray, law: np.ndarray
) -> bool:
    """Whether a law keeps the equations at every state, beside its own terms there."""
    left = np.abs(rows.brackets @ law)
    own, noise = rows.terms @ np.abs(law), rows.noise @ np.abs(law)
    # of its own terms what it was found to; rounding that differs by less than it is,
    # by chance; and what is left of others' in it
    allowed = _OWN * own + 1e3 * noise + _LEFT * scale * np.max(np.abs(law) * weight)
    return bool(np.all(left <= allowed))
