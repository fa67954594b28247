"""From checked tables to a scene and its start, with every refusal put in its place.

Each part is made by its own constructor. What a constructor refuses is noted at the
field of the file, a stand-in takes that field's place, and the constructor is asked
again, so that all bad fields of all parts are known at once.
"""

import functools
from collections.abc import Callable
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from ...dynamics.bodies import Body
from ...dynamics.placement import place
from ...dynamics.scene import Base, Scene, Slipping, under
from ...geometry.numpy_rotations import rotated
from ...geometry.surfaces import Sphere
from ...hybrid.modes import Modes
from ...integration.integrate import LOOSEST
from ...kinematics.coordinates import State
from ...validation.checks import FieldError
from .construction import attempt, product_of_turns, usable
from .load_building import contact_of, loads_of, modes_of
from .motion_building import motion_of, supported_of
from .problems import Report
from .rolling_building import rolling_of
from .surface_building import body_of, surface_of
from .tables import StartTable

_UNTURNED = (1.0, 0.0, 0.0, 0.0)


def build(
    report: Report, parts: dict[Any, Any] | None = None
) -> tuple[Scene, State, Modes | None] | None:
    """Make what a file describes, and note what the library refuses.

    Args:
        report: Knows the file, its checked tables and what is wrong with it.
        parts: Bases, supported masses and rolling bodies of earlier readings of the
            same file.

    Returns:
        The scene, its start and its modes, or None where something was wrong.
    """
    body = body_of(("body",), report)
    kept = {} if parts is None else parts
    base = _taken_again("base", lambda: _base(report), report, kept)
    loads, law = loads_of(report), contact_of(report)
    modes = modes_of(report)
    supported = _taken_again("supported", lambda: supported_of(report), report, kept)
    rolling = _taken_again("rolling", lambda: rolling_of(report), report, kept)
    _check_tolerance(report)
    scene, states = None, ()
    found = base is not None and loads is not None and law is not None
    if body is not None and supported is not None and found and rolling is not None:
        rolled, states = rolling
        scene = Scene(body, base, (*supported, *rolled), loads, law)
    start = _start(scene, states, report)
    if scene is None or start is None:
        return None
    return scene, start, modes


def _taken_again(
    name: str, made: Callable[[], Any], report: Report, kept: dict[Any, Any]
) -> Any:
    """A part by its table, or the one that was made of the same table before."""
    key = name, repr(report.document.get(name)), str(jnp.result_type(float))
    if key not in kept:
        part = made()
        if part is None or report.has_below((name,)):
            return part
        kept[key] = part
    return kept[key]


def _base(report: Report) -> Base | None:
    if "base" not in report.document:
        return Base()
    surface = surface_of(("base", "surface"), report)
    motion = motion_of(report)
    return (
        None
        if report.has_below(("base",)) or surface is None
        else Base(surface, motion)
    )


def _check_tolerance(report: Report) -> None:
    run = report.document.get("run")
    if not isinstance(run, dict) or "rtol" not in run:
        return
    dtype = jnp.result_type(float)
    least = 10 * float(cast(float, jnp.finfo(dtype).eps))
    if report.has_below(("run", "rtol")):
        return
    if run["rtol"] < least:
        problem = f"is below what {dtype} can hold"
        report.add(("run", "rtol"), problem, f"give {least:.1g} or more")
    elif run["rtol"] > LOOSEST:
        problem = f"is above {LOOSEST:g}: it leaves no digit of the motion right"
        report.add(("run", "rtol"), problem, "give 1e-9 for instance")


def _start(
    scene: Scene | None, rolling: tuple[State, ...], report: Report
) -> State | None:
    if not isinstance(report.document.get("start"), dict):
        return None
    given = usable(("start",), StartTable.model_fields, report)
    if "rotations" in given:
        orientation = product_of_turns(given["rotations"])
    else:
        orientation = given.get("orientation", _UNTURNED)
    velocity = given.get("angular_velocity", (0.0, 0.0, 0.0))
    if "angular_velocity_body" in given:
        velocity = rotated(orientation, given["angular_velocity_body"])
    arguments = {
        "orientation": orientation,
        "angular_velocity": velocity,
        "contact_on_base": given.get("contact_on_base", (0.0, 0.0, 0.0)),
        "base_normal": given.get("base_normal"),
        "near_on_body": given.get("near_on_body"),
        "allow_overlap": given.get("allow_overlap", False),
        "supported": rolling,
    }
    still = np.zeros(0 if scene is None else scene.coordinate_count)
    arguments |= {name: given.get(name, still) for name in ("alpha", "alpha_dot")}
    where = None if report.has_below(("start",)) else scene
    if "slip" in given:
        arguments["slip"] = given["slip"]
        if where is not None and "modes" in report.document:
            where = under(where, Slipping())  # until it grips
    if where is None:  # some part is missing: judge at least what needs no scene
        where = Scene(Body(1.0, np.eye(3), Sphere(1.0)))
        scene = None
        arguments |= {"contact_on_base": (0.0, 0.0, 0.0), "base_normal": None}
        arguments |= {"near_on_body": None, "allow_overlap": True}
        arguments |= {"alpha": (), "alpha_dot": (), "slip": None, "supported": ()}

    def note(name: str, error: FieldError) -> None:
        if error.field == "Scene.supported":
            report.add(("supported",), error.problem, error.remedy)
            return
        # a refusal by the base's surface itself is one of the contact point
        field = name if name in arguments else "contact_on_base"
        if field == "orientation" and "rotations" in given:
            field = "rotations"
        report.add(("start", field), error.problem, error.remedy)

    start = attempt(
        functools.partial(place, where),
        arguments,
        note,
        {"orientation": _unit(orientation), "alpha": still, "alpha_dot": still},
    )
    return None if scene is None else start


def _unit(quaternion: Any) -> np.ndarray:
    length = float(np.linalg.norm(quaternion))
    if length == 0.0:
        return np.array(_UNTURNED)
    return np.asarray(quaternion) / length
