"""What a state of a scene has to be: shapes, slip, and what rolls on the body."""

from typing import Any, NamedTuple

from ..kinematics.coordinates import State
from ..kinematics.voronets import VoronetsState
from ..validation.checks import FieldError
from ..validation.remembered import remembered
from .abstract_supported import AbstractRollingPart, rolling_parts
from .scene import Scene


class _Form(NamedTuple):
    """What a state of a scene has to be.

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


def check_form(
    scene: Scene, state: State | VoronetsState, where: str, remedy: str
) -> None:
    """Refuse a state that does not belong to a scene, by its shapes.

    Args:
        scene: The scene.
        state: The state of a body that touches its base.
        where: Field of the state, for the error.
        remedy: How it is made in the scene.

    Raises:
        FieldError: another scene's.
    """
    form = _form_of(scene)
    if form.slips != type(state).slips:
        problem = f"is no state of a body that {'slips' if form.slips else 'rolls'}"
        raise FieldError(where, state, problem, remedy)
    charts = isinstance(state, VoronetsState)
    own = vars(state)  # in a fifth of the time of as many attributes
    for field, wanted in (form.in_charts if charts else form.pole_free).items():
        shape = own[field].shape
        if shape != wanted:
            raise FieldError(
                f"{where}.{field}",
                shape,
                f"must have shape {wanted} in this scene",
                f"{remedy} (a batch of starts needs jax.vmap)",
            )
    check_rolling(form.bodies, own.get("supported", ()), f"{where}.supported", remedy)


def check_rolling(
    bodies: list[AbstractRollingPart], states: Any, where: str, remedy: str
) -> None:
    """Refuse states that are not those of bodies that roll on a body.

    Args:
        bodies: What rolls on it.
        states: One each.
        where: Field of the states, for the error.
        remedy: How they are made.

    Raises:
        FieldError: another number of them, or those of other bodies.
    """
    if len(bodies) != len(states):
        problem = f"must have one for each RollingBody of the scene, {len(bodies)}"
        raise FieldError(where, f"{len(states)} states", problem, remedy)
    for k, (part, state) in enumerate(zip(bodies, states, strict=True)):
        if not isinstance(state, State) or not state.touches:
            problem = "must be a State of the RollingBody"
            raise FieldError(f"{where}[{k}]", state, problem, remedy)
        check_form(part.scene, state, f"{where}[{k}]", remedy)
