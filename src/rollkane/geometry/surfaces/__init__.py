"""The catalogue of surfaces, for the body and for the base."""

from .abstract_surface import AbstractSurface as AbstractSurface
from .abstract_surface import Ball as Ball
from .catalogue import Cylinder as Cylinder
from .catalogue import Ellipsoid as Ellipsoid
from .catalogue import Plane as Plane
from .catalogue import Sphere as Sphere
from .catalogue import Torus as Torus
from .cone import Cone as Cone
from .directions import NormalHeading as NormalHeading
from .directions import PointOfNormal as PointOfNormal
from .edges import DiscEdge as DiscEdge
from .edges import Ring as Ring
from .kinds import AbstractNormalSurface as AbstractNormalSurface
from .kinds import AbstractPointSurface as AbstractPointSurface
from .parametric import Parametric as Parametric
from .revolution import Revolution as Revolution
from .user_surfaces import Graph as Graph
from .user_surfaces import Implicit as Implicit
