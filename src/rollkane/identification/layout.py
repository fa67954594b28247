"""The coordinates that a fit varies: of all records, and of each."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..validation.checks import FieldError
from . import paths
from .field_coordinates import bounds_of, is_clock, transform_of
from .parameters import PLACING, Free, Model, Slot, Slots, Tied, located, number_in
from .transform_values import TransformValues, values_at
from .transforms import AbstractTransform, Positive

# How far a coordinate goes to see whether the body still touches [its size]: beyond
# what placing overlooks, 1e-6 rad (1e-3 in single precision).
_ASIDE = 1e-2
_FAR = 3.0  # deviations of a prior: where it says that a number is not


class Coordinates(NamedTuple):
    """One free parameter among the coordinates of a fit.

    Attributes:
        free: What was asked for.
        record: Whose it is; None: of all.
        transform: Its coordinates.
        where: Which of the fit's coordinates they are.
        lower: Bounds of them, shape (k,).
        upper: Likewise.
    """

    free: Free
    record: int | None
    transform: AbstractTransform
    where: slice
    lower: np.ndarray
    upper: np.ndarray

    @property
    def name(self) -> str:
        """Its path, with the record that it is of."""
        return self.free.path + ("" if self.record is None else f" {{{self.record}}}")

    def at(self, z: np.ndarray) -> TransformValues:
        """The parameter and its derivatives, at coordinates z of the fit."""
        return values_at(self.transform, z[self.where])


class Layout:
    """Free parameters of a fit: of all records, and of each.

    Attributes:
        entries: Parameters in the order of their coordinates.
        tied: Those that follow.
        start: Coordinates of the start, shape (P,).
        lower: Bounds, shape (P,).
        upper: Likewise.
        scale: Size of each, shape (P,).
    """

    def __init__(self, models: Sequence[Model], free: Sequence[Free | Tied]):
        """Find the parameters in the models.

        Raises:
            FieldError: paths that lead nowhere, a parameter named twice, bounds or
                priors that do not fit.
        """
        wanted = [f for f in free if isinstance(f, Free)]
        self.tied = [f for f in free if isinstance(f, Tied)]
        if not wanted or len(wanted) + len(self.tied) != len(free):
            remedy = 'give rollkane.Free("body.inertia"), or several of them'
            raise FieldError("free", free, "must hold parameters", remedy)
        self.models = list(models)
        _check_apart(self.models, free)
        self.entries: list[Coordinates] = []
        for one in wanted:
            of_start = paths.keys_of(one.path)[0] == "start"
            own = of_start if one.shared is None else not one.shared
            several = own and len(models) > 1
            for record in _owners(self.models, one.path) if several else (None,):
                self._add(one, record)
        join: Callable[[list[Any]], np.ndarray]
        join = lambda parts: np.concatenate([np.atleast_1d(p) for p in parts])
        self.start = join([e.transform.start() for e in self.entries])
        self.lower = join([e.lower for e in self.entries])
        self.upper = join([e.upper for e in self.entries])
        self.scale = join([e.transform.scale() for e in self.entries])
        for tie in self.tied:
            self._check_tie(tie)
        for entry in self.entries:
            self._check_touches(entry)

    def _add(self, free: Free, record: int | None) -> None:
        first_owner = _owners(self.models, free.path)[0]
        model = self.models[first_owner if record is None else record]
        keys, value = _array_at(model, free.path)
        transform = transform_of(free, model, keys, value)
        first = self.entries[-1].where.stop if self.entries else 0
        size = transform.start().size
        where = slice(first, first + size)
        lower, upper = bounds_of(free, model, keys, transform)
        _check_prior(free, value, isinstance(transform, Positive))
        entry = Coordinates(free, record, transform, where, lower, upper)
        self.entries.append(entry)

    def _check_tie(self, tie: Tied) -> None:
        """Refuse what does not follow from the free parameters."""
        field = f"Tied({tie.path!r}).value"
        for record in _owners(self.models, tie.path):
            keys, old = _array_at(self.models[record], tie.path)
            if keys[0] == "channels" and keys[-1] == "delay":
                remedy = "free it, with bounds"
                raise FieldError(field, tie.path, "cannot follow: a delay", remedy)
            slots, where = self.of_record(record)
            values = slots.values(jnp.asarray(self.start[where]))
            try:
                np.broadcast_to(np.asarray(tie.value(values), float), old.shape)
            except KeyError as error:
                remedy = f"use those of {tuple(values)}"
                raise FieldError(field, error.args[0], "is not free", remedy) from error
            except (TypeError, ValueError) as error:
                problem = f"must give numbers of shape {old.shape}"
                raise FieldError(field, "...", problem, str(error)) from error

    def _check_touches(self, entry: Coordinates) -> None:
        """Refuse what leaves a body no point to touch with: a cylinder that tilts."""
        first_owner = _owners(self.models, entry.free.path)[0]
        record = first_owner if entry.record is None else entry.record
        places = PLACING.intersection(paths.keys_of(entry.free.path))
        if not places or not _contacts_on_body(self.models[record].start).size:
            return
        for k in range(entry.where.start, entry.where.stop):
            z = self.start.copy()
            z[k] += _ASIDE * self.scale[k]
            if np.isnan(_contacts_on_body(self.model(record, z).start)).any():
                field, value = f"Free({entry.free.path!r})", entry.transform.reference
                problem = (
                    "cannot change alone: no point of the body has the normal that its "
                    "contact would need"
                )
                remedy = (
                    "hold it; or free start.contact_on_body, too, and no orientation: "
                    "the body then turns to fit its contact"
                )
                raise FieldError(field, value, problem, remedy)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lower and upper bounds, and sizes, of all coordinates."""
        return self.lower, self.upper, self.scale

    @property
    def size(self) -> int:
        """Number P of coordinates."""
        return self.start.size

    def of_record(self, record: int) -> tuple[Slots, np.ndarray]:
        """Parameters that a record depends on, and which coordinates are theirs."""
        slots: list[Slot] = []
        where: list[int] = []
        for entry in self.entries:
            owns = record in _owners(self.models, entry.free.path)
            if owns and entry.record in (None, record):
                keys = located(entry.free.path, self.models[record].channels)
                size = entry.where.stop - entry.where.start
                place = entry.free.path, keys, entry.transform, len(where), size
                slots.append(Slot(*place))
                where += range(entry.where.start, entry.where.stop)
        channels = self.models[record].channels
        tied = [
            (t.path, located(t.path, channels), t.value)
            for t in self.tied
            if record in _owners(self.models, t.path)
        ]
        return Slots(tuple(slots), tuple(tied)), np.array(where, int)

    def model(self, record: int, z: np.ndarray) -> Model:
        """A record's model at coordinates z of the fit."""
        slots, where = self.of_record(record)
        return _applied(slots, self.models[record], z[where])

    def by_path(self, of: Callable[[Coordinates], np.ndarray]) -> dict[str, np.ndarray]:
        """Something of every parameter; of several records' own ones, stacked."""
        found: dict[str, list[np.ndarray]] = {}
        for entry in self.entries:
            found.setdefault(entry.free.path, []).append(of(entry))
        own = {e.free.path for e in self.entries if e.record is not None}
        return {p: np.stack(v) if p in own else v[0] for p, v in found.items()}


def _contacts_on_body(start: Any) -> np.ndarray:
    """Contact coordinates on the body, and on those that roll on it."""
    inner = [_contacts_on_body(own) for own in start.supported]
    return np.concatenate([np.asarray(start.contact_on_body), *inner])


@for_one_call
def _applied(slots: Slots, model: Model, z: Float[Array, " P"]) -> Model:
    return slots.applied(model, jnp.asarray(z))


def _owners(models: Sequence[Model], path: str) -> list[int]:
    """Records that have a parameter: a channel's only those with the channel."""
    root = paths.keys_of(path)[0]
    with_channel = [k for k, m in enumerate(models) if root in m.channels]
    return with_channel or list(range(len(models)))


def _check_apart(models: Sequence[Model], free: Sequence[Free | Tied]) -> None:
    """Refuse parameters of which one is another, or a part of it."""
    channels = {name: None for model in models for name in model.channels}
    known: list[tuple[str, paths.Keys]] = []
    for one in free:
        keys = _plain_keys(models[0], one.path, channels)
        for other, others in known:
            if _overlap(keys, others):
                problem = "is there twice" if keys == others else f"overlaps {other!r}"
                raise FieldError("Free.path", one.path, problem, "name it once")
        known.append((one.path, keys))


def share_numbers(model: Model, path: str, other: str) -> bool:
    """Whether of two paths one leads to the other's numbers, or to some of them."""
    both = (_plain_keys(model, one, model.channels) for one in (path, other))
    return _overlap(*both)


def _plain_keys(model: Model, path: str, channels: Mapping[str, Any]) -> paths.Keys:
    root, *keys = located(path, channels)
    return root, *paths.plain(getattr(model, str(root)), tuple(keys))


def _overlap(keys: paths.Keys, others: paths.Keys) -> bool:
    shorter = min(len(keys), len(others))
    return keys[:shorter] == others[:shorter]


def _array_at(model: Model, path: str) -> tuple[paths.Keys, Any]:
    """Keys and number of a path."""
    keys = located(path, model.channels)
    try:
        value = number_in(model, keys)
    except LookupError:
        value = None
    read = keys[0] == "channels" and keys[2:3] in (("values",), ("sigma",))
    if read or not paths.is_floating(value):
        raise paths.unknown(path, known_paths(model))
    if is_clock(model, keys):
        problem = "is the clock of the base's record, which is read and not found"
        remedy = "free another field of it, or the delay of a channel"
        raise FieldError("Free.path", path, problem, remedy)
    return keys, value


def known_paths(model: Model) -> list[str]:
    """Paths of all numbers that can be free."""
    parts = [
        path
        for path in paths.floats(model.scene)
        if not is_clock(model, ("scene", *paths.keys_of(path)))
    ]
    parts += paths.floats(model.start, "start")
    if model.modes is not None:
        parts += paths.floats(model.modes, "modes")
    for name, channel in model.channels.items():
        held = paths.floats(channel, name)
        parts += [p for p in held if not p.endswith((".values", ".sigma"))]
    return parts


def _check_prior(free: Free, value: Array, positive: bool) -> None:
    if free.prior is None:
        return
    field, remedy = f"Free({free.path!r}).prior", "give (mean, standard deviation)"
    try:
        mean, deviation = free.prior
        middle = np.broadcast_to(np.asarray(mean, float), np.shape(value))
        known = np.broadcast_to(np.asarray(deviation, float), np.shape(value))
    except (TypeError, ValueError) as error:
        raise FieldError(field, free.prior, "does not fit", remedy) from error
    if not np.isfinite(middle).all():
        raise FieldError(field, free.prior, "must have a finite mean", remedy)
    if not np.all((known > 0.0) & (known < np.inf)):
        raise FieldError(field, free.prior, "must have a positive deviation", remedy)
    if positive and np.any(middle + _FAR * known <= 0.0):
        problem = "says that a number is negative, which only can be positive"
        raise FieldError(field, free.prior, problem, remedy)
