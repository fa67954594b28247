"""The catalogue of surfaces, for the body and for the base."""

from .catalogue import Cone as Cone
from .catalogue import Cylinder as Cylinder
from .catalogue import DiscEdge as DiscEdge
from .catalogue import Ellipsoid as Ellipsoid
from .catalogue import Plane as Plane
from .catalogue import Sphere as Sphere
from .catalogue import Torus as Torus
from .given import Graph as Graph
from .given import Implicit as Implicit
from .given import Parametric as Parametric
from .kinds import AbstractNormalSurface as AbstractNormalSurface
from .kinds import AbstractPointSurface as AbstractPointSurface
from .kinds import AbstractSurface as AbstractSurface
from .kinds import PointOfNormal as PointOfNormal
from .revolution import Revolution as Revolution
