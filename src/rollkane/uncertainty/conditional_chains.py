"""Markov chains of standard normal numbers that stay where a margin is large enough.

All chains take a step together, so that a model runs as many motions at once as there
are chains.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Of proposals; the least variance of an estimate from chains is near it (section 3.4).
_GOAL = 0.44
_FIRST_SCALE = 0.6

Margin = Callable[[np.ndarray], np.ndarray]


class Chains(NamedTuple):
    """States of m chains, s of each.

    Attributes:
        z: Standard normal numbers [1], shape (s, m, d); the first are the seeds.
        margin: Of each, shape (s, m) [unit of the output].
        accepted: Share of proposals that were [1].
        scale: Of the proposals' spread, for the next ones [1].
    """

    z: Float[np.ndarray, "s m d"]
    margin: Float[np.ndarray, "s m"]
    accepted: float
    scale: float


def conditional_chains(
    margin: Margin,
    seeds: Float[np.ndarray, "m d"],
    seed_margins: Float[np.ndarray, " m"],
    level: float,
    steps: int,
    rng: np.random.Generator,
    scale: float = _FIRST_SCALE,
) -> Chains:
    """Chains whose states are standard normal given that the margin reaches a level.

    A proposal is the state shrunk by rho with normal numbers of deviation sigma added,
    ``rho^2 + sigma^2 = 1``, so that the standard normal density is kept and only the
    level decides; sigma follows the seeds' deviation and the share of what is accepted.

    Args:
        margin: Of states, shape (m, d), their margins, shape (m,); -inf where a motion
            failed.
        seeds: First states [1].
        seed_margins: Their margins, none below the level.
        level: That every margin reaches [unit of the output].
        steps: States of each chain, the seed among them.
        rng: Random numbers.
        scale: Of the proposals' spread [1].

    Source: Papaioannou, Betz, Zwirglmaier and Straub, Prob. Eng. Mech. 41 (2015),
    sections 3.3 and 3.4; all chains adapt together, once a step.
    """
    z = np.empty((steps, *seeds.shape))
    margins = np.empty((steps, len(seeds)))
    z[0], margins[0] = seeds, seed_margins
    # more than one where the event lies on several sides, each of them narrow
    spread = np.minimum(seeds.std(axis=0), 1.0)
    accepted = 0.0
    for i in range(1, steps):
        sigma = np.minimum(scale * spread, 1.0)
        moved = np.sqrt(1.0 - sigma**2) * z[i - 1]
        moved += sigma * rng.standard_normal(seeds.shape)
        found = margin(moved)
        taken = found >= level
        z[i] = np.where(taken[:, None], moved, z[i - 1])
        margins[i] = np.where(taken, found, margins[i - 1])
        accepted += float(taken.mean())
        scale *= float(np.exp((taken.mean() - _GOAL) / np.sqrt(i)))
    return Chains(z, margins, accepted / max(steps - 1, 1), scale)


def family_share(reached: np.ndarray, families: np.ndarray) -> float:
    """Sum of squares of the families' shares in states that reach a level [1].

    One over it is how many independent states they are worth.

    Args:
        reached: Whether each state does, shape (s, m).
        families: Number of each chain's family, shape (m,).
    """
    sums = np.bincount(families, weights=reached.sum(axis=0))
    return float((sums**2).sum() / max(sums.sum(), 1.0) ** 2)


def family_variance(reached: np.ndarray, families: np.ndarray) -> float:
    """Relative variance of the probability of all levels up to this one [1].

    Families descend from one of n first, independent states each. Of one level it is
    ``(1 - p) / (p n)``; their shares alone tell ``1 / (p n)``. Each level takes every
    state of the one before it once, so that what is too much stays ``1 / n``. States
    of a chain, and so of a family, may be alike: families are independent.

    Args:
        reached: Whether each state does, shape (s, m); s m is how many were the first.
        families: Number of each chain's family, shape (m,).

    Source: Lee and Whiteley, Biometrika 105 (2018), for particle filters, of which
    subset simulation is one; of one level it is that of Au and Beck, Prob. Eng. Mech.
    16 (2001).
    """
    return max(family_share(reached, families) - 1.0 / reached.size, 0.0)
