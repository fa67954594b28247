"""What a run is refused for: a law, a start or times that do not fit its scene."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..dynamics.abstract_supported import refuse_rolling_parts
from ..dynamics.clearance import nearest_is_found
from ..dynamics.equations import refuse_feedback
from ..dynamics.rolling_problem import has_margin
from ..dynamics.scene import Rolling, Scene, require_scene
from ..dynamics.state_forms import check_form
from ..hybrid.modes import HybridState, ModedState, Modes
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
    remedy = "give the Scene first, then the start"
    if isinstance(start, Scene):
        remedy = f"scene and start are swapped: call {function}(scene, start, ...)"
    require_scene(f"{function}.scene", scene, remedy)


def check_law(scene: Scene, formulation: str, coordinates: str) -> None:
    """The paper's equations and coordinates are those of rolling alone."""
    for field, value, general in (
        ("simulate.formulation", formulation, "rolling"),
        ("simulate.coordinates", coordinates, "pole-free"),
    ):
        if value == general:
            continue
        if type(scene.contact) is not Rolling or has_margin(scene):
            raise FieldError(
                field,
                value,
                "has rolling without slipping only, and no dry resistance",
                f'use "{general}", or Rolling() without dry resistance',
            )
        refuse_rolling_parts(field, scene.supported)
        refuse_feedback(field, scene)


def check_modes(scene: Scene, start: object, modes: object) -> None:
    """Refuse modes, or a start, that no run through changes can have."""
    refuse_rolling_parts("simulate.modes", scene.supported)
    if not isinstance(modes, Modes):
        raise FieldError("simulate.modes", modes, "must be Modes", "give Modes(...)")
    shapes = [jnp.shape(x) for x in jax.tree.leaves(modes)]
    if any(shapes):
        problem = "has an axis of members, as jax.vmap gives it"
        remedy = "run them by rollkane.ensemble, or map simulate by jax.vmap"
        raise FieldError("simulate.modes", max(shapes), problem, remedy)
    _check_one_mode("simulate.start", start)
    known = State, SlidingState, FlyingState
    if not isinstance(start, known):
        remedy = "make it with rollkane.place or rollkane.release"
        raise FieldError("simulate.start", start, "must be a State", remedy)
    if isinstance(start, SlidingState) and modes.friction is None:
        raise FieldError(
            "Modes.friction", None, "is missing for a start that slips", "give it"
        )
    if modes.restitution is not None and not nearest_is_found(scene):
        raise FieldError(
            "Modes.restitution",
            type(scene.body.surface).__name__,
            f"cannot land on a {type(scene.base.surface).__name__}: of several places "
            "that may touch, the nearest is not found",
            "leave restitution out; for an edge, give a thin Torus",
        )


def _check_one_mode(where: str, start: object) -> None:
    """Refuse a state that could be in any mode: of them it would be in contact."""
    if isinstance(start, (HybridState, ModedState)):
        remedy = "give final_state.in_its_mode to go on from a run with modes"
        kind = "is a state of all modes at once"
        raise FieldError(where, type(start).__name__, kind, remedy)


def check_start(scene: Scene, start: object) -> None:
    """Refuse a start that does not belong to the scene."""
    where = "simulate.start"
    _check_one_mode(where, start)
    if not isinstance(start, (State, VoronetsState)):
        remedy = "make it with rollkane.place"
        if isinstance(start, list):
            remedy += "; several starts are rollkane.ensemble's"
        raise FieldError(where, start, "must be a State", remedy)
    if isinstance(start, FlyingState) and scene.contact.touches:
        problem = "is in flight, and a contact law holds a body that touches its base"
        remedy = "give modes=rollkane.Modes(restitution=...), or place the body"
        raise FieldError(where, start, problem, remedy)
    check_form(scene, start, where, "place the body in this scene")


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
            f"must stay within the record of Base.motion, which is known from "
            f"{first:g} to {last:g} s",
            "end there, or add samples (of zero, for a base that coasts on)",
        )
