"""Parameters of a fit, as uncertain as its records leave them."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from jaxtyping import Array, Float

from ..dynamics.scene import Scene
from ..identification import paths
from ..identification.bounded_intervals import LinearBox
from ..identification.fit_result import Fit
from ..identification.layout import Coordinates
from ..identification.parameters import Model, Values, located, with_numbers
from ..identification.transforms import AbstractTransform
from ..validation.checks import FieldError, whole
from .distribution_checks import inside, listed, root_of
from .distributions import AbstractDistribution
from .truncated_normal import Box, Tilt, drawn_within, tilt_of

# Standard deviations of a logarithm: uniform numbers of 53 digits are within 8.3 of
# them, and e^83 is a number in single precision, too.
_WIDEST = 10.0
_OF_MOTION = ("scene", "start")  # roots of what a draw is put into


@dataclasses.dataclass(frozen=True)
class _Place:
    """Where a parameter is.

    Attributes:
        path: As the user wrote it.
        keys: In a model.
        record: Whose it is; None: of all.
        first: Its first coordinate.
        stop: The one behind its last.
    """

    path: str
    keys: paths.Keys
    record: int | None
    first: int
    stop: int


class FitCovariance(AbstractDistribution):
    """A fit's parameters, normal in its coordinates about the estimates.

    These keep every draw physical: logarithms of positive numbers, second moments of
    inertias, small rotations. What has bounds is normal within them, about where the
    estimate would be without them, several together; others follow it. (A draw of
    several is made again where it has too little probability, by numbers that follow
    from its uniform ones: there it has no derivative by these.) Draws are by path; of
    several records' own parameters stacked, as in ``estimates``.

    Attributes:
        center: Coordinates of the estimates, as without bounds, shape (P,).
        order: Of the coordinates: those with bounds first.
        limited: Which coordinates have bounds.
        root: Of their covariance, as without bounds, in that order, lower triangular,
            shape (P, P).
        lower: Bounds of the coordinates, shape (P,).
        upper: Likewise.
        tilt: How those with bounds are drawn together.
        transforms: Of each parameter.
        places: Where each is.
        tied: Parameters that follow: path, keys, function.
        scene: The model at the estimates.
        starts: At the estimates, of each record.
        times: When they are [s], of each record.

    Source: the linear covariance of least squares, as :class:`rollkane.Fit` has it.
    """

    center: Float[Array, " P"]
    order: tuple[int, ...] = eqx.field(static=True)
    limited: tuple[bool, ...] = eqx.field(static=True)
    root: Float[Array, "P P"]
    lower: Float[Array, " P"]
    upper: Float[Array, " P"]
    tilt: Tilt
    transforms: tuple[AbstractTransform, ...]
    places: tuple[_Place, ...] = eqx.field(static=True)
    tied: tuple[tuple[str, paths.Keys, Callable[[Values], Any]], ...] = eqx.field(
        static=True
    )
    scene: Scene
    starts: tuple[Any, ...]
    times: tuple[Float[Array, ""], ...]

    def __init__(self, fit: Fit):
        """Take what a fit found.

        Args:
            fit: Of :func:`rollkane.fit`; each parameter [its unit].

        Raises:
            FieldError: something else, parameters that the records do not show, or
                positive ones that they do not show to any factor.
        """
        field = "FitCovariance.fit"
        if not isinstance(cast(object, fit), Fit):
            raise FieldError(field, fit, "must be a Fit", "give what rollkane.fit gave")
        if fit.unseen:
            problem = "has parameters that its records do not show"
            remedy = "hold one of them, or give a prior"
            raise FieldError(field, fit.unseen, problem, remedy)
        layout = fit.problem.layout
        linear = LinearBox(fit)
        known = linear.covariance
        for entry in layout.entries:
            _check_width(field, entry, known)
        self.center = jnp.asarray(linear.free)
        limited = np.isfinite(layout.lower) | np.isfinite(layout.upper)
        self.limited = tuple(limited.tolist())
        self.order = tuple(np.argsort(~limited, kind="stable").tolist())
        ordered = known[np.ix_(self.order, self.order)]
        self.root = root_of(field, ordered, jnp.asarray(ordered))
        self.lower, self.upper = jnp.asarray(layout.lower), jnp.asarray(layout.upper)
        order, count = np.asarray(self.order), int(limited.sum())
        own = self.center[order], self.root[:, :count], self.lower[order]
        self.tilt = tilt_of(Box(*(x[:count] for x in (*own, self.upper[order]))))
        channels = {name: None for m in layout.models for name in m.channels}
        self.transforms = tuple(entry.transform for entry in layout.entries)
        self.places = tuple(_place(entry, channels) for entry in layout.entries)
        self.tied = tuple(
            (tie.path, located(tie.path, channels), tie.value) for tie in layout.tied
        )
        self.scene = fit.scene
        several = len(layout.models) > 1
        self.starts = tuple(fit.start) if several else (fit.start,)
        self.times = tuple(model.time for model in layout.models)

    @property
    def shape(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parameters, by path."""
        possible = self._values(jnp.clip(self.center, self.lower, self.upper))
        return {path: value.shape for path, value in possible.items()}

    @property
    def size(self) -> int:
        """One uniform number for each of the fit's coordinates."""
        return self.center.shape[0]

    def draw(self, u: Float[Array, " P"]) -> dict[str, Array]:
        """Parameters by path [their units]."""
        u = inside(u)
        order = jnp.asarray(self.order)
        known = (self.center[order], self.root, self.lower[order], self.upper[order])
        center, root, lower, upper = (x.astype(u.dtype) for x in known)
        z, count = ndtri(u[order]), sum(self.limited)
        if count:
            box = Box(*(x[:count] for x in (center, root[:, :count], lower, upper)))
            tilt = Tilt(*(x.astype(u.dtype) for x in self.tilt))
            z = z.at[:count].set(drawn_within(box, tilt, u[order[:count]]))
        found = jnp.zeros_like(z).at[order].set(center + root @ z)
        return self._values(
            jnp.clip(found, self.lower.astype(u.dtype), self.upper.astype(u.dtype))
        )

    def _values(self, z: Array) -> dict[str, Array]:
        found: dict[str, list[Array]] = {}
        for place, transform in zip(self.places, self.transforms, strict=True):
            value = transform.value(z[place.first : place.stop])
            found.setdefault(place.path, []).append(value)
        own = {place.path for place in self.places if place.record is not None}
        return {p: jnp.stack(v) if p in own else v[0] for p, v in found.items()}

    def apply(self, drawn: Mapping[str, Array], record: int = 0) -> tuple[Scene, Any]:
        """The fitted scene and start with a draw's parameters.

        Parameters of sensors and of ``modes`` are in the draw only.

        Args:
            drawn: What :meth:`draw` gives.
            record: Whose start, and whose own parameters, of a fit of several.

        Raises:
            FieldError: a record that was not fitted, other paths.
        """
        remedy = "give the number of a record that was fitted"
        record = whole("FitCovariance.apply.record", record, 0, remedy)
        if record >= len(self.starts):
            problem = f"is beyond the {len(self.starts)} that were fitted"
            raise FieldError("FitCovariance.apply.record", record, problem, remedy)
        paths_of = {place.path for place in self.places}
        if set(drawn) != paths_of:
            given, remedy = sorted(drawn), f"give those of a draw: {sorted(paths_of)}"
            problem = "are not the fit's"
            raise FieldError("FitCovariance.apply.drawn", given, problem, remedy)
        start, time = self.starts[record], self.times[record]
        values = self._of_record(drawn, record)
        free = [(p.keys, values[p.path]) for p in self.places if p.path in values]
        tied = [(k, of(values)) for _, k, of in self.tied if k[0] in _OF_MOTION]
        numbers = [one for one in free + tied if one[0][0] in _OF_MOTION]
        model = with_numbers(Model(self.scene, start, time, None, {}), numbers)
        return model.scene, model.start

    def _of_record(self, drawn: Mapping[str, Array], record: int) -> Values:
        """A record's parameters: of its own ones, which are stacked, its own."""
        owners: dict[str, list[int | None]] = {}
        for place in self.places:
            owners.setdefault(place.path, []).append(place.record)
        values: Values = {}
        for path, known in owners.items():
            if known == [None]:
                values[path] = drawn[path]
            elif record in known:
                values[path] = drawn[path][known.index(record)]
        return values

    def spec(self) -> dict[str, Any]:
        """Kind, paths, distribution of the coordinates, and the model's numbers."""
        every = (self.transforms, self.scene, self.starts, self.times)
        arrays = filter(eqx.is_inexact_array, jax.tree.leaves(every))
        model = [np.ravel(np.asarray(x, float)) for x in arrays]
        together = {"tilt": [listed(x) for x in self.tilt]}  # one number has none
        return {
            "kind": "FitCovariance",
            "paths": [place.path for place in self.places],
            "center": listed(self.center),
            "order": list(self.order),
            "root": listed(self.root),
            "bounds": [listed(self.lower), listed(self.upper)],
            "model": listed(np.concatenate(model)),
        } | (together if sum(self.limited) > 1 else {})


def _check_width(field: str, entry: Coordinates, known: np.ndarray) -> None:
    """Refuse a logarithm that is so uncertain that draws are infinite, or zero."""
    held = np.isfinite(entry.lower) & np.isfinite(entry.upper)
    rows = entry.transform.logarithms() * ~held
    variances = np.diag(rows @ known[entry.where, entry.where] @ rows.T)
    widest = float(np.sqrt(np.max(variances, initial=0.0)))
    if widest > _WIDEST:
        problem = f"is not known to any factor: its logarithm varies by {widest:.3g}"
        remedy = "hold it, or give it a prior, or bounds above zero"
        raise FieldError(field, entry.name, problem, remedy)


def _place(entry: Coordinates, channels: Mapping[str, Any]) -> _Place:
    keys, where = located(entry.free.path, channels), entry.where
    return _Place(entry.free.path, keys, entry.record, where.start, where.stop)
