"""Levenberg and Marquardt's method, scaled, with bounds and robust losses.

Columns are scaled by their largest norm so far (Moré, 1978), so that units do not
matter. The damping is raised until no coordinate moves by more than a reach that grows
with success: where a record hardly shows a coordinate, the linear model would send it
far away. A coordinate on its bound is left out as long as the descent leads out of it
(and so a start on a bound does not stall); steps are cut to the box, and judged by what
the linear model says of the cut step. A search whose last step would reach a bound ends
on it, not beside it by less than the search waits for: what is held there is known.

Steps do not go along directions that misfits do not show: there roundings of the others
would lead. What the first guess does not show waits until more than noise shows it.

Where misfits bend along a narrow valley, a straight step leaves it soon. What they bent
by along the last step is known without another run; a second-order correction by it
(geodesic acceleration: Transtrum and Sethna, 2012) makes steps follow the valley.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .directions import not_seen, waiting, without
from .evaluation import Evaluation
from .losses import LOSSES, Loss

# Least fall of twice the cost that is waited for: chi-square changes by 1 within one
# standard deviation, so that 1e-6 of it is 1e-3 of a standard deviation.
_LEAST_FALL = 1e-6
_LEAST_SHARE = 1e-12  # of the cost: rounding of a sum of squares
FIRST_DAMPING, _MOST_DAMPING = 1e-3, 1e12
# Longest first step, relative to the coordinates' sizes: within it a model that is off
# by as much is linear enough; it grows where the linear model proves right.
_FIRST_REACH = 0.3
# Longest correction, relative to its step: beyond it the second order is not small
# beside the first (Transtrum and Sethna's bound).
_MOST_BENT = 0.75
# How near to a bound a last step may begin that ends on it, relative to the
# coordinates' sizes: by a step without a promise, what is hardly seen goes no further.
_BESIDE = 1e-3


class Minimum(NamedTuple):
    """Where a search ended.

    Attributes:
        z: Coordinates, shape (P,).
        at: Residuals there; derivatives by what still waits are taken out.
        cost: Half of the sum of losses.
        evaluations: How many points were tried.
        converged: Whether no step promised more.
        path: Accepted points, shape (K, P).
        damping: Of the last step: where a search over more begins.
    """

    z: np.ndarray
    at: Evaluation
    cost: float
    evaluations: int
    converged: bool
    path: np.ndarray
    damping: float


def minimize(
    evaluate: Callable[[np.ndarray], Evaluation],
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    size: np.ndarray,
    loss: Loss = LOSSES["linear"],
    most: int = 100,
    least: float = _LEAST_FALL,
    damping: float = FIRST_DAMPING,
    first: np.ndarray | None = None,
) -> Minimum:
    """Search for a minimum of half the sum of losses.

    Args:
        evaluate: Residuals and their derivatives at a point.
        start: Where to begin, shape (P,), within the bounds.
        lower: Bounds, shape (P,); -inf for none.
        upper: Likewise.
        size: Of each coordinate, for the length of the first step, shape (P,).
        loss: Of the squared residuals of samples.
        most: Points tried.
        least: Fall of twice the cost that is waited for.
        damping: Of the first step.
        first: Directions that the first guess does not show, rows relative to sizes;
            None: the start is the first guess.

    Returns:
        The best point; where the start has no numbers, the start.
    """
    z = np.clip(start, lower, upper)
    at = evaluate(z)
    first = not_seen(at, size) if first is None else first
    evaluations, cost = 1, _cost(at, loss)
    path, scale, bend = [z], np.zeros_like(z), None
    grows, reach, converged = 2.0, _FIRST_REACH, False
    while at.usable and evaluations < most and damping < _MOST_DAMPING:
        root = _root_weights(at, loss)
        r, whole = root * at.residual, root[:, None] * at.jacobian
        scale = np.maximum(scale, np.linalg.norm(whole, axis=0))
        J = _shown(at._replace(residual=r, jacobian=whole), size, first)
        box = lower - z, upper - z
        step = _step(r, J, *box, damping, scale)
        while np.max(np.abs(step) / size) > reach and damping < _MOST_DAMPING:
            damping *= 3.0
            step = _step(r, J, *box, damping, scale)
        promised = 0.5 * (r @ r - np.sum((r + J @ step) ** 2))
        share = max(_LEAST_SHARE, 10.0 * float(np.finfo(at.residual.dtype).eps))
        waited = least + share * cost
        if 2.0 * promised <= waited:
            converged = bool(damping <= 1.0)  # else the damping allows no step
            if converged and _reaches_side(z, step, lower, upper, size):
                ahead = _ahead(z, step, lower, upper)
                tried = evaluate(ahead)
                evaluations += 1
                if 2.0 * (_cost(tried, loss) - cost) <= waited:
                    z, at, cost = ahead, tried, _cost(tried, loss)
                    path.append(z)
            break
        if bend is not None:
            step = _bent(step, root * bend.along(step, scale), J, *box, damping, scale)
        ahead = _ahead(z, step, lower, upper)
        tried = evaluate(ahead)
        evaluations += 1
        found = _cost(tried, loss)
        gain = (cost - found) / promised
        accepted = gain > 1e-4  # Moré's: any fall that is not rounding of the promise
        bend = Bend.between(at, tried, step, accepted)
        if accepted:
            z, at, cost = ahead, tried, found
            path.append(z)
            damping *= max(1.0 / 9.0, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
            grows, reach = 2.0, reach * (2.0 if gain > 0.5 else 1.0)
        else:
            damping, grows = damping * grows, 2.0 * grows
            reach = 0.5 * min(reach, np.max(np.abs(step) / size))
    at = _known(at, size, loss, first)
    return Minimum(z, at, cost, evaluations, converged, np.array(path), damping)


def _root_weights(at: Evaluation, loss: Loss) -> np.ndarray:
    """What a loss multiplies residuals with, shape (N,)."""
    return np.sqrt(at.by_kind(loss.weight(at.of_samples**2), 1.0))


def _shown(at: Evaluation, size: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Derivatives by what a step may move."""
    shown = without(at.jacobian, size, waiting(at, size, first))
    return without(shown, size, not_seen(at._replace(jacobian=shown), size))


def _known(
    at: Evaluation, size: np.ndarray, loss: Loss, first: np.ndarray
) -> Evaluation:
    """Residuals whose derivatives are by what has not waited."""
    if not at.usable:
        return at
    root = _root_weights(at, loss)
    r, J = root * at.residual, root[:, None] * at.jacobian
    rows = waiting(at._replace(residual=r, jacobian=J), size, first, shown=True)
    return at._replace(jacobian=without(at.jacobian, size, rows))


class Bend(NamedTuple):
    """How residuals bent along a step: their second derivative by it."""

    step: np.ndarray
    second: np.ndarray

    @classmethod
    def between(
        cls, at: Evaluation, tried: Evaluation, step: np.ndarray, accepted: bool
    ) -> "Bend | None":
        """From both ends of a step; None where one has no numbers of a whole run."""
        if at.failed or tried.failed or not tried.usable:
            return None
        if accepted:
            return cls(step, (tried.jacobian - at.jacobian) @ step)
        return cls(step, 2.0 * (tried.residual - at.residual - at.jacobian @ step))

    def along(self, step: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """The same along the share of another step that has this one's direction."""
        own = scale * self.step
        share = np.sum(own * scale * step) / np.sum(own**2)
        return share**2 * self.second


def _length(step: np.ndarray, scale: np.ndarray) -> float:
    return float(np.linalg.norm(scale * step))


def _ahead(
    z: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Where a step leads: what reaches a side is on it, not beside it by a rounding."""
    below, above = step <= lower - z, step >= upper - z
    return np.where(below, lower, np.where(above, upper, z + step))


def _reaches_side(
    z: np.ndarray,
    step: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    size: np.ndarray,
) -> bool:
    """Whether a step leads from beside bounds onto them."""
    ahead = _ahead(z, step, lower, upper)
    on = (ahead != z) & ((ahead == lower) | (ahead == upper))
    beside = np.abs(ahead - z) <= _BESIDE * size
    return bool(on.any() and beside[on].all())


def _cost(at: Evaluation, loss: Loss) -> float:
    if not at.usable:
        return np.inf
    priors = at.residual[at.of_samples.size :]
    return 0.5 * float(np.sum(loss.value(at.of_samples**2)) + np.sum(priors**2))


def _step(
    r: np.ndarray,
    J: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    damping: float,
    scale: np.ndarray,
) -> np.ndarray:
    """The damped step within a box; coordinates that reach its sides stay there."""
    gradient = J.T @ r
    inside = ~(
        ((lower >= 0.0) & (gradient > 0.0)) | ((upper <= 0.0) & (gradient < 0.0))
    )
    step = np.zeros_like(scale)
    seen = J.any(axis=0)
    for _ in range(step.size):
        moves = inside & seen
        if not moves.any():
            break
        rest = r + J[:, ~moves] @ step[~moves]
        D = np.sqrt(damping) * np.diag(scale[moves])
        matrix = np.concatenate([J[:, moves], D])
        target = np.concatenate([-rest, np.zeros(moves.sum())])
        step[moves] = np.linalg.lstsq(matrix, target, rcond=None)[0]
        cut = np.clip(step, lower, upper)
        out = moves & (cut != step)
        step = cut
        if not out.any():
            break
        inside &= ~out
    return step


def _bent(
    step: np.ndarray,
    second: np.ndarray,
    J: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    damping: float,
    scale: np.ndarray,
) -> np.ndarray:
    """A step corrected by how residuals bend along it, where that is less than it.

    A coordinate that the step puts on a side stays there: the correction would leave it
    beside the bound, by less and less with each step.
    """
    on = (step <= lower) | (step >= upper)
    box = np.where(on, 0.0, lower), np.where(on, 0.0, upper)
    bent = step + _step(0.5 * second, J, *box, damping, scale)
    if _length(bent - step, scale) > _MOST_BENT * _length(step, scale):
        return step
    return np.clip(bent, lower, upper)
