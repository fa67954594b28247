"""A branch of steady motions: points, what is critical on it, its picture."""

import dataclasses
from os import PathLike
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float

from .local_model import values_along
from .newton import Asked, Point
from .quantities import quantity
from .spectrum import Spectrum


@dataclasses.dataclass(frozen=True)
class BranchPoint:
    """A steady motion on a branch.

    Attributes:
        value: Of what is varied [its unit].
        state: At the time zero.
        generator: Group velocities by name [m/s] or [rad/s].
        held: Held quantities by name.
        eigenvalues: As of ``SteadyMotion`` [1/s].
        stable: Whether none grows beyond its error.
    """

    value: float
    state: Any
    generator: dict[str, float]
    held: dict[str, float]
    eigenvalues: Complex[np.ndarray, " k"]
    stable: bool
    solution: Point = dataclasses.field(repr=False)
    told: Spectrum = dataclasses.field(repr=False)
    tangent: np.ndarray = dataclasses.field(repr=False)

    @property
    def exponents(self) -> np.ndarray:
        """The eigenvalues [1/s], shape (k,), as :class:`Followed` has them."""
        return self.eigenvalues

    @property
    def errors(self) -> np.ndarray:
        """How far rounding may move each [1/s], shape (k,)."""
        return self.told.errors

    @property
    def unstable(self) -> int:
        """How many grow."""
        return self.told.unstable

    @property
    def determinants(self) -> tuple[tuple[complex, float], ...]:
        """The product of the eigenvalues, of which one passes zero."""
        return ((0j, self.told.determinant),)

    @property
    def turning(self) -> float:
        """Change of what is varied along the branch [1]."""
        return float(self.tangent[-1])


@dataclasses.dataclass(frozen=True)
class Critical:
    """Where a branch turns or its stability changes.

    Attributes:
        kind: "fold": what is varied turns back; "zero crossing": an eigenvalue, or a
            pair of opposite ones, passes zero; "Hopf": a pair passes the imaginary axis
            and damping changes its sign; "collision": two pairs meet on the axis and
            leave it.
        value: Of what is varied [its unit].
        state: There.
        eigenvalue: That passes or meets [1/s].
    """

    kind: str
    value: float
    state: Any
    eigenvalue: complex
    point: BranchPoint = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class Branch:
    """A one-parameter family of steady motions, in the order of its arc length.

    Attributes:
        vary: What is varied.
        points: Steady motions.
        critical: Folds and changes of stability between them.
        asked: What was solved.
        span: Least and largest value of what is varied [its unit].
        ends: Why the branch ends where it begins, and where it ends: ``"span"``,
            ``"max_points"``, or ``"not found"``: no motion farther on.
    """

    vary: str
    points: tuple[BranchPoint, ...]
    critical: tuple[Critical, ...]
    asked: Asked = dataclasses.field(repr=False)
    span: tuple[float, float] = (-np.inf, np.inf)
    ends: tuple[str, str] = ("span", "span")

    @property
    def values(self) -> Float[np.ndarray, " P"]:
        """Of what is varied, at every point, shape (P,)."""
        return np.array([point.value for point in self.points])

    @property
    def stable(self) -> Bool[np.ndarray, " P"]:
        """Whether each point is stable, shape (P,)."""
        return np.array([point.stable for point in self.points])

    def along(self, name: str) -> Float[np.ndarray, " P"]:
        """A quantity at every point: held, a group velocity, or any other, shape (P,).

        Raises:
            FieldError: nothing has the name.
        """
        first = self.points[0]
        if name in first.held or name in first.generator:
            return np.array([(p.held | p.generator)[name] for p in self.points])
        one = quantity("Branch.along", self.asked.problem, first.state, name)
        states = [p.state for p in self.points]
        velocities = np.array([p.solution.xi for p in self.points])
        return np.array(
            values_along(
                self.asked.problem,
                self.asked.keys,
                one,
                states,
                velocities,
                self.values,
            )
        )

    def plot(
        self,
        path: str | PathLike[str] | None = None,
        show: str | None = None,
        title: str = "",
    ) -> Any:
        """Draw the diagram (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            show: Held quantity, group velocity, or "growth" [1/s], against what is
                varied; None: the growth.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_family import plot_family

        return plot_family(self, path, show, title)

    def __str__(self) -> str:
        """How many points, and what is critical."""
        count = int(np.sum(self.stable))
        low, high = self.values.min(), self.values.max()
        rows = [
            f"{len(self.points)} steady motions, {self.vary} from {low:.9g} to "
            f"{high:.9g}, {count} of them stable"
        ]
        for place, end in zip(("begins", "ends"), self.ends, strict=True):
            if end != "span":
                why = "max_points" if end == "max_points" else "no motion farther on"
                rows.append(f"  {place} within the span: {why}")
        rows += [
            f"  {c.kind:<16}{self.vary} = {c.value:.12g}, eigenvalue "
            f"{c.eigenvalue.real:.4g}{c.eigenvalue.imag:+.6g}i 1/s"
            for c in self.critical
        ]
        return "\n".join(rows)
