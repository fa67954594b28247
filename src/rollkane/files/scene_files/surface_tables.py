"""The tables of surfaces in a scene file, by their ``kind``."""

import math
from typing import Annotated, Literal

from pydantic import Field

from .table_types import PARAMETERS, Range, Ranges, Table, Vector

_CENTER = "its centre, three lengths in its owner's axes [m]"
_INSIDE = "true where the other body touches from within, else false"
_PAIR = "two ranges [[low, high], [low, high]]"


class PlaneTable(Table):
    """The plane z = 0, material below."""

    kind: Literal["plane"]


class SphereTable(Table):
    """A sphere, or a spherical cavity."""

    kind: Literal["sphere"]
    radius: float = Field(description="the radius [m], positive")
    center: Vector = Field(default=[0.0, 0.0, 0.0], description=_CENTER)
    inside: bool = Field(default=False, description=_INSIDE)


class EllipsoidTable(Table):
    """An ellipsoid with its axes along its owner's, or such a cavity."""

    kind: Literal["ellipsoid"]
    semi_axes: Vector = Field(description="three positive lengths along x, y and z [m]")
    center: Vector = Field(default=[0.0, 0.0, 0.0], description=_CENTER)
    inside: bool = Field(default=False, description=_INSIDE)


class TorusTable(Table):
    """A torus about the z axis."""

    kind: Literal["torus"]
    major_radius: float = Field(
        description="the radius of the tube's centre line [m], positive"
    )
    minor_radius: float = Field(
        description="the radius of the tube [m], positive, less than major_radius"
    )
    inside: bool = Field(default=False, description=_INSIDE)


class CylinderTable(Table):
    """A circular cylinder about the z axis, without ends."""

    kind: Literal["cylinder"]
    radius: float = Field(description="the radius [m], positive")
    inside: bool = Field(default=False, description=_INSIDE)


class ConeTable(Table):
    """The cone z = slope * distance from the z axis."""

    kind: Literal["cone"]
    slope: float = Field(description="rise over run [1], not zero")
    inside: bool = Field(
        default=False, description="true where the other body is above, else false"
    )


class DiscEdgeTable(Table):
    """The sharp rim of a thin solid disc in the plane z = 0, axis z."""

    kind: Literal["disc-edge"]
    radius: float = Field(description="the radius of the rim [m], positive")


class RingTable(Table):
    """A ring of thin wire in the plane z = 0, axis z."""

    kind: Literal["ring"]
    radius: float = Field(description="the radius of the ring [m], positive")


class GraphTable(Table):
    """The surface z = f(x, y), the other body above."""

    kind: Literal["graph"]
    f: str = Field(description='a formula in x and y [m], such as "0.3*x**2"')
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)
    domain: Ranges = Field(
        default=[[-1.0, 1.0], [-1.0, 1.0]],
        description=_PAIR + " of x and y [m] for searches and drawing",
    )


class RevolutionTable(Table):
    """A surface of revolution about z: radius(s), height(s)."""

    kind: Literal["revolution"]
    radius: str = Field(description='a formula in s [m], such as "0.1*sin(s)"')
    height: str = Field(description='a formula in s [m], such as "-0.1*cos(s)"')
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)
    domain: Range = Field(
        default=[0.0, math.pi], description="the range [low, high] of s"
    )
    inside: bool = Field(
        default=False,
        description="true turns the outward side towards the axis, else false",
    )


class ParametricTable(Table):
    """A surface by its position as a function of q1 and q2."""

    kind: Literal["parametric"]
    x: str = Field(description='a formula in q1 and q2 [m], such as "cos(q1)*cos(q2)"')
    y: str = Field(description='a formula in q1 and q2 [m], such as "sin(q1)*cos(q2)"')
    z: str = Field(description='a formula in q1 and q2 [m], such as "sin(q2)"')
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)
    domain: Ranges = Field(
        default=[[-math.pi, math.pi], [-0.5 * math.pi, 0.5 * math.pi]],
        description=_PAIR + " of q1 and q2 for searches and drawing",
    )
    inside: bool = Field(
        default=False,
        description="false where the normal d1 x d2 points out of the material, "
        "else true",
    )


class ImplicitTable(Table):
    """The surface f(x, y, z) = 0, with f < 0 in the material."""

    kind: Literal["implicit"]
    f: str = Field(description='a formula in x, y, z, such as "x**2 + y**2 + z**4 - 1"')
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)
    center: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="a point of the material from which the surface is searched [m]",
    )
    size: float = Field(
        default=1.0, description="how far from there it reaches at most [m], positive"
    )


SURFACES: dict[str, type[Table]] = {
    "plane": PlaneTable,
    "sphere": SphereTable,
    "ellipsoid": EllipsoidTable,
    "torus": TorusTable,
    "cylinder": CylinderTable,
    "cone": ConeTable,
    "disc-edge": DiscEdgeTable,
    "ring": RingTable,
    "graph": GraphTable,
    "revolution": RevolutionTable,
    "parametric": ParametricTable,
    "implicit": ImplicitTable,
}

Surface = Annotated[
    PlaneTable
    | SphereTable
    | EllipsoidTable
    | TorusTable
    | CylinderTable
    | ConeTable
    | DiscEdgeTable
    | RingTable
    | GraphTable
    | RevolutionTable
    | ParametricTable
    | ImplicitTable,
    Field(discriminator="kind"),
]
