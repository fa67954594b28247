"""Kane's method for any system that a user can write down.

From outside to inside: ``motion`` integrates, ``linearization`` and ``equations``
evaluate a system that ``system`` describes; ``examples``, ``bicycle``, ``free_bodies``
and ``rolling_scene`` write systems down; ``contact_system`` joins bodies that roll.
"""

from .bicycle import LEAN_AND_STEER as LEAN_AND_STEER
from .bicycle import Bicycle as Bicycle
from .bicycle import bicycle_state as bicycle_state
from .bicycle import whipple_bicycle as whipple_bicycle
from .contact_system import ContactForces as ContactForces
from .contact_system import Frame as Frame
from .contact_system import RollingContact as RollingContact
from .contact_system import RollingSystem as RollingSystem
from .contact_system import ground as ground
from .contact_system import rolling_contacts as rolling_contacts
from .equations import KaneEquations as KaneEquations
from .equations import all_speeds as all_speeds
from .equations import kane_derivative as kane_derivative
from .equations import kane_equations as kane_equations
from .equations import kinetic_energy as kinetic_energy
from .equations import reactions as reactions
from .examples import DISC_SPEEDS as DISC_SPEEDS
from .examples import babyboot as babyboot
from .examples import bar_on_frame as bar_on_frame
from .examples import disc_state as disc_state
from .examples import euler_parameters_to_rotation as euler_parameters_to_rotation
from .examples import free_rigid_body as free_rigid_body
from .examples import rolling_disc as rolling_disc
from .free_bodies import FreeBodies as FreeBodies
from .free_bodies import free_bodies as free_bodies
from .linearization import Linearization as Linearization
from .linearization import linearize as linearize
from .motion import KaneTrajectory as KaneTrajectory
from .motion import simulate as simulate
from .parts import Load as Load
from .parts import Particle as Particle
from .parts import RigidBody as RigidBody
from .rolling_scene import kane_state as kane_state
from .rolling_scene import rolling_system as rolling_system
from .system import KaneState as KaneState
from .system import KaneSystem as KaneSystem
