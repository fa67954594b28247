"""Tables of what acts on the body, and of what its contact does."""

from typing import Annotated, Literal

from pydantic import Field

from .table_types import Table, Vector

_VISCOUS = "moment over angular velocity [N m s], 0 or more"
_DRY = "the arm of the normal force [m], 0 or more"
_SLOW = "a speed below which dry friction fades [m/s], positive"
_FADES = "an angular velocity below which the dry part fades [rad/s], positive"


class GravityTable(Table):
    """Uniform gravity."""

    kind: Literal["gravity"]
    acceleration: Vector = Field(
        default=[0.0, 0.0, -9.81],
        description="three components in the fixed axes [m/s^2]",
    )


class DragTable(Table):
    """Resistance of the air, on a point of the body and on its turning."""

    kind: Literal["drag"]
    linear: float = Field(default=0.0, description="force over speed [N s/m]")
    quadratic: float = Field(
        default=0.0, description="force over the square of the speed [N s^2/m^2]"
    )
    angular: float = Field(
        default=0.0, description="moment over angular velocity [N m s]"
    )
    point: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="the point of the body on which it acts, body axes [m]",
    )


class RollingResistanceTable(Table):
    """A moment against rolling."""

    kind: Literal["rolling-resistance"]
    viscous: float | None = Field(default=None, description=_VISCOUS)
    dry: float | None = Field(default=None, description=_DRY)
    regularization: float = Field(default=1e-3, description=_FADES)


class SpinningResistanceTable(Table):
    """A moment against turning about the normal."""

    kind: Literal["spinning-resistance"]
    viscous: float | None = Field(default=None, description=_VISCOUS)
    dry: float | None = Field(default=None, description=_DRY)
    regularization: float = Field(default=1e-3, description=_FADES)


class RollingTable(Table):
    """Rolling without slipping, turning about the normal allowed."""

    kind: Literal["rolling"]


class RubberTable(Table):
    """Rolling without slipping and without turning about the normal."""

    kind: Literal["rubber"]


class ViscousTable(Table):
    """Slipping on a film of oil."""

    kind: Literal["viscous"]
    coefficient: float = Field(description="force over slip [N s/m], 0 or more")


class CoulombTable(Table):
    """Slipping against dry friction."""

    kind: Literal["coulomb"]
    coefficient: float = Field(description="force over normal force [1], 0 or more")
    regularization: float = Field(default=1e-3, description=_SLOW)


class StribeckTable(Table):
    """Slipping against friction that falls with the speed."""

    kind: Literal["stribeck"]
    static: float = Field(description="the coefficient at rest [1], 0 or more")
    kinetic: float = Field(description="the coefficient of fast slips [1], 0 or more")
    speed: float = Field(description="the speed between both [m/s], positive")
    viscous: float = Field(
        default=0.0, description="a viscous part, force over slip [N s/m], 0 or more"
    )
    regularization: float = Field(default=1e-3, description=_SLOW)


class ModesTable(Table):
    """How the run may change between rolling, slipping and flight."""

    friction: float | None = Field(
        default=None,
        description="the coefficient of sliding friction [1], 0 or more; left out, the "
        "body never slips",
    )
    static_friction: float | None = Field(
        default=None,
        description="that of sticking [1], friction or more; left out, the same",
    )
    lifts: bool = Field(
        default=True, description="whether the contact ends where it would have to pull"
    )
    restitution: float | None = Field(
        default=None,
        description="that of a landing [1], from 0 to 1; left out, nothing lands",
    )
    rest_speed: float = Field(
        default=1e-3,
        description="the speed below which a rebound stays in contact [m/s], positive",
    )
    switches: int = Field(
        default=64, ge=1, description="how many changes are kept, 1 or more"
    )
    impact: Literal["energetic", "newton"] = Field(
        default="energetic",
        description="what the restitution is of: the energy of compression, or the "
        "normal velocity",
    )


LOADS: dict[str, type[Table]] = {
    "gravity": GravityTable,
    "drag": DragTable,
    "rolling-resistance": RollingResistanceTable,
    "spinning-resistance": SpinningResistanceTable,
}
CONTACTS: dict[str, type[Table]] = {
    "rolling": RollingTable,
    "rubber": RubberTable,
    "viscous": ViscousTable,
    "coulomb": CoulombTable,
    "stribeck": StribeckTable,
}
Load = Annotated[
    GravityTable | DragTable | RollingResistanceTable | SpinningResistanceTable,
    Field(discriminator="kind"),
]
Contact = Annotated[
    RollingTable | RubberTable | ViscousTable | CoulombTable | StribeckTable,
    Field(discriminator="kind"),
]
