"""Tables of what moves: the base, and what the body carries."""

from typing import Annotated, Literal

from pydantic import Field

from .table_types import (
    PARAMETERS,
    FormulaTurn,
    Matrix,
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


class SpinTable(Table):
    """A steady turn about the base's own z axis."""

    kind: Literal["spin"]
    rate: float = Field(description="the angular velocity [rad/s]")
    rotations: list[Turn] | None = Field(
        default=None,
        description='turns [["x", degrees], ...] that tilt the base at t = 0',
    )
    orientation: Quaternion | None = Field(
        default=None,
        description="a unit quaternion of the base at t = 0, instead of rotations [1]",
    )
    position: Vector | None = Field(
        default=None, description="three lengths: the base origin in fixed axes [m]"
    )


class FunctionsTable(Table):
    """A motion by formulas in the time t."""

    kind: Literal["functions"]
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


class PointMassesTable(Table):
    """Point masses that move inside the body."""

    kind: Literal["point-masses"]
    mass: list[Positive] = Field(min_length=1, description="a list of masses [kg]")
    coordinates: list[str] = Field(min_length=1, description=_NAMES)
    position: list[_FORMULAS] = Field(
        description="three formulas for each mass: its place in body axes [m]"
    )
    force: list[str] | None = Field(default=None, description=_FORCE)
    potential: str | None = Field(default=None, description=_POTENTIAL)
    motion: list[str] | None = Field(default=None, description=_MOTION)
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)


class SupportedBodyTable(Table):
    """A rigid body that moves inside the body."""

    kind: Literal["body"]
    mass: Positive = Field(description="the mass [kg], positive")
    inertia: Matrix = Field(
        description="the 3 x 3 tensor about its own mass centre, its own axes [kg m^2]"
    )
    coordinates: list[str] = Field(min_length=1, description=_NAMES)
    position: _FORMULAS = Field(
        description="three formulas: its mass centre in body axes [m]"
    )
    rotations: list[FormulaTurn] = Field(
        default=[], description=_ANGLES + " to the rotation of its axes to body axes"
    )
    force: list[str] | None = Field(default=None, description=_FORCE)
    potential: str | None = Field(default=None, description=_POTENTIAL)
    motion: list[str] | None = Field(default=None, description=_MOTION)
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)


MOTIONS: dict[str, type[Table]] = {
    "spin": SpinTable,
    "functions": FunctionsTable,
    "record": RecordTable,
}
SUPPORTED: dict[str, type[Table]] = {
    "point-masses": PointMassesTable,
    "body": SupportedBodyTable,
}
Motion = Annotated[
    SpinTable | FunctionsTable | RecordTable, Field(discriminator="kind")
]
Supported = Annotated[
    PointMassesTable | SupportedBodyTable, Field(discriminator="kind")
]
