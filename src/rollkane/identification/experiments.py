"""All records of a fit as one least-squares problem in the fit's coordinates."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..codegen.compile_effort import for_one_call
from ..dynamics.scene import Scene
from ..hybrid.modes import Modes
from ..kinematics.coordinates import State
from ..simulation.run_options import RunOptions
from ..validation.codes import Code
from .evaluation import Evaluation
from .layout import Coordinates, Layout
from .losses import Loss
from .noise import found_noise, guessed_noise
from .parameters import Free, Model, Tied
from .records import Record
from .residuals import Group, Residuals, grouped, linearized, within
from .transforms import AbstractTransform
from .uncertainty import coordinate_covariance

LONGER = 8.0  # times the horizon that is asked for: how far a run looks ahead
_KEPT = 4  # points whose misfits are kept
# Of a derivative, relative to the size of what is differentiated: sums of 1e4 steps
# with roundings of 1e-16, which grow tenfold.
_ROUNDING = 1e-11

# Which of the coordinates, and misfits with their derivatives by these.
_Where: TypeAlias = slice | np.ndarray
_Rows: TypeAlias = tuple[Any, Any, _Where]


class Problem:
    """Misfits of all records by the fit's coordinates.

    Attributes:
        layout: Free parameters.
        records: What was measured.
        deviations: Of channels without sigma, by record and name.
        parts: Of each record, where its parameters are, and its coordinates.
        rollouts: Runs that were made.
        failed: How many of them did not reach their end.
        progress: Hears of every evaluation: rollouts so far, and chi2.
    """

    progress: Callable[[int, float], None] | None = None

    def __init__(
        self,
        scene: Scene,
        starts: Sequence[State],
        records: Sequence[Record],
        free: tuple[Free | Tied, ...],
        modes: Modes | None,
        options: RunOptions,
    ):
        """Find the parameters in the scene, the starts and the records."""
        self.records = list(records)
        self.free, self.options = free, options
        pairs = zip(starts, records, strict=True)
        models = [
            Model(scene, start, r.start_time, modes, r.channels) for start, r in pairs
        ]
        self.layout = Layout(models, free)
        self.parts = [self.layout.of_record(k) for k in range(len(self.records))]
        self.deviations = [
            {
                name: np.full(c.noise_columns(), guessed_noise(c.values))
                for name, c in record.channels.items()
                if c.sigma is None
            }
            for record in records
        ]
        self.rollouts = self.failed = 0
        self._group()

    def _group(self) -> None:
        self.groups = [
            grouped(record, self.free, deviations)
            for record, deviations in zip(self.records, self.deviations, strict=True)
        ]
        self._known: dict[tuple[int, bytes], tuple[float, Residuals, np.ndarray]] = {}
        sizes = [
            np.asarray(group.time).size * channel.noise_columns()
            for groups in self.groups
            for group in groups
            for channel in group.channels.values()
        ]
        self._channels = np.repeat(np.arange(len(sizes)), sizes)

    def with_noise_of(self, z: np.ndarray, loss: Loss) -> bool:
        """Take the deviations of channels without sigma from the misfits at z.

        Returns:
            Whether any of them changed by more than a hundredth.
        """
        changed = False
        taken = self._taken(z)
        for record, per_channel in enumerate(self.channel_misfits(z)):
            known = self.deviations[record]
            for name in known.keys() & per_channel.keys():
                values = self.records[record].channels[name].values
                rows = per_channel[name], taken[record][name]
                new = found_noise(known[name], *rows, values, loss)
                changed |= bool(np.any(np.abs(new / known[name] - 1.0) > 0.01))
                known[name] = new
        if changed:
            self._group()
        return changed

    def _taken(self, z: np.ndarray) -> list[dict[str, np.ndarray]]:
        """How much of each misfit coordinates take out, by record and channel."""
        at = self.evaluate(z)
        known = coordinate_covariance(at, self.layout, z)
        rows = at.jacobian[: at.of_samples.size]
        shares = np.einsum("ik,kl,il->i", rows, known, rows)
        sizes = [self._row_times(k).size for k in range(len(self.records))]
        parts = np.split(shares, np.cumsum(sizes)[:-1])
        return [
            _split(part, groups)
            for part, groups in zip(parts, self.groups, strict=True)
        ]

    @property
    def span(self) -> float:
        """Length of the longest record [s]."""
        return max(float(r.time[-1] - r.start_time) for r in self.records)

    def evaluate(self, z: np.ndarray, horizon: float = np.inf) -> Evaluation:
        """Misfits up to a horizon after each start, priors after them."""
        rows: list[_Rows] = []
        failed = 0
        for record, (_, where) in enumerate(self.parts):
            at, jacobian = self._up_to(record, z, horizon)
            lost = np.any(at.counted & ~at.reached)
            failed += int(lost and np.any(at.codes != Code.COMPLETED))
            rows.append((at.misfit, jacobian, where))
        priors = [(*_prior(e, z), e.where) for e in self._with_prior()]
        residual, jacobian = _stacked(rows + priors, self.layout.size, np)
        if self.progress is not None:
            self.progress(self.rollouts, float(residual @ residual))
        count = sum(own.size for own, _, _ in priors)
        known = failed, self.rounding, count, self._channels
        return Evaluation(residual, jacobian, *known)

    def _with_prior(self) -> list[Coordinates]:
        return [e for e in self.layout.entries if e.free.prior is not None]

    @property
    def rounding(self) -> float:
        """Of derivatives by relative changes: that of the samples' whole size."""
        read = [
            np.asarray(c.values) / np.mean(np.asarray(c.sigma))
            for groups in self.groups
            for group in groups
            for c in group.channels.values()
        ]
        return _ROUNDING * float(np.sqrt(sum(np.nansum(r**2) for r in read)))

    def _up_to(
        self, record: int, z: np.ndarray, horizon: float
    ) -> tuple[Residuals, np.ndarray]:
        """Misfits of a record up to a horizon, and their derivatives.

        The run goes on beyond it, to where the search may want to look next.
        """
        known = self._known.get((record, z.tobytes()))
        if known is None or known[0] < horizon:
            ahead = LONGER * horizon
            known = ahead, *self._run(record, z, ahead)
            self._known[record, z.tobytes()] = known
            while len(self._known) > _KEPT * len(self.records):
                del self._known[next(iter(self._known))]
        _, at, jacobian = known
        late = (
            self._row_times(record) > float(self.records[record].start_time) + horizon
        )
        kept = at._replace(
            misfit=np.where(late, 0.0, at.misfit), counted=at.counted & ~late
        )
        return kept, np.where(late[:, None], 0.0, jacobian)

    def _run(
        self, record: int, z: np.ndarray, horizon: float
    ) -> tuple[Residuals, np.ndarray]:
        """A record's misfits by a run up to a horizon."""
        slots, where = self.parts[record]
        one = self.records[record]
        groups, counts = within(self.groups[record], float(one.start_time) + horizon)
        self.rollouts += len(groups)
        known = groups, counts, self.options, jnp.asarray(z[where])
        found = linearized(slots, self.layout.models[record], *known)
        at, jacobian = jax.tree.map(np.asarray, (found.at, found.jacobian))
        self.failed += int(np.sum(at.codes != Code.COMPLETED))
        return at, jacobian

    def _row_times(self, record: int) -> np.ndarray:
        """Time of each misfit [s]."""
        return np.concatenate(
            [
                np.repeat(np.asarray(group.time), channel.noise_columns())
                for group in self.groups[record]
                for channel in group.channels.values()
            ]
        )

    def pure(self) -> Callable[[Array], tuple[Array, Array]]:
        """Residuals and their derivatives as a function that JAX can trace."""
        terms = [(_prior_terms(e), e.where) for e in self._with_prior()]
        whole = [within(groups, np.inf) for groups in self.groups]

        def evaluate(z: Array) -> tuple[Array, Array]:
            rows: list[_Rows] = []
            for record, (slots, where) in enumerate(self.parts):
                known = *whole[record], self.options, z[where]
                found = linearized(slots, self.layout.models[record], *known)
                rows.append((found.at.misfit, found.jacobian, where))
            rows += [(*_prior_of(*known, z[where]), where) for known, where in terms]
            return _stacked(rows, self.layout.size, jnp)

        return evaluate

    def prior_volume(self) -> Callable[[Array], Array]:
        """Logarithm of how much of priors' numbers a piece of coordinates is of.

        As a function that JAX can trace, without a constant.
        """
        terms = [(_prior_terms(e), e.where) for e in self._with_prior()]

        def volume(z: Array) -> Array:
            total = jnp.zeros(())
            for known, where in terms:
                _, slope = _prior_of(*known, z[where])
                determinant = cast(Array, jnp.linalg.slogdet(slope.T @ slope)[1])
                total = total + 0.5 * determinant
            return total

        return volume

    def samples(self, horizon: float = np.inf) -> int:
        """Numbers that were measured up to a horizon."""
        return int(sum(np.sum(c) for c in self._sampled(horizon)))

    def _sampled(self, horizon: float) -> list[np.ndarray]:
        found: list[np.ndarray] = []
        for record, groups in zip(self.records, self.groups, strict=True):
            _, counts = within(groups, float(record.start_time) + horizon)
            for group, count in zip(groups, counts, strict=True):
                for channel in group.channels.values():
                    sampled = ~np.isnan(np.asarray(channel.values))
                    if channel.noise_columns() != sampled.shape[1]:
                        sampled = np.repeat(
                            sampled.all(axis=1, keepdims=True),
                            channel.noise_columns(),
                            1,
                        )
                    found.append(sampled & np.asarray(count)[:, None])
        return found

    def channel_misfits(
        self, z: np.ndarray, horizon: float = np.inf, *, reached: bool = False
    ) -> list[dict[str, np.ndarray]]:
        """Misfits over their deviations by record and channel, NaN where none is.

        Args:
            z: Coordinates.
            horizon: Last time of samples that count [s].
            reached: Only of samples that runs reach; the others have what a search
                counts them with.
        """
        found: list[dict[str, np.ndarray]] = []
        for record in range(len(self.records)):
            at, _ = self._up_to(record, z, horizon)
            is_one = at.counted & at.reached if reached else at.counted
            whole = np.where(is_one, at.misfit, np.nan)
            found.append(_split(whole, self.groups[record]))
        return found

    def landings(self, z: np.ndarray) -> list[int]:
        """How often flights end in each record's run, at z."""
        runs = [self._up_to(k, z, np.inf)[0] for k in range(len(self.records))]
        return [int(np.max(at.landings)) for at in runs]

    def sizes(self) -> list[dict[str, np.ndarray]]:
        """Samples over their deviations, without their mean, by record and channel.

        In the shape of the misfits.
        """
        return [
            {
                name: c.variation() / np.mean(np.asarray(c.sigma))
                for g in groups
                for name, c in g.channels.items()
            }
            for groups in self.groups
        ]

    def sigmas(self) -> list[dict[str, np.ndarray]]:
        """Standard deviations of the noise, by record and channel."""
        return [
            {
                name: np.asarray(c.sigma)
                for g in groups
                for name, c in g.channels.items()
            }
            for groups in self.groups
        ]

    def times(self) -> list[dict[str, np.ndarray]]:
        """Times of the samples that count, by record and channel [s]."""
        return [
            {name: np.asarray(g.time) for g in groups for name in g.channels}
            for groups in self.groups
        ]


def _stacked(rows: list[_Rows], size: int, xp: Any) -> tuple[Any, Any]:
    """Residuals, and their derivatives by all coordinates, of NumPy's or of JAX."""

    def by_all(slope: Any, where: _Where) -> Any:
        index = np.full(size, slope.shape[1])
        index[where] = np.arange(slope.shape[1])
        none = xp.zeros((slope.shape[0], 1), slope.dtype)
        return xp.concatenate([slope, none], axis=1)[:, index]

    values, slopes, places = zip(*rows, strict=True)
    columns = [by_all(*pair) for pair in zip(slopes, places, strict=True)]
    return xp.concatenate(values), xp.concatenate(columns)


def _split(whole: np.ndarray, groups: tuple[Group, ...]) -> dict[str, np.ndarray]:
    """Rows of a record by channel, in the shape of its misfits."""
    found: dict[str, np.ndarray] = {}
    first = 0
    for group in groups:
        for name, channel in group.channels.items():
            shape = channel.values.shape[0], channel.noise_columns()
            found[name] = whole[first : first + shape[0] * shape[1]].reshape(shape)
            first += shape[0] * shape[1]
    return found


@for_one_call
def _prior_of(
    transform: AbstractTransform, mean: Array, deviation: Array, z: Array
) -> tuple[Array, Array]:
    away: Callable[[Array], Array]
    numbers = transform.independent
    away = lambda z: (numbers(transform.value(z)) - numbers(mean)) / deviation
    return away(z), cast(Array, jax.jacfwd(away)(z))


def _prior_terms(entry: Coordinates) -> tuple[AbstractTransform, Array, Array]:
    """Coordinates of a parameter, its prior's mean, and deviations of its numbers."""
    assert entry.free.prior is not None
    shape = np.shape(entry.transform.value(jnp.asarray(entry.transform.start())))
    mean, deviation = (
        jnp.broadcast_to(jnp.asarray(x, float), shape) for x in entry.free.prior
    )
    return entry.transform, mean, entry.transform.deviations(deviation)


def _prior(entry: Coordinates, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from a prior's mean over its deviation, and derivatives."""
    value, slope = _prior_of(*_prior_terms(entry), jnp.asarray(z[entry.where]))
    return np.asarray(value), np.asarray(slope)
