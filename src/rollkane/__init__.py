"""Exact dynamics of a rigid body that rolls without slipping, in JAX.

Names are imported when first used, so that ``rollkane --help`` need not wait for JAX.
Importing rollkane changes no global setting.
"""

import importlib
from typing import TYPE_CHECKING

__version__ = "0.1.0"

_ROOMS = {
    "accelerograms": (
        "Accelerogram",
        "builtin_record",
        "read_at2",
        "read_single_column",
        "read_two_column",
        "read_v2a",
    ),
    "base_motion": ("BaseMotion", "Spin"),
    "bodies": ("Body",),
    "checks": ("FieldError",),
    "codes": ("Code",),
    "coordinates": ("FlyingState", "SlidingState", "State"),
    "ensembles": ("Ensemble", "ensemble", "ensemble_blocks"),
    "euler_lagrange": ("euler_lagrange_derivative",),
    "geometry": ("LocalGeometry",),
    "friction": ("CoulombFriction", "StribeckFriction", "ViscousFriction"),
    "keeping": ("Keeping", "keeping_energy"),
    "loads": ("Drag", "Force", "Gravity", "Potential", "Torque"),
    "modes": ("Mode", "Modes", "Switches"),
    "placement": ("place",),
    "precision": ("WorkPrecision", "recommend", "work_precision"),
    "quasi_velocities": ("PaperQuantities", "paper_quantities"),
    "recorded_motion": ("RecordedMotion",),
    "rolling": ("contact_of", "rolling_derivative"),
    "resistance": ("RollingResistance", "SpinningResistance"),
    "scene": ("Base", "Rolling", "RubberRolling", "Scene", "Slipping"),
    "separation": ("release",),
    "simulation": ("simulate",),
    "state_conversion": ("to_pole_free", "to_voronets"),
    "supported": ("PointMasses", "Prescribed", "SupportedBody"),
    "surfaces": (
        "Cone",
        "Cylinder",
        "DiscEdge",
        "Ellipsoid",
        "Graph",
        "Implicit",
        "Parametric",
        "Plane",
        "Revolution",
        "Ring",
        "Sphere",
        "Torus",
    ),
    "timed_runs": ("Measured", "Setting"),
    "trajectory": ("Trajectory",),
    "voronets": ("VoronetsState",),
}
_ROOM_OF = {name: room for room, names in _ROOMS.items() for name in names}

__all__ = sorted([*_ROOM_OF, "kane"])  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from . import kane as kane
    from .accelerograms import Accelerogram as Accelerogram
    from .accelerograms import builtin_record as builtin_record
    from .accelerograms import read_at2 as read_at2
    from .accelerograms import read_single_column as read_single_column
    from .accelerograms import read_two_column as read_two_column
    from .accelerograms import read_v2a as read_v2a
    from .base_motion import BaseMotion as BaseMotion
    from .base_motion import Spin as Spin
    from .bodies import Body as Body
    from .checks import FieldError as FieldError
    from .codes import Code as Code
    from .coordinates import FlyingState as FlyingState
    from .coordinates import SlidingState as SlidingState
    from .coordinates import State as State
    from .ensembles import Ensemble as Ensemble
    from .ensembles import ensemble as ensemble
    from .ensembles import ensemble_blocks as ensemble_blocks
    from .euler_lagrange import euler_lagrange_derivative as euler_lagrange_derivative
    from .friction import CoulombFriction as CoulombFriction
    from .friction import StribeckFriction as StribeckFriction
    from .friction import ViscousFriction as ViscousFriction
    from .geometry import LocalGeometry as LocalGeometry
    from .keeping import Keeping as Keeping
    from .keeping import keeping_energy as keeping_energy
    from .loads import Drag as Drag
    from .loads import Force as Force
    from .loads import Gravity as Gravity
    from .loads import Potential as Potential
    from .loads import Torque as Torque
    from .modes import Mode as Mode
    from .modes import Modes as Modes
    from .modes import Switches as Switches
    from .placement import place as place
    from .precision import WorkPrecision as WorkPrecision
    from .precision import recommend as recommend
    from .precision import work_precision as work_precision
    from .quasi_velocities import PaperQuantities as PaperQuantities
    from .quasi_velocities import paper_quantities as paper_quantities
    from .recorded_motion import RecordedMotion as RecordedMotion
    from .resistance import RollingResistance as RollingResistance
    from .resistance import SpinningResistance as SpinningResistance
    from .rolling import contact_of as contact_of
    from .rolling import rolling_derivative as rolling_derivative
    from .scene import Base as Base
    from .scene import Rolling as Rolling
    from .scene import RubberRolling as RubberRolling
    from .scene import Scene as Scene
    from .scene import Slipping as Slipping
    from .separation import release as release
    from .simulation import simulate as simulate
    from .state_conversion import to_pole_free as to_pole_free
    from .state_conversion import to_voronets as to_voronets
    from .supported import PointMasses as PointMasses
    from .supported import Prescribed as Prescribed
    from .supported import SupportedBody as SupportedBody
    from .surfaces import Cone as Cone
    from .surfaces import Cylinder as Cylinder
    from .surfaces import DiscEdge as DiscEdge
    from .surfaces import Ellipsoid as Ellipsoid
    from .surfaces import Graph as Graph
    from .surfaces import Implicit as Implicit
    from .surfaces import Parametric as Parametric
    from .surfaces import Plane as Plane
    from .surfaces import Revolution as Revolution
    from .surfaces import Ring as Ring
    from .surfaces import Sphere as Sphere
    from .surfaces import Torus as Torus
    from .timed_runs import Measured as Measured
    from .timed_runs import Setting as Setting
    from .trajectory import Trajectory as Trajectory
    from .voronets import VoronetsState as VoronetsState


def __getattr__(name: str):
    """Import a public name from its room, once."""
    if name == "kane":
        return importlib.import_module(".kane", __name__)
    room = _ROOM_OF.get(name)
    if room is None:
        raise AttributeError(f"module 'rollkane' has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{room}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names, whether imported yet or not."""
    return sorted(set(globals()) | set(__all__))
