"""Kane's method for any system that a user can write down.

From outside to inside: ``motion`` integrates, ``linearization`` and ``equations``
evaluate a system that ``system`` describes.
"""

from .equations import KaneEquations as KaneEquations
from .equations import kane_derivative as kane_derivative
from .equations import kane_equations as kane_equations
from .equations import kinetic_energy as kinetic_energy
from .equations import reactions as reactions
from .linearization import Linearization as Linearization
from .linearization import linearize as linearize
from .motion import KaneTrajectory as KaneTrajectory
from .motion import simulate as simulate
from .system import KaneState as KaneState
from .system import KaneSystem as KaneSystem
from .system import Load as Load
from .system import Particle as Particle
from .system import RigidBody as RigidBody
