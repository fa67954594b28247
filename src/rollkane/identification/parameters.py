"""Which numbers of a model are free, and which follow from them."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..dynamics.consistency import with_contact_found
from ..dynamics.scene import Scene
from ..hybrid.modes import Modes
from ..validation.checks import FieldError, flag
from . import paths
from .channels import AbstractChannel
from .inertia_transforms import FORMS
from .transforms import AbstractTransform

Bounds = tuple[ArrayLike | None, ArrayLike | None]
Values = dict[str, Array]

# On a path to what places a contact, of a start or of a scene (``on``: of a carrier).
PLACING = {"orientation", "contact_on_base", "surface", "motion", "on"}


def _is_pair(value: Any) -> bool:
    return isinstance(value, (tuple, list, np.ndarray)) and len(cast(Any, value)) == 2


@dataclasses.dataclass(frozen=True)
class Free:
    """A parameter that a fit may change, from the value that the model has.

    Masses, lengths and the like stay positive, inertias those of a density, quaternions
    of unit length: in every iterate, by the coordinates that they are varied in.

    Attributes:
        path: Of a number or an array of the scene (``"body.inertia"``,
            ``"body.surface.semi_axes"``, ``"loads[1].linear"``), of the start
            (``"start.angular_velocity"``), of the modes (``"modes.friction"``) or of a
            channel (``"gyro.bias"``, ``"gyro.delay"``).
        bounds: Least and largest value [unit of the parameter], numbers or arrays, None
            for none. Of a delay: 0, and 20 samples above the guess [s]; samples up to
            the largest one after the start are left out, as they might show the time
            before it. Give the least bound that is sure.
        prior: Mean and standard deviation of what was known before, numbers or arrays.
        form: ``"full"``; ``"diagonal"``: an inertia whose principal axes are the
            body's; ``"ratios"``, ``"diagonal ratios"``: an inertia whose trace stays,
            since motion without known forces does not show it; ``"scale"``: one factor,
            ratios stay; None: full.
        shared: Whether several records have one value of it; None: of all but the
            start.
    """

    path: str
    bounds: Bounds | None = None
    prior: tuple[ArrayLike, ArrayLike] | None = None
    form: str | None = None
    shared: bool | None = None

    def __post_init__(self) -> None:
        """Refuse what no parameter can be asked for by.

        Raises:
            FieldError: a path that is none, bounds or a prior that are no pair, an
                unknown form.
        """
        paths.keys_of(self.path)
        field = f"Free({self.path!r})"
        pairs = (
            ("bounds", self.bounds, "give (least, largest), None for none"),
            ("prior", self.prior, "give (mean, standard deviation)"),
        )
        for name, pair, remedy in pairs:
            if pair is not None and not _is_pair(pair):
                raise FieldError(f"{field}.{name}", pair, "must be a pair", remedy)
        if self.form is not None and self.form not in FORMS:
            remedy = f"use one of {FORMS}"
            raise FieldError(f"{field}.form", self.form, "is not known", remedy)
        if self.shared is not None:
            flag(f"{field}.shared", self.shared)


@dataclasses.dataclass(frozen=True)
class Tied:
    """A parameter that follows from the free ones.

    Attributes:
        path: As of :class:`Free`.
        value: ``value(values)`` -> the parameter [its unit]; values are the free ones
            by path.
    """

    path: str
    value: Callable[[Values], ArrayLike]

    def __post_init__(self) -> None:
        """Refuse what is no path, or no function.

        Raises:
            FieldError: either of them.
        """
        paths.keys_of(self.path)
        if not callable(self.value):
            field = f"Tied({self.path!r}).value"
            remedy = 'give a function, for example lambda values: values["body.mass"]'
            raise FieldError(field, self.value, "must be a function", remedy)


class Model(NamedTuple):
    """What a record is predicted from.

    Attributes:
        scene: What rolls on what.
        start: State in which it starts.
        time: When [s].
        modes: How the contact may change.
        channels: Of the record, by name.
    """

    scene: Scene
    start: Any
    time: Float[Array, ""]
    modes: Modes | None
    channels: dict[str, AbstractChannel]


def located(path: str, channels: Mapping[str, Any]) -> paths.Keys:
    """Keys of a path in a :class:`Model`."""
    keys = paths.keys_of(path)
    roots = {"scene": ("scene",), "start": ("start",), "modes": ("modes",)}
    roots |= {name: ("channels", name) for name in channels}
    if keys[0] in roots:
        return (*roots[str(keys[0])], *keys[1:])
    return ("scene", *keys)


def number_in(model: Model, keys: paths.Keys) -> Any:
    """What a model has at keys."""
    return paths.found(getattr(model, str(keys[0])), keys[1:])


def with_numbers(model: Model, numbers: Iterable[tuple[paths.Keys, Any]]) -> Model:
    """The model with other numbers at keys: arrays of their shape, or one for all.

    Of the start the orientation and the contact on the base are as they are given, and
    the contact on the body is where these, and the surfaces, have it: a run turns a
    body that does not fit its contacts. That is left to it where the contact on the
    body is among the numbers, and no orientation is.
    """
    names: set[str | int] = set()
    for keys, value in numbers:
        root, old = str(keys[0]), number_in(model, keys)
        new = jnp.broadcast_to(jnp.asarray(value, old.dtype), old.shape)
        changed = paths.replaced(getattr(model, root), keys[1:], new)
        model = model._replace(**{root: changed})
        names.update(keys)
    by_body = "contact_on_body" in names and "orientation" not in names
    if by_body or not names & PLACING:
        return model
    start = with_contact_found(model.scene, model.time, model.start)
    return model._replace(start=start)


class Slot(eqx.Module):
    """One free parameter, in coordinates.

    Attributes:
        path: As the user wrote it.
        keys: Where it is in a :class:`Model`.
        transform: Its coordinates.
        first: Its first coordinate among those of its record.
        size: How many it has.
    """

    path: str = eqx.field(static=True)
    keys: paths.Keys = eqx.field(static=True)
    transform: AbstractTransform
    first: int = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def value(self, z: Float[Array, " P"]) -> Array:
        """The parameter at coordinates z of all."""
        return self.transform.value(z[self.first : self.first + self.size])


class Slots(eqx.Module):
    """All parameters that one record depends on.

    Attributes:
        free: Free ones.
        tied: Keys and functions of those that follow.
    """

    free: tuple[Slot, ...]
    tied: tuple[tuple[str, paths.Keys, Callable[[Values], ArrayLike]], ...] = eqx.field(
        static=True
    )

    def values(self, z: Float[Array, " P"]) -> Values:
        """Free parameters by path."""
        return {slot.path: slot.value(z) for slot in self.free}

    def applied(self, model: Model, z: Float[Array, " P"]) -> Model:
        """The model with the parameters at coordinates z."""
        values = self.values(z)
        free = [(slot.keys, values[slot.path]) for slot in self.free]
        tied = [(keys, function(values)) for _, keys, function in self.tied]
        return with_numbers(model, free + tied)
