"""A study: what is random, what moves, and what is looked at."""

import re
from collections.abc import Callable, Mapping
from typing import Any, cast

import diffrax as dfx
import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.events import known_event
from ..hybrid.modes import Modes
from ..integration.backends import METHODS
from ..integration.diffrax_checks import check_kinds
from ..integration.integrate import checked_times
from ..validation.checks import FieldError, flag
from ..validation.codes import Code
from .distributions import AbstractDistribution
from .draws import Draws
from .made_members import Make

Observable = Callable[[Any, Any, Any], Any]
_CODES = {name: value for name, value in vars(Code).items() if isinstance(value, int)}
# names of what is kept of every member
RESERVED = ("code", "fault", "final_time", "steps", "checksum", "member", "time")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_ -]*")


class Study:
    """Motions of random scenes and starts, and what is wanted to know of them.

    Attributes:
        make: ``make(draw)`` -> (scene, start), or (scene, start, modes) where numbers
            of the modes (friction, restitution) are drawn, too; of one draw, by
            jax.numpy operations. ``draw`` has an array for each distribution, by its
            name.
        draws: The distributions.
        times: Output times [s], shape (T,).
        observe: By name: ``function(scene, t, state)`` -> numbers or truth values, of
            where a motion ended: at the last time, or at an event that stops it.
        series: By name, the like at every output time.
        events: Events that are counted; their first times are kept.
        stop: Events that end a motion.
        modes: How motions may change between rolling, slipping and flight, the same
            for all members; None where ``make`` gives them, or nothing changes.
        ends: Codes, besides success and an event that stops, with which a motion has
            ended as it should: what is observed there counts.
        options: ``rtol``, ``atol``, ``solver``, ``max_steps``, ``method``, and
            ``second_contact`` where it is looked for, as :func:`rollkane.ensemble`
            takes them.
    """

    def __init__(
        self,
        make: Make,
        distributions: Mapping[str, AbstractDistribution],
        times: ArrayLike,
        observe: Mapping[str, Observable] | None = None,
        *,
        series: Mapping[str, Observable] | None = None,
        events: Any = (),
        stop: Any = None,
        modes: Modes | None = None,
        ends: tuple[int, ...] = (),
        rtol: float | None = None,
        atol: float | None = None,
        solver: dfx.AbstractSolver[Any] | None = None,
        max_steps: int | None = None,
        method: str = "auto",
        second_contact: bool = False,
    ):
        """Describe a study; nothing is computed yet.

        Raises:
            FieldError: no function, no distribution, nothing to look at, a name that
                cannot be one, no modes, times out of order, an unknown code.
        """
        if not callable(make):
            remedy = "give a function of the draw that returns (scene, start)"
            raise FieldError("Study.make", make, "must be a function", remedy)
        self.make = make
        self.draws = Draws(distributions)
        self.times = np.asarray(checked_times(times, np.dtype(float)))
        self.observe = _functions("observe", observe)
        self.series = _functions("series", series)
        self.events, self.stop = _events("events", events), _events("stop", stop)
        if not isinstance(cast(Any, modes), Modes | None):
            problem = "must be Modes, the same for all members"
            remedy = (
                "give Modes(...) of known numbers; where they are drawn let make "
                "return (scene, start, modes)"
            )
            raise FieldError("Study.modes", modes, problem, remedy)
        self.modes = modes
        self.ends = _ends(ends)
        if method not in METHODS:
            remedy = f"use one of {METHODS}"
            raise FieldError("Study.method", method, "is not known", remedy)
        check_kinds("Study", solver=solver)
        self.options: dict[str, Any] = {
            "rtol": rtol,
            "atol": atol,
            "solver": solver,
            "max_steps": max_steps,
            "method": method,
        }
        if flag("Study.second_contact", second_contact):
            self.options["second_contact"] = True
        _check_names(self)

    @property
    def event_names(self) -> tuple[str, ...]:
        """Of the events, in order."""
        every = (*self.events, *self.stop)
        return tuple(event.name or f"event {i}" for i, event in enumerate(every))


def _functions(field: str, given: Any) -> dict[str, Observable]:
    if given is None:
        return {}
    remedy = 'give for example {"end": lambda scene, t, state: ...}'
    if not isinstance(given, Mapping):
        raise FieldError(f"Study.{field}", given, "must give functions names", remedy)
    found = dict(cast("Mapping[str, Any]", given))
    for name, function in found.items():
        if not callable(function):
            where = f"Study.{field}[{name!r}]"
            raise FieldError(where, function, "must be a function", remedy)
    return found


def _events(field: str, given: Any) -> tuple[Any, ...]:
    if given is None:
        return ()
    several = isinstance(given, (tuple, list))
    each = list(cast("tuple[Any, ...]", given)) if several else [given]
    return tuple(known_event(f"Study.{field}", one) for one in each)


def _event_fields(study: Study) -> list[str]:
    """Where each event of ``event_names`` was given, for errors."""
    given = {"events": study.events, "stop": study.stop}
    return [f"Study.{name}[{i}]" for name, x in given.items() for i in range(len(x))]


def _ends(given: Any) -> tuple[int, ...]:
    for code in given:
        if code not in _CODES.values():
            remedy = "use values of rollkane.Code, such as Code.SURFACE_EDGE"
            raise FieldError("Study.ends", code, "is no code", remedy)
    return (Code.COMPLETED, Code.STOPPED, *map(int, given))


def _check_names(study: Study) -> None:
    """Refuse what is no name, or names two things."""
    names = [
        *((f"Study.observe[{name!r}]", name) for name in study.observe),
        *((f"Study.series[{name!r}]", name) for name in study.series),
        *zip(_event_fields(study), study.event_names, strict=True),
    ]
    owners: dict[str, str] = {}
    for where, name in names:
        if not isinstance(cast(object, name), str) or not _NAME.fullmatch(name):
            remedy = "use letters, digits, blanks, - and _, a letter first"
            raise FieldError(where, name, "is no name", remedy)
        if name in RESERVED:
            remedy = "take another; it is that of something kept of every member"
            raise FieldError(where, name, "is taken", remedy)
        if name in owners:
            problem = f"is called as {owners[name]} is"
            remedy = (
                "give each its own name; an event without one, Event(..., name=...), "
                "takes that of its function"
            )
            raise FieldError(where, name, problem, remedy)
        owners[name] = where
    for event in study.event_names:
        for kept in (f"{event} time", f"{event} count"):
            if kept in owners:
                problem = f"is called as what is kept of the event {event!r}"
                raise FieldError(owners[kept], kept, problem, "give it another name")
    if not names:
        remedy = "give observe=, series= or events="
        raise FieldError("Study.observe", None, "leaves nothing to look at", remedy)
