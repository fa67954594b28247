"""What a run is refused for: a law, a start or times that do not fit its scene."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..dynamics.abstract_supported import (
    AbstractRollingPart,
    refuse_rolling_parts,
    rolling_parts,
)
from ..dynamics.clearance import nearest_is_found
from ..dynamics.equations import refuse_feedback
from ..dynamics.rolling_problem import has_margin
from ..dynamics.scene import Rolling, Scene
from ..hybrid.modes import HybridState, ModedState, Modes
from ..kinematics.coordinates import FlyingState, SlidingState, State
from ..kinematics.voronets import VoronetsState
from ..validation.checks import FieldError, is_traced
from ..validation.remembered import remembered


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


class _Form(NamedTuple):
    """What a start of a scene has to be.

    Attributes:
        slips: Whether its contact does.
        pole_free: Shapes of a ``State``'s fields.
        in_charts: Those of a ``VoronetsState``'s.
        bodies: What rolls on the body, each with a state of its own.
    """

    slips: bool
    pole_free: dict[str, tuple[int, ...]]
    in_charts: dict[str, tuple[int, ...]]
    bodies: list[AbstractRollingPart]


@remembered(lambda scene: True)  # shapes do not change, and take 10 us to find
def _form_of(scene: Scene) -> _Form:
    body, base = scene.body.surface, scene.base.surface
    carried = body.coordinate_count if scene.has_contact_coordinates else 0
    count = (scene.coordinate_count,)
    both = {"angular_velocity": (3,), "alpha": count, "alpha_dot": count}
    pole_free = {
        "orientation": (4,),
        "contact_on_base": (base.coordinate_count,),
        "contact_on_body": (carried,),
    }
    in_charts = {"contact_on_base": (2,), "contact_on_body": (2,), "angle": ()}
    bodies = rolling_parts(scene.supported)
    return _Form(scene.contact.slips, both | pole_free, both | in_charts, bodies)


def _check_one_mode(where: str, start: object) -> None:
    """Refuse a state that could be in any mode: of them it would be in contact."""
    if isinstance(start, (HybridState, ModedState)):
        remedy = "give final_state.in_its_mode to go on from a run with modes"
        kind = "is a state of all modes at once"
        raise FieldError(where, type(start).__name__, kind, remedy)


def check_start(scene: Scene, start: object, where: str = "simulate.start") -> None:
    """Refuse a start that does not belong to the scene."""
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
    form = _form_of(scene)
    if form.slips != type(start).slips:
        raise FieldError(
            where,
            start,
            f"is no state of a body that {'slips' if form.slips else 'rolls'}",
            "place the body in this scene",
        )
    charts = isinstance(start, VoronetsState)
    own = vars(start)  # in a fifth of the time of as many attributes
    for field, wanted in (form.in_charts if charts else form.pole_free).items():
        shape = own[field].shape
        if shape != wanted:
            raise FieldError(
                f"{where}.{field}",
                shape,
                f"must have shape {wanted} in this scene",
                "place the body in this scene (a batch of starts needs jax.vmap)",
            )
    bodies = form.bodies
    supported = own.get("supported", ())
    if len(bodies) != len(supported):
        raise FieldError(
            f"{where}.supported",
            f"{len(supported)} states",
            f"must have one for each RollingBody of the scene, {len(bodies)}",
            "place the body with supported=, in pole-free coordinates",
        )
    for k, (part, state) in enumerate(zip(bodies, supported, strict=True)):
        check_start(part.scene, state, f"{where}.supported[{k}]")


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
