"""Inertias near a known one that some body can have."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..dynamics.bodies import checked_inertia
from ..identification.inertia_transforms import FLAT, second_moments_of
from ..validation.checks import FieldError, is_traced, not_negative
from .distribution_checks import described, inside
from .distributions import AbstractDistribution


class InertiaPerturbation(AbstractDistribution):
    """Inertias about a known one, each of which a distribution of mass can have.

    The second moments of the density, ``S = tr(I)/2 1 - I``, become ``C M M^T C^T``:
    ``C C^T = S``, and M is lower triangular with ``exp(r z / 2)`` on its diagonal and
    ``r z / sqrt(2)`` below it, z standard normal. To first order in r the second moment
    along any axis has the relative standard deviation r, and principal axes turn.
    Positive definite for every z, so that no principal moment exceeds the sum of the
    others; a flat body stays flat, in its plane.

    Attributes:
        inertia: About the mass centre [kg m^2], shape (3, 3).
        relative: r [1].
        root: C [kg^(1/2) m], shape (3, k), k = 3, of a flat body 2.

    Source: Rucker and Wensing, Smooth parameterization of rigid-body inertia, IEEE
    Robot. Autom. Lett. 7 (2022), for the log-Cholesky coordinates.
    """

    inertia: Float[Array, "3 3"]
    relative: Float[Array, ""]
    root: Float[Array, "3 k"]

    def __init__(self, inertia: Any, relative: ArrayLike):
        """Make the distribution.

        Args:
            inertia: The 3 x 3 tensor about the mass centre, body axes [kg m^2].
            relative: Relative standard deviation of second moments along any axis [1],
                zero or more; 0.05 is five per cent.

        Raises:
            FieldError: an inertia that no body can have, or a traced one; a negative
                deviation.
        """
        field = "InertiaPerturbation.inertia"
        if is_traced(inertia):
            problem = "must be known: whether the body is flat depends on it"
            raise FieldError(field, "...", problem, "give numbers, and trace relative")
        self.inertia = checked_inertia(field, inertia)
        self.relative = not_negative(
            "InertiaPerturbation.relative", relative, "of zero or more"
        )
        moments, axes = np.linalg.eigh(second_moments_of(inertia))
        thick = moments > FLAT * moments[-1]
        root = axes[:, thick] * np.sqrt(moments[thick])
        self.root = jnp.asarray(root, self.inertia.dtype)

    @property
    def shape(self) -> tuple[int, ...]:
        """A tensor."""
        return (3, 3)

    @property
    def size(self) -> int:
        """Six uniform numbers; of a flat body three."""
        k = self.root.shape[1]
        return k * (k + 1) // 2

    def draw(self, u: Float[Array, " size"]) -> Float[Array, "3 3"]:
        """The inertia [kg m^2]."""
        z = ndtri(inside(u))
        spread = self.relative.astype(z.dtype) * z
        k = self.root.shape[1]
        rows, columns = np.tril_indices(k, -1)
        below = jnp.sqrt(jnp.asarray(0.5, z.dtype)) * spread[k:]
        M = jnp.diag(jnp.exp(0.5 * spread[:k])).at[rows, columns].set(below)
        factor = self.root.astype(z.dtype) @ M
        S = factor @ factor.T
        return jnp.trace(S) * jnp.eye(3, dtype=S.dtype) - S

    def spec(self) -> dict[str, Any]:
        """Kind and numbers."""
        return described(self, "inertia", "relative")
