"""An ensemble as a labelled data set over members and time.

Needs the extra ``rollkane[results]`` (xarray).
"""

from typing import TYPE_CHECKING

import numpy as np

from ..simulation.ensemble_result import Ensemble
from ..validation.checks import FieldError, is_traced
from ..validation.codes import NO_FAULT, reason_of
from .export import BASE_AXIS, COORDINATES, QUANTITIES, heading, imported, labels
from .export import quantities as quantities_of
from .export_events import Variable, event_variables, variable_of

if TYPE_CHECKING:
    import xarray

_Variables = dict[str, Variable]

_MEMBER = ("member",)
_BOTH = ("member", "time")
_ENDS = {
    "code": ("why the motion ended, as rollkane.Code counts", ""),
    "final_time": ("time that was reached", "s"),
    "steps": ("accepted steps", "1"),
    "rejected_steps": ("rejected steps", "1"),
    "fault": ("number of the field that cannot be used, -1: none", ""),
}
_OWN_COORDINATES = {*COORDINATES, *BASE_AXIS, *_BOTH}
_AT_END = "position", "orientation", "angular_velocity"


def ensemble_to_xarray(ensemble: Ensemble) -> "xarray.Dataset":
    """An ensemble with names, units and axes; NetCDF can hold it.

    Args:
        ensemble: What came out, or a block of it.

    Returns:
        Over ``member`` (its number) and ``time`` [s] the variables that
        :func:`rollkane.files.export.to_xarray` names, where states were kept, and what
        was observed, by the names of its tree (``observed`` where it is one array).
        Over ``member``: ``code``, ``reason`` (in words; its attribute ``explained``
        says more), ``final_time`` [s], ``steps``, ``rejected_steps``, ``fault``;
        ``final_position`` [m], ``final_orientation`` [1], ``final_angular_velocity``
        [rad/s]. Of each event ``NAME_count``, and ``NAME_time`` [s] over
        ``NAME_crossing``. What was not reached is NaN.

    Raises:
        ImportError: xarray is not installed.
        FieldError: the ensemble is traced, or has a batch of ensembles; an event has
            a name such as "final", whose ``final_time`` is there already, or what was
            observed has two of one name.
    """
    xarray = imported("xarray")
    if is_traced(ensemble) or np.ndim(ensemble.code) != 1:
        raise FieldError(
            "Ensemble",
            np.shape(ensemble.code),
            "is traced, or is a batch of ensembles",
            "take one with known numbers",
        )
    scene = ensemble.scene
    variables: _Variables = {}
    if ensemble.state is not None:
        variables |= quantities_of(ensemble, scene, _BOTH)
    variables |= _ends(ensemble)
    taken = {*variables, *_OWN_COORDINATES}
    variables |= event_variables(ensemble.events, _MEMBER, taken)
    for name, value in ensemble.observed_by_name.items():
        name = variable_of(name)
        if name in variables or name in _OWN_COORDINATES:
            name = f"observed_{name}"
        if name in variables:
            problem, remedy = "would be there twice in a data set", "give another name"
            raise FieldError("ensemble.observe", name, problem, remedy)
        own = tuple(f"{name}_{k}" for k in range(value.ndim - 2))
        variables[name] = ((*_BOTH, *own), value, {"long_name": f"observed: {name}"})
    coordinates = COORDINATES | {
        "member": (_MEMBER, ensemble.members, {"long_name": "number of the member"}),
        "time": (
            ("time",),
            np.asarray(ensemble.time),
            {"long_name": "time", "units": "s"},
        ),
    }
    if scene.base.motion is not None and ensemble.state is not None:
        coordinates |= BASE_AXIS
    attributes = heading(scene) | {"method": ensemble.method}
    return xarray.Dataset(variables, coordinates, attributes)


def _ends(ensemble: Ensemble) -> _Variables:
    """How each member ended, and where."""
    found: _Variables = {}
    for name, (long_name, units) in _ENDS.items():
        value = np.asarray(getattr(ensemble, name))
        found[name] = _MEMBER, value, labels(long_name, units, "")
    outcomes = ensemble.outcomes
    about = labels("why the motion ended", "", "") | {"explained": _explained(ensemble)}
    found["reason"] = _MEMBER, outcomes, about
    final = ensemble.final
    for name in _AT_END:
        behind, long_name, units, axes = QUANTITIES[name]
        value, about = getattr(final, name), f"{long_name}, at the member's end"
        found[f"final_{name}"] = (*_MEMBER, *behind), value, labels(about, units, axes)
    return found


def _explained(ensemble: Ensemble) -> str:
    """A line for each reason that is there, with what to do about it."""
    names, first = np.unique(ensemble.outcomes, return_index=True)
    code, fault = np.asarray(ensemble.code), np.asarray(ensemble.fault)
    lines: list[str] = []
    for name, i in zip(names.tolist(), first.tolist(), strict=True):
        known = int(fault[i]) == NO_FAULT
        more = (
            reason_of(code[i]) if known else ensemble.fields.reason(code[i], fault[i])
        )
        lines.append(f"{name}: {more}")
    return "\n".join(lines)
