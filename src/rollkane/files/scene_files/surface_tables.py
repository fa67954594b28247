"""The tables of surfaces in a scene file, by their ``kind``."""

import math

from pydantic import Field

from .derived_tables import tables_of
from .table_types import PARAMETERS, Range, Ranges, Table

_PAIR = "two ranges [[low, high], [low, high]]"


class _WithParameters(Table):
    parameters: dict[str, float] = Field(default={}, description=PARAMETERS)


class _Graph(_WithParameters):
    f: str = Field(description='a formula in x and y [m], such as "0.3*x**2"')
    domain: Ranges = Field(
        default=[[-1.0, 1.0], [-1.0, 1.0]],
        description=_PAIR + " of x and y [m] for searches and drawing",
    )


class _Revolution(_WithParameters):
    radius: str = Field(description='a formula in s [m], such as "0.1*sin(s)"')
    height: str = Field(description='a formula in s [m], such as "-0.1*cos(s)"')
    domain: Range = Field(
        default=[0.0, math.pi], description="the range [low, high] of s"
    )


class _Parametric(_WithParameters):
    x: str = Field(description='a formula in q1 and q2 [m], such as "cos(q1)*cos(q2)"')
    y: str = Field(description='a formula in q1 and q2 [m], such as "sin(q1)*cos(q2)"')
    z: str = Field(description='a formula in q1 and q2 [m], such as "sin(q2)"')
    domain: Ranges = Field(
        default=[[-math.pi, math.pi], [-0.5 * math.pi, 0.5 * math.pi]],
        description=_PAIR + " of q1 and q2 for searches and drawing",
    )


class _Implicit(_WithParameters):
    f: str = Field(description='a formula in x, y, z, such as "x**2 + y**2 + z**4 - 1"')


_HERE = "geometry.surfaces"
SURFACES = tables_of(
    {
        "plane": ("The plane z = 0, material below.", f"{_HERE}.catalogue.Plane"),
        "sphere": ("A sphere, or a spherical cavity.", f"{_HERE}.catalogue.Sphere"),
        "ellipsoid": (
            "An ellipsoid with its axes along its owner's, or such a cavity.",
            f"{_HERE}.catalogue.Ellipsoid",
        ),
        "torus": ("A torus about the z axis.", f"{_HERE}.catalogue.Torus"),
        "cylinder": (
            "A circular cylinder about the z axis, without ends.",
            f"{_HERE}.catalogue.Cylinder",
        ),
        "cone": (
            "The cone z = slope * distance from the z axis.",
            f"{_HERE}.cone.Cone",
        ),
        "disc-edge": (
            "The sharp rim of a thin solid disc in the plane z = 0, axis z.",
            f"{_HERE}.edges.DiscEdge",
        ),
        "ring": (
            "A ring of thin wire in the plane z = 0, axis z.",
            f"{_HERE}.edges.Ring",
        ),
        "graph": (
            "The surface z = f(x, y), the other body above.",
            f"{_HERE}.user_surfaces.Graph",
            _Graph,
        ),
        "revolution": (
            "A surface of revolution about z: radius(s), height(s).",
            f"{_HERE}.revolution.Revolution",
            _Revolution,
            # the ends of the meridian are found from its formulas
            {"profile": ("radius", "height"), "poles": (), "rising": ()},
        ),
        "parametric": (
            "A surface by its position as a function of q1 and q2. Where these do not "
            "count for two (poles of longitude and latitude) a run ends as at an edge.",
            f"{_HERE}.parametric.Parametric",
            _Parametric,
            # formulas are of a pair, not of a direction
            {"position": ("x", "y", "z"), "of_direction": ()},
        ),
        "implicit": (
            "The surface f(x, y, z) = 0, with f < 0 in the material.",
            f"{_HERE}.user_surfaces.Implicit",
            _Implicit,
        ),
    }
)
