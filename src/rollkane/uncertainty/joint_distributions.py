"""Numbers that vary together: normal ones, and any by a Gaussian copula."""

from collections.abc import Mapping
from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from jaxtyping import Array, Float

from ..validation.checks import FieldError, is_traced, real
from .distribution_checks import described, inside, listed, root_of
from .distributions import AbstractDistribution, AbstractUnivariate
from .normal_tails import log_normal_cdf


class MultivariateNormal(AbstractDistribution):
    """Normal numbers with a covariance.

    Attributes:
        mean: [unit of what it draws], shape (n,).
        covariance: [its square], shape (n, n).
        root: L, lower triangular, with ``L L^T`` the covariance, shape (n, n).
    """

    mean: Float[Array, " n"]
    covariance: Float[Array, "n n"]
    root: Float[Array, "n n"]

    def __init__(self, mean: Any, covariance: Any):
        """Make the distribution.

        Args:
            mean: n numbers [unit of what it draws].
            covariance: n x n numbers [its square]: symmetric, without a negative
                eigenvalue; zero ones are numbers that do not vary.

        Raises:
            FieldError: no finite numbers, a covariance of another shape, one that is
                not symmetric or indefinite.
        """
        field = "MultivariateNormal.covariance"
        self.mean = real("MultivariateNormal.mean", mean, (None,), "n numbers")
        n = self.mean.shape[0]
        self.covariance = real(field, covariance, (n, n), f"{n} x {n} numbers")
        self.root = root_of(field, covariance, self.covariance)

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers that it draws."""
        return self.mean.shape

    @property
    def size(self) -> int:
        """One uniform number for each."""
        return self.mean.shape[0]

    def draw(self, u: Float[Array, " n"]) -> Float[Array, " n"]:
        """``mean + L z``."""
        z = ndtri(inside(u))
        return self.mean.astype(z.dtype) + self.root.astype(z.dtype) @ z

    def spec(self) -> dict[str, Any]:
        """Kind and numbers."""
        return described(self, "mean", "covariance")


class Correlated(AbstractDistribution):
    """Numbers of any distributions, correlated by a Gaussian copula.

    Each keeps its own distribution. The correlation is that of the underlying standard
    normal numbers ``Phi^-1(F(x))``, not of the draws: those of normal distributions
    have it, too; of others Spearman's rank correlation is ``6/pi asin(r/2)``.

    Attributes:
        names: Of the numbers, in order.
        members: Their distributions.
        correlation: Of the underlying normal numbers [1], shape (n, n).
        root: Its root, lower triangular, shape (n, n).

    Source: Nataf, C. R. Acad. Sci. 225 (1962); Liu and Der Kiureghian, Probab. Eng.
    Mech. 1 (1986).
    """

    names: tuple[str, ...] = eqx.field(static=True)
    members: tuple[AbstractUnivariate, ...]
    correlation: Float[Array, "n n"]
    root: Float[Array, "n n"]

    def __init__(
        self, distributions: Mapping[str, AbstractUnivariate], correlation: Any
    ):
        """Join distributions.

        Args:
            distributions: By name, each of one number [its unit]; draws are by these
                names.
            correlation: Of the underlying normal numbers, in the order of the names:
                n x n [1], symmetric, ones on its diagonal; or, of two distributions,
                the one number off the diagonal.

        Raises:
            FieldError: fewer than two, one that is not of one number, a correlation
                that is none.
        """
        field = "Correlated.distributions"
        known = cast(object, distributions)
        if not isinstance(known, Mapping) or len(distributions) < 2:
            remedy = 'give for example {"speed": Normal(5.0, 0.2), "tilt": ...}'
            problem = "must be two or more, by name"
            raise FieldError(field, distributions, problem, remedy)
        for name, one in distributions.items():
            if not isinstance(cast(object, name), str) or not name.isidentifier():
                problem = "has a name that is no word"
                raise FieldError(field, name, problem, "use letters, digits and _")
            scalar = isinstance(cast(object, one), AbstractUnivariate)
            if not scalar or one.shape != ():
                remedy = "give Normal, Uniform, LogNormal, Truncated or Empirical"
                problem = "must be a distribution of one number"
                raise FieldError(f"{field}[{name!r}]", one, problem, remedy)
        self.names = tuple(distributions)
        self.members = tuple(distributions.values())
        given, self.correlation = _correlation(correlation, len(self.names))
        self.root = root_of("Correlated.correlation", given, self.correlation)

    @property
    def shape(self) -> dict[str, tuple[int, ...]]:
        """Numbers, by name."""
        return {name: () for name in self.names}

    @property
    def size(self) -> int:
        """One uniform number for each."""
        return len(self.names)

    def draw(self, u: Float[Array, " n"]) -> dict[str, Float[Array, ""]]:
        """Quantiles at the probabilities of correlated normal numbers, by name."""
        z = ndtri(inside(u))
        x = self.root.astype(z.dtype) @ z
        below, above = log_normal_cdf(x), log_normal_cdf(-x)
        return {
            name: one.quantile(below[k], above[k])
            for k, (name, one) in enumerate(zip(self.names, self.members, strict=True))
        }

    def spec(self) -> dict[str, Any]:
        """Kind, correlation, and distributions by name."""
        every = zip(self.names, self.members, strict=True)
        return {
            "kind": "Correlated",
            "correlation": listed(self.correlation),
            "distributions": [[name, one.spec()] for name, one in every],
        }


def _correlation(value: Any, n: int) -> tuple[Any, Array]:
    """A correlation matrix as given, or of two by its one number; and as an array."""
    field = "Correlated.correlation"
    single = isinstance(value, (int, float)) or getattr(value, "shape", None) == ()
    if n == 2 and single:
        real(field, value, (), "a number between -1 and 1")
        library: Any = jnp if is_traced(value) else np
        value = library.array([[1.0, value], [value, 1.0]])
    matrix = real(field, value, (n, n), f"{n} x {n} numbers")
    if not is_traced(value):
        known = np.asarray(value, float)
        # rounding of a diagonal that was computed
        if np.max(np.abs(np.diag(known) - 1.0)) > 1e-6:
            remedy = "divide a covariance by the deviations of its rows and columns"
            raise FieldError(field, value, "must have ones on its diagonal", remedy)
        if np.max(np.abs(known)) > 1.0 + 1e-6:
            remedy = "give correlations between -1 and 1"
            raise FieldError(field, value, "exceeds one", remedy)
    return value, matrix
