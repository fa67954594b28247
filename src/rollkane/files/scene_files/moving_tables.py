"""Tables of what moves: the base, and what the body carries."""

from typing import Annotated, Literal

from pydantic import Field

from .derived_tables import table_of
from .table_types import (
    PARAMETERS,
    FormulaTurn,
    Positive,
    Quaternion,
    Range,
    Table,
    Turn,
    Vector,
)

_FORMULAS = Annotated[list[str], Field(min_length=3, max_length=3)]
_NAMES = "a list of names, which the formulas use, in the order of alpha"
_FORCE = (
    "a list of formulas, one for each coordinate, in t, the coordinates and their "
    'rates (psi and psi_dot), such as "-0.1*psi_dot" [J per unit of the coordinate]'
)
_POTENTIAL = 'a formula in the coordinates, such as "0.3*psi**2" [J]'
_MOTION = "a list of formulas in t, one for each coordinate, that prescribe them"
_ANGLES = (
    'turns [["x", "formula"], ...] whose angles are formulas [rad] and whose matrices '
    "multiply from left to right"
)


class _Spin(Table):
    rotations: list[Turn] | None = Field(
        default=None,
        description='turns [["x", degrees], ...] that tilt the base at t = 0',
    )
    orientation: Quaternion | None = Field(
        default=None,
        description="a unit quaternion of the base at t = 0, instead of rotations [1]",
    )


class _Functions(Table):
    position: _FORMULAS | None = Field(
        default=None,
        description="three formulas in t: the base origin in fixed axes [m]",
    )
    rotations: list[FormulaTurn] | None = Field(
        default=None, description=_ANGLES + " to the base-to-fixed rotation"
    )
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)


class RecordTable(Table):
    """A translation by a recorded acceleration, piecewise linear."""

    kind: Literal["record"]
    record: str | None = Field(
        default=None, description="the name of a built-in record, instead of file"
    )
    file: str | None = Field(
        default=None, description="the path of a record, from the scene file's folder"
    )
    format: Literal["at2", "single-column", "two-column", "v2a"] = Field(
        default="at2", description="the form of the file"
    )
    unit: Literal["g", "m/s2", "cm/s2", "mm/s2"] | None = Field(
        default=None,
        description="the unit of the file's samples; left out, the one that its header "
        "says, or else g (v2a: mm/s2)",
    )
    axes: list[Literal["x", "y", "z"]] = Field(
        default=["x", "y", "z"],
        description='a list of fixed axes, such as ["x", "y"], for the components of '
        "the record in their order; further components are not used",
    )
    window: Range | None = Field(
        default=None, description="the part [start, end] that is used, from t = 0 [s]"
    )
    scale: float = Field(default=1.0, description="a factor for the accelerations [1]")
    start_velocity: Vector = Field(
        default=[0.0, 0.0, 0.0], description="three components at its start [m/s]"
    )
    start_position: Vector = Field(
        default=[0.0, 0.0, 0.0], description="three lengths at its start [m]"
    )


class _Driven(Table):
    coordinates: list[str] = Field(min_length=1, description=_NAMES)
    force: list[str] | None = Field(default=None, description=_FORCE)
    potential: str | None = Field(default=None, description=_POTENTIAL)
    motion: list[str] | None = Field(default=None, description=_MOTION)
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)


class _PointMasses(_Driven):
    mass: list[Positive] = Field(min_length=1, description="a list of masses [kg]")
    position: list[_FORMULAS] = Field(
        description="three formulas for each mass: its place in body axes [m]"
    )


class _SupportedBody(_Driven):
    position: _FORMULAS = Field(
        description="three formulas: its mass centre in body axes [m]"
    )
    rotations: list[FormulaTurn] = Field(
        default=[], description=_ANGLES + " to the rotation of its axes to body axes"
    )


# names of the coordinates come before the formulas in them
_ORDER = {
    "position": ("coordinates", "position"),
    "coordinates": (),
    "potential": ("potential", "motion"),
}
SpinTable = table_of(
    "SpinTable",
    "A steady turn about the base's own z axis.",
    "kinematics.base_motion.Spin",
    _Spin,
    {"orientation": ("rotations", "orientation")},
    kind="spin",
)
FunctionsTable = table_of(
    "FunctionsTable",
    "A motion by formulas in the time t.",
    "kinematics.base_motion.BaseMotion",
    _Functions,
    {"rotation": ("rotations",), "kinks": ()},  # formulas have none
    kind="functions",
)
MOTIONS: dict[str, type[Table]] = {
    "spin": SpinTable,
    "functions": FunctionsTable,
    "record": RecordTable,
}
SUPPORTED = {
    "point-masses": table_of(
        "PointMassesTable",
        "Point masses that move inside the body.",
        "dynamics.supported.PointMasses",
        _PointMasses,
        _ORDER,
        kind="point-masses",
    ),
    "body": table_of(
        "SupportedBodyTable",
        "A rigid body that moves inside the body.",
        "dynamics.supported.SupportedBody",
        _SupportedBody,
        _ORDER | {"rotation": ("rotations",)},
        kind="body",
        narrower={"mass": Positive},
    ),
}
