"""The tables of a scene file: names, types, shapes and units of all its fields.

Types are strict: text and truth values are no numbers, whole numbers are. What no
single field can tell (a sign, a triangle inequality, a contact) is left to the
constructors of the library, which say it in the same words everywhere.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ..scene_file_limits import MOST_OUTPUTS, MOST_PARTS
from .derived_tables import OneOf, table_of
from .load_tables import CONTACTS, LOADS, ModesTable
from .moving_tables import MOTIONS, SUPPORTED
from .positions import Given, Path
from .surface_tables import SURFACES
from .table_types import Positive, Quaternion, Table, Turn, Vector

Surface = Annotated[Table, OneOf(tuple(SURFACES.values()))]
Motion = Annotated[Table, OneOf(tuple(MOTIONS.values()))]
Load = Annotated[Table, OneOf(tuple(LOADS.values()))]
Contact = Annotated[Table, OneOf(tuple(CONTACTS.values()))]
Supported = Annotated[Table, OneOf(tuple(SUPPORTED.values()))]


class _WithSurface(Table):
    surface: Surface = Field(
        description='a table such as { kind = "sphere", radius = 0.1 } [m]'
    )


BodyTable = table_of(
    "BodyTable",
    "The rolling body.",
    "dynamics.bodies.Body",
    _WithSurface,
    first=("mass", "center_of_mass"),
)


class BaseTable(_WithSurface):
    """What the body rolls on; its axes are the fixed axes unless it moves."""

    motion: Motion | None = Field(
        default=None,
        description='a table such as { kind = "spin", rate = 4.0 }; left out, at rest',
    )


class StartTable(Table):
    """How the motion starts."""

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                {"oneOf": [{"required": [a]}, {"required": [b]}]}
                for a, b in (
                    ("orientation", "rotations"),
                    ("angular_velocity", "angular_velocity_body"),
                )
            ]
        }
    )

    orientation: Quaternion | None = Field(
        default=None,
        description="a unit quaternion, scalar first, body to fixed axes [1]",
    )
    rotations: list[Turn] | None = Field(
        default=None,
        description='turns [["x", degrees], ["y", degrees], ...] whose matrices '
        "multiply from left to right to the body-to-fixed rotation",
    )
    angular_velocity: Vector | None = Field(
        default=None, description="three components in the fixed axes [rad/s]"
    )
    angular_velocity_body: Vector | None = Field(
        default=None, description="three components in the body axes [rad/s]"
    )
    contact_on_base: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="the contact point on the base's surface, base axes [m]",
    )
    slip: Vector | None = Field(
        default=None,
        description="three components of the slip, fixed axes, for a contact that "
        "slips or may slip [m/s]; left out, none",
    )
    base_normal: Vector | None = Field(
        default=None,
        description="the base's outward normal there, only for a base with an edge [1]",
    )
    near_on_body: Vector | None = Field(
        default=None,
        description="a point next to the contact on the body, body axes, where many "
        "points have its normal, as of a ring that lies flat [m]",
    )
    allow_overlap: bool = Field(
        default=False,
        description="true to allow a body that is in its base elsewhere",
    )
    alpha: list[float] | None = Field(
        default=None,
        description="a list of the coordinates of all that is supported, without those "
        "whose motion is given; left out, zeros",
    )
    alpha_dot: list[float] | None = Field(
        default=None, description="a list of their rates; left out, zeros"
    )


class RollingStartTable(Table):
    """Where a rolling body is on its carrier, and how it moves relative to it."""

    orientation: Quaternion | None = Field(
        default=None,
        description="a unit quaternion, scalar first, from its own axes to those of "
        "the surface on which it rolls [1]; left out, the same axes",
    )
    rotations: list[Turn] | None = Field(
        default=None,
        description='turns [["x", degrees], ...] to the same, instead of orientation',
    )
    angular_velocity: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="three components of its angular velocity relative to the carrier, "
        "axes of the surface [rad/s]",
    )
    contact_on_carrier: Vector = Field(
        description="the contact point on the carrier's surface, its axes [m]"
    )
    base_normal: Vector | None = Field(
        default=None,
        description="the surface's outward normal there, only for an edge [1]",
    )
    near_on_body: Vector | None = Field(
        default=None,
        description="a point next to the contact on the body, body axes, where many "
        "points have its normal [m]",
    )
    allow_overlap: bool = Field(
        default=False,
        description="true to allow a body that is in its carrier elsewhere",
    )


class RollingTable(Table):
    """A body that rolls on or in the body, or another one that does."""

    body: Annotated[Table, OneOf((BodyTable,))] = Field(
        description="a table [rolling.body], as [body]"
    )
    on: Surface = Field(
        description="the surface of the carrier on which it rolls, a table such as "
        '{ kind = "sphere", radius = 0.1, inside = true } [m]'
    )
    carrier: int | None = Field(
        default=None,
        ge=0,
        description="the number of the [[rolling]] table before this one, from 0, of "
        "the body on which it rolls; left out, the body itself",
    )
    without_spin: bool = Field(
        default=False,
        description="true where it does not spin about the normal of its contact",
    )
    position: Vector | None = Field(
        default=None,
        description="three lengths: the origin of the surface's axes in the carrier; "
        "left out, the carrier's origin [m]",
    )
    rotations: list[Turn] | None = Field(
        default=None,
        description="turns [[\"x\", degrees], ...] from the surface's to the carrier's "
        "axes; left out, the same axes",
    )
    start: RollingStartTable = Field(description="a table [rolling.start]")


class RunTable(Table):
    """How long the motion lasts and how exactly it is computed."""

    duration: Positive = Field(description="the time it lasts [s], positive")
    outputs: int = Field(
        default=1001,
        ge=2,
        le=MOST_OUTPUTS,
        description=f"the number of output times, two or more, at most {MOST_OUTPUTS}",
    )
    rtol: Positive | None = Field(
        default=None, description="the relative tolerance of a step, such as 1e-9"
    )
    atol: Positive | None = Field(
        default=None, description="the absolute tolerance of a step, such as 1e-11"
    )
    method: Literal["auto", "native", "diffrax"] = Field(
        default="auto",
        description='"native" for the loop in C, "diffrax", or "auto": native where it '
        "can",
    )
    second_contact: bool = Field(
        default=False,
        description="true to end the run where the body touches its base at a second "
        "place",
    )


LIFT_OFF = "lift-off"


class EventTable(Table):
    """What a run looks for: where a number crosses a level."""

    of: Literal[
        "lift-off", "spin", "tilt", "energy", "normal_force", "friction_ratio"
    ] = Field(
        description='"lift-off", where the normal force falls through zero, or a '
        'number: "spin" about the vertical [rad/s], "tilt" of the body\'s z axis '
        '[rad], "energy" [J], "normal_force" [N], "friction_ratio" [1]'
    )
    level: float = Field(
        default=0.0, description="the value that is crossed, in the number's unit"
    )
    direction: Literal[-1, 0, 1] = Field(
        default=0, description="1 to look where it rises, -1 where it falls, 0 for both"
    )
    stop: bool = Field(default=False, description="true to end the run there")
    name: str | None = Field(
        default=None, description="a word or two; left out, what it is of"
    )


class SceneTable(Table):
    """A scene of rollkane: a body that rolls on a base. SI units, right-handed axes."""

    title: str = Field(default="", description="a line of text")
    description: str = Field(default="", description="text")
    axes: str = Field(default="", description="how the body axes lie, as text")
    body: Annotated[Table, OneOf((BodyTable,))] = Field(description="a table [body]")
    base: BaseTable | None = Field(
        default=None, description="a table [base]; left out, the plane z = 0"
    )
    loads: list[Load] | None = Field(
        default=None,
        max_length=MOST_PARTS,
        description="tables [[loads]]; left out, gravity; loads = [] for none",
    )
    supported: list[Supported] | None = Field(
        default=None,
        max_length=MOST_PARTS,
        description="tables [[supported]] of what the body carries",
    )
    rolling: list[RollingTable] | None = Field(
        default=None,
        description="tables [[rolling]] of bodies that roll on or in the body",
    )
    contact: Contact | None = Field(
        default=None,
        description='a table such as { kind = "coulomb", coefficient = 0.2 }; left '
        "out, rolling",
    )
    modes: Annotated[Table, OneOf((ModesTable,))] | None = Field(
        default=None,
        description="a table [modes]; left out, the contact never changes",
    )
    events: list[EventTable] | None = Field(
        default=None,
        max_length=MOST_PARTS,
        description="tables [[events]] of what a run looks for",
    )
    start: StartTable = Field(description="a table [start]")
    run: RunTable = Field(description="a table [run]")


def kinds_at(path: Path) -> Mapping[str, type[Table]] | None:
    """The tables that may stand at a path, by their ``kind``; None elsewhere."""
    match path:
        case ("body" | "base", "surface") | ("rolling", int(), "body", "surface"):
            return SURFACES
        case ("rolling", int(), "on"):
            return SURFACES
        case ("loads", int()):
            return LOADS
        case ("contact",):
            return CONTACTS
        case ("base", "motion"):
            return MOTIONS
        case ("supported", int()):
            return SUPPORTED
        case _:
            return None


def table_at(path: Path, kind: Any = None) -> type[Table] | None:
    """The table that stands at a path.

    Args:
        path: Keys, and indices of arrays.
        kind: Its ``kind``, where there are several.
    """
    kinds = kinds_at(path)
    if kinds is not None:
        return kinds.get(kind) if isinstance(kind, str) else None
    match path:
        case ("events", int()):
            return EventTable
        case ("rolling", int()):
            return RollingTable
        case ("rolling", int(), "body"):
            return BodyTable
        case ("rolling", int(), "start"):
            return RollingStartTable
        case _:
            pass
    tables: dict[Path, type[Table]] = {
        (): SceneTable,
        ("body",): BodyTable,
        ("base",): BaseTable,
        ("start",): StartTable,
        ("modes",): ModesTable,
        ("run",): RunTable,
    }
    return tables.get(path)


def scene_schema() -> dict[str, Any]:
    """JSON schema of a scene file (draft 2020-12), for editors and generators."""
    schema = SceneTable.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    _drop_null(schema)
    return schema


def _drop_null(schema: Given) -> None:
    """TOML has no null: an optional field is one that may be left out."""
    if isinstance(schema, list):
        for part in schema:
            _drop_null(part)
        return
    if not isinstance(schema, dict):
        return
    for part in schema.values():
        _drop_null(part)
    choices: list[Any] = schema.get("anyOf", [])
    if {"type": "null"} in choices:
        (only,) = [choice for choice in choices if choice != {"type": "null"}]
        del schema["anyOf"], schema["default"]
        schema.update(only)
