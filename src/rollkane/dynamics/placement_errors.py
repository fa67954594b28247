"""What can be wrong with a placement, and how it is said."""

import warnings
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array

from ..codegen.compile_effort import for_one_call
from ..kinematics.coordinates import State
from ..validation.checks import FieldError
from .rolling import press_and_pull
from .scene import Scene


class Placed(eqx.Module):
    """A state, and what is wrong with it; NaN in the state where anything is."""

    state: State
    wrong: dict[str, Array]  # truth values by what is wrong, a key of _WRONG
    nearest: Array  # point of the base next to the asked one [m], base axes
    overlap: Array | None  # how deep the body is in the base elsewhere [m]
    where: Array | None  # and where [m], base axes
    off: Array  # force of the loads' fields away from the base [m/s^2]


class _Wrong(NamedTuple):
    """A refusal: which argument, what is wrong with it, what to do."""

    field: str
    problem: str
    remedy: str


_SHAPE = "describe the surface without poles, for example with of_direction=True"
_WRONG = {
    "long": _Wrong(
        "orientation",
        "must be a quaternion of unit length",
        "divide it by its length; scalar first, body to fixed axes",
    ),
    "misses": _Wrong(
        "orientation",
        "the body cannot touch the base so: no single point of its surface has the "
        "normal that the contact needs",
        "turn the body, give near_on_body where many points have it, or (for a surface "
        "by your own function) widen its domain",
    ),
    "singular": _Wrong(
        "contact_on_base",
        "a surface or its chart is singular where they touch (a tip without a tangent "
        "plane, or the pole of a chart, where two coordinates count for one)",
        f"touch elsewhere, or {_SHAPE}",
    ),
    "off_base": _Wrong(
        "contact_on_base",
        "is off the base's surface, whose nearest point is {nearest}",
        "give a point of the surface [m], in base axes",
    ),
    "fits": _Wrong(
        "contact_on_base",
        "the surfaces fit each other here (relative curvature 0): they touch along a "
        "line or an area, and the contact point is not determined",
        "turn the body, move the contact, or change a radius",
    ),
    "cuts": _Wrong(
        "contact_on_base",
        "the body would cut into the base here, which bends towards the body more "
        "sharply than the body itself",
        "use a smaller body or a flatter base, or turn the inside of one round",
    ),
    "overlaps": _Wrong(
        "contact_on_base",
        "puts the body into the base elsewhere, {overlap:.3g} m deep at {where} (base "
        "axes, m)",
        "turn or move the body, or give allow_overlap=True where only the contact "
        "matters",
    ),
    "massless": _Wrong(
        "Scene.supported",
        "makes the mass matrix singular at this alpha: some motion of the coordinates "
        "moves no mass",
        "let every coordinate move a mass by itself, and start where it does",
    ),
    "leaves": _Wrong(
        "velocity",
        "would take the body off the base, or into it",
        "leave out its part along the normal",
    ),
}


def refuse_needless(scene: Scene, given: dict[str, Any]) -> None:
    """Refuse what the scene determines, or has no use for."""
    slips = scene.contact.slips
    for name in ("velocity", "slip"):
        if given[name] is not None and not slips:
            raise FieldError(
                f"place.{name}",
                given[name],
                "follows from the angular velocity where the body rolls",
                "leave it out, or give Scene(contact=Slipping(...))",
            )
    if given["velocity"] is not None and given["slip"] is not None:
        raise FieldError(
            "place.slip", given["slip"], "follows from velocity", "give one of both"
        )
    normal = given["base_normal"]
    if normal is not None and not scene.base.surface.is_edge:
        raise FieldError(
            "place.base_normal",
            normal,
            "follows from the contact point on this base",
            "leave it out: only a sharp edge has several normals at a point",
        )


def refuse_bad(placed: Placed, asked: dict[str, Any], given: dict[str, Any]) -> None:
    """Refuse a placement of known numbers that is wrong, and say why.

    Args:
        placed: The state, and what is wrong with it.
        asked: Arguments of ``place`` as arrays.
        given: The same as the user wrote them: rounding to float32 would show others.
    """
    for name, (field, problem, remedy) in _WRONG.items():
        if not bool(placed.wrong.get(name, False)):
            continue
        known = {"nearest": np.asarray(placed.nearest).tolist()}
        if placed.overlap is not None:
            known["overlap"] = float(placed.overlap)
            known["where"] = np.round(np.asarray(placed.where), 6).tolist()
        value = given.get(field, given["alpha"])
        field = field if field not in asked else f"place.{field}"
        raise FieldError(field, value, problem.format(**known), remedy)


def warn_of_pull(scene: Scene, placed: Placed, asked: dict[str, Any]) -> None:
    """Warn where the loads pull the body off its base, and nothing presses it on."""
    if not float(placed.off) > 0.0:
        return
    press = _press(scene, asked["time"][0], placed.state)
    if float(press) < 0.0:
        warnings.warn(
            "the loads pull the body off its base at this start, where the normal "
            f"force is {float(press):.3g} N: the outward side of a surface may be the "
            "wrong one (inside=True of a bowl, swapped parameters, the sign of an "
            "Implicit), or gravity may point up",
            stacklevel=3,
        )


@for_one_call
def _press(scene: Scene, time: Array, state: State) -> Array:
    return press_and_pull(scene, time, state)[0]
