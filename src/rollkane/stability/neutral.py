"""Directions in which a motion has neighbours of its own kind, and integrals.

A change of the start along the flow, or along a symmetry of the scene, neither grows
nor decays; nor does the difference of an energy that is kept. What a perturbation does
beyond that is what stability is about.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics import observables
from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..kinematics.coordinates import State
from .independent_coordinates import IndependentCoordinates
from .symmetries import Symmetries, symmetries

FLOW = "flow"
# of directions scaled to unit length: those this close to depending on the others
# do not count
_DEPENDENT = {8: 1e-7, 4: 1e-3}

_Along: TypeAlias = Callable[[State], Array]
Integral: TypeAlias = Callable[[Scene, Array, State], Array]
_INTEGRALS: dict[str, Integral] = {
    "energy": observables.energy,
    "moving energy": observables.moving_energy,
}


class Neutral(NamedTuple):
    """Of a state, in independent coordinates around it.

    Attributes:
        names: Of the independent directions: symmetries, and ``"flow"``.
        directions: Changes of the coordinates, one row for each name, shape (r, n).
        integrals: Names of the integrals.
        slopes: Their derivatives by the coordinates, shape (s, n).
        flow: Rates of the coordinates, whether they are among the directions or not,
            shape (n,); None: the scene depends on time.
    """

    names: tuple[str, ...]
    directions: np.ndarray
    integrals: tuple[str, ...]
    slopes: np.ndarray
    flow: np.ndarray | None

    @property
    def all_names(self) -> tuple[str, ...]:
        """Of directions and of integrals."""
        return self.names + self.integrals


def neutral(around: IndependentCoordinates, group: Symmetries) -> Neutral:
    """Neutral directions at a state, as many as are independent, and integrals.

    Args:
        around: Coordinates around the state.
        group: Symmetries of its scene; those that were looked for near no state are
            looked for near this one.
    """
    if not group.placed:
        group = symmetries(around.scene, around.reference, around.time)
    kind = observables.kept_energy(around.scene)
    autonomous = group.drift is not None
    rows, slopes = _rows(around, group, autonomous, kind)
    names = tuple(group.names) + ((FLOW,) if autonomous else ())
    loose = _DEPENDENT[np.dtype(rows.dtype).itemsize]
    kept = independent_rows(np.asarray(rows, float), loose)
    slope = np.asarray(slopes, float)
    # an energy at rest, at its least, has no slope: nothing is held by it
    size = np.linalg.norm(slope, axis=1)
    steep = [k for k in range(slope.shape[0]) if size[k] > 0.0]
    integrals = (kind,) if kind else ()
    return Neutral(
        tuple(names[k] for k in kept),
        np.asarray(rows, float)[kept],
        tuple(integrals[k] for k in steep),
        slope[steep],
        np.asarray(rows, float)[-1] if autonomous else None,
    )


def tangents(around: IndependentCoordinates, group: Symmetries) -> np.ndarray:
    """Changes of the coordinates that generators make, one row each, shape (K, n)."""
    rows, _ = _rows(around, group, False, "")
    return np.asarray(rows, float)


@for_one_call
def _rows(
    around: IndependentCoordinates, group: Symmetries, autonomous: bool, kind: str
) -> tuple[Float[Array, "r n"], Float[Array, "s n"]]:
    scene, t = around.scene, around.time
    rest = jnp.zeros(around.count, t.dtype)
    state = around.state(rest)
    tangents: list[State] = [group[name](state, t) for name in group.names]
    if autonomous:  # last: of a steady motion it depends on the symmetries
        difference: Callable[[Array, Array], Array] = lambda a, b: a - b
        carrying = group.carrying(state, t)
        rates = rolling_derivative(scene, t, state)
        tangents.append(jax.tree.map(difference, rates, carrying))
    slopes = jnp.zeros((0, around.count), t.dtype)
    if kind:

        def kept(x: Array) -> Array:
            return _INTEGRALS[kind](scene, t, around.state(x))

        slopes = cast(Array, jax.jacfwd(kept)(rest))[None]
    rows = jnp.zeros((0, around.count), t.dtype)
    if tangents:
        along = cast(_Along, jax.linearize(around.image, state)[1])
        images = jnp.stack([along(one) for one in tangents], axis=1)
        # by one QR for all; the coordinates are the image's least squares
        q, upper = cast(tuple[Array, Array], jnp.linalg.qr(around.basis()))
        rows = cast(Array, jnp.linalg.solve(upper, q.T @ images)).T
    return rows, slopes


def independent_rows(rows: np.ndarray, loose: float) -> list[int]:
    """Numbers of rows, from the first, that do not depend on those before.

    Args:
        rows: Shape (r, n).
        loose: Share of a row, scaled to unit length, that has to be new.
    """
    basis = np.zeros((0, rows.shape[1]))
    largest = np.linalg.norm(rows, axis=1).max(initial=0.0)
    kept: list[int] = []
    for k, row in enumerate(rows):
        size = np.linalg.norm(row)
        if not size > loose * largest:
            continue
        new = row / size
        for _ in range(2):  # once more takes out the rounding of the first
            new = new - basis.T @ (basis @ new)
        if np.linalg.norm(new) > loose:
            basis = np.concatenate([basis, new[None] / np.linalg.norm(new)])
            kept.append(k)
    return kept
