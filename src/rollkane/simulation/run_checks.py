"""What a run is refused for: a law, a start or times that do not fit its scene."""

from typing import Any

import numpy as np

from ..dynamics.abstract_supported import refuse_rolling_parts, rolling_parts
from ..dynamics.equations import refuse_feedback
from ..dynamics.rolling_problem import has_margin
from ..dynamics.scene import Rolling, Scene
from ..hybrid.modes import Modes
from ..kinematics.coordinates import FlyingState, SlidingState, State
from ..kinematics.voronets import VoronetsState
from ..validation.checks import FieldError, is_traced


def check_scene(function: str, scene: object, start: object) -> None:
    """Refuse what is no scene, and say so where scene and start are swapped.

    Args:
        function: Whose first two arguments they are, for the error.
        scene: The first.
        start: The second.
    """
    if isinstance(scene, Scene):
        return
    remedy = "give the Scene first, then the start"
    if isinstance(start, Scene):
        remedy = f"scene and start are swapped: call {function}(scene, start, ...)"
    kind = f"must be a Scene, not a {type(scene).__name__}"
    raise FieldError(f"{function}.scene", scene, kind, remedy)


def check_law(scene: Scene, formulation: str, coordinates: str) -> None:
    """The paper's equations and coordinates are those of rolling alone."""
    alone = type(scene.contact) is Rolling and not has_margin(scene)
    for field, value, general in (
        ("simulate.formulation", formulation, "rolling"),
        ("simulate.coordinates", coordinates, "pole-free"),
    ):
        if value != general and not alone:
            raise FieldError(
                field,
                value,
                "has rolling without slipping only, and no dry resistance",
                f'use "{general}", or Rolling() without dry resistance',
            )
        if value != general:
            refuse_rolling_parts(field, scene.supported)
            refuse_feedback(field, scene)


def check_modes(scene: Scene, start: object, modes: object) -> None:
    """Refuse modes, or a start, that no run through changes can have."""
    refuse_rolling_parts("simulate.modes", scene.supported)
    if not isinstance(modes, Modes):
        raise FieldError("simulate.modes", modes, "must be Modes", "give Modes(...)")
    known = State, SlidingState, FlyingState
    if not isinstance(start, known):
        remedy = "make it with rollkane.place or rollkane.release"
        raise FieldError("simulate.start", start, "must be a State", remedy)
    if isinstance(start, SlidingState) and modes.friction is None:
        raise FieldError(
            "Modes.friction", None, "is missing for a start that slips", "give it"
        )


def check_start(scene: Scene, start: object, where: str = "simulate.start") -> None:
    """Refuse a start that does not belong to the scene."""
    if not isinstance(start, (State, VoronetsState)):
        remedy = "make it with rollkane.place"
        if isinstance(start, list):
            remedy += "; several starts are rollkane.ensemble's"
        raise FieldError(where, start, "must be a State", remedy)
    slips = scene.contact.slips
    if slips != start.slips:
        raise FieldError(
            where,
            start,
            f"is no state of a body that {'slips' if slips else 'rolls'}",
            "place the body in this scene",
        )
    body, base = scene.body.surface, scene.base.surface
    shapes: dict[str, tuple[int, ...]] = {
        "angular_velocity": (3,),
        "alpha": (scene.coordinate_count,),
        "alpha_dot": (scene.coordinate_count,),
    }
    if isinstance(start, VoronetsState):
        shapes |= {"contact_on_base": (2,), "contact_on_body": (2,), "angle": ()}
    else:
        carried = body.coordinate_count if scene.has_contact_coordinates else 0
        shapes |= {
            "orientation": (4,),
            "contact_on_base": (base.coordinate_count,),
            "contact_on_body": (carried,),
        }
    for field, wanted in shapes.items():
        shape = getattr(start, field).shape
        if shape != wanted:
            raise FieldError(
                f"{where}.{field}",
                shape,
                f"must have shape {wanted} in this scene",
                "place the body in this scene (a batch of starts needs jax.vmap)",
            )
    bodies = rolling_parts(scene.supported)
    if len(bodies) != len(start.supported):
        raise FieldError(
            f"{where}.supported",
            f"{len(start.supported)} states",
            f"must have one for each RollingBody of the scene, {len(bodies)}",
            "place the body with supported=, in pole-free coordinates",
        )
    for k, (part, own) in enumerate(zip(bodies, start.supported, strict=True)):
        check_start(part.scene, own, f"{where}.supported[{k}]")


def check_span(scene: Scene, times: Any) -> None:
    """Refuse times at which the base's motion is not known."""
    motion = scene.base.motion
    span = None if motion is None else motion.span
    if span is None or is_traced(times, span):
        return
    first, last = float(span[0]), float(span[1])
    slack = 1e-9 * (last - first)
    least, most = float(np.min(times)), float(np.max(times))
    if least < first - slack or most > last + slack:
        raise FieldError(
            "simulate.times",
            (least, most),
            f"leave the record of Base.motion, which is known from {first:g} to "
            f"{last:g} s",
            "stay within it, or add samples (of zero, for a base that coasts on)",
        )
