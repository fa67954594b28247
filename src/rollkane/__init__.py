"""Exact dynamics of a rigid body that rolls on a surface, in JAX."""

from .bodies import Body as Body
from .loads import Gravity as Gravity
from .scene import Base as Base, Rolling as Rolling, Scene as Scene
from .rolling import rolling_derivative as rolling_derivative
from .coordinates import State as State
from .surfaces import (Cone as Cone, Cylinder as Cylinder, DiscEdge as DiscEdge, Ellipsoid as Ellipsoid, Graph as Graph, Implicit as Implicit, Parametric as Parametric, Plane as Plane, Revolution as Revolution, Sphere as Sphere, Torus as Torus)
from .placement import place as place
from .simulate import simulate as simulate
from .trajectory import Trajectory as Trajectory
