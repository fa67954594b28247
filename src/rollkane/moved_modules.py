"""Modules by the names that they had before 0.2, for one release.

``rollkane.simulate`` and all other public names stand where they were. ``geometry``,
``integration``, ``hybrid`` and ``simulation`` are folders now: their modules are found
by their new names alone.
"""

import importlib
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

NEW = {
    "native.cache": "codegen.cache",
    "native.compiler": "codegen.compiler",
    "native.listing": "codegen.scalar_source",
    "native.right_hand_side": "codegen.right_hand_side",
    "native.step_source": "codegen.runge_kutta_source",
    "native.xla_call": "codegen.ffi_call",
    "native.derivatives": "codegen.derivative_loops",
    "native.lanes": "codegen.lane_loop",
    "native.runs": "codegen.run_loop",
    "native.scalars": "codegen.scalars",
    "native.writer": "codegen.statement_writer",
    "native.memory": "codegen.array_memory",
    "native.array_operations": "codegen.array_operations",
    "native.indexed_operations": "codegen.indexed_operations",
    "native.structured": "codegen.control_flow",
    "native.whole": "codegen.whole_program",
    "checks": "validation.checks",
    "codes": "validation.codes",
    "user_function": "validation.user_functions",
    "tableau": "codegen.tableau",
    "one_call": "codegen.compile_effort",
    "numberwise": "codegen.scalar_program",
    "rearrangements": "codegen.data_movement",
    "native": "codegen",
    "small_linear": "geometry.small_linear",
    "rotations": "geometry.rotations",
    "surfaces": "geometry.surfaces",
    "base_motion": "kinematics.base_motion",
    "recorded_motion": "kinematics.recorded_motion",
    "contact": "kinematics.contact",
    "coordinates": "kinematics.coordinates",
    "voronets": "kinematics.voronets",
    "bodies": "dynamics.bodies",
    "supported": "dynamics.supported",
    "loads": "dynamics.loads",
    "friction": "dynamics.friction",
    "directed_friction": "dynamics.directed_friction",
    "resistance": "dynamics.resistance",
    "scene": "dynamics.scene",
    "mass_matrix": "dynamics.mass_matrix",
    "contact_laws": "dynamics.contact_laws",
    "rolling": "dynamics.rolling",
    "observables": "dynamics.observables",
    "consistency": "dynamics.consistency",
    "clearance": "dynamics.clearance",
    "placement": "dynamics.placement",
    "impact_process": "dynamics.impact_process",
    "impacts": "dynamics.impacts",
    "diagnosis": "dynamics.diagnosis",
    "carried_functions": "dynamics.coordinate_functions",
    "refused_placements": "dynamics.placement_errors",
    "separation": "dynamics.gap",
    "rolling_run": "dynamics.rolling_problem",
    "quasi_velocities": "paper.quasi_velocities",
    "quasi_energy": "paper.quasi_energy",
    "euler_lagrange": "paper.euler_lagrange",
    "state_conversion": "paper.conversions",
    "differentiate": "integration.differentiate",
    "replay": "integration.replay",
    "steps": "integration.step_control",
    "keeping": "integration.projection",
    "solving": "integration.solve",
    "methods": "integration.backends",
    "modes": "hybrid.modes",
    "mode_replay": "hybrid.mode_replay",
    "mode_adjoint": "hybrid.mode_adjoint",
    "mode_loop": "hybrid.mode_loop",
    "hidden_events": "hybrid.event_bounds",
    "root_search": "hybrid.event_location",
    "mode_changes": "hybrid.transitions",
    "flight_watch": "hybrid.flight_bounds",
    "trajectory": "simulation.trajectory",
    "ensembles": "simulation.ensembles",
    "members": "simulation.ensemble_members",
    "lane_blocks": "simulation.lane_blocks",
    "timed_runs": "studies.timing",
    "precision": "studies.work_precision",
    "accelerogram_lines": "files.accelerogram_lines",
    "accelerogram_units": "files.accelerogram_units",
    "accelerogram_headers": "files.accelerogram_headers",
    "accelerogram_v2a": "files.accelerogram_v2a",
    "accelerograms": "files.accelerograms",
    "export": "files.export",
    "whole_file": "files.atomic_file",
    "scene_files": "files.scene_files",
    "mesh": "pictures.mesh",
    "plot_style": "pictures.plot_style",
    "plot_path": "pictures.plot_path",
    "plot_precision": "pictures.plot_precision",
    "plotting": "pictures.plotting",
    "viewer": "pictures.viewer",
    "summary": "pictures.summary",
    "history": "pictures.motion_samples",
    "surfaces.directions": "geometry.surfaces.directions",
    "surfaces.kinds": "geometry.surfaces.kinds",
    "surfaces.edges": "geometry.surfaces.edges",
    "surfaces.catalogue": "geometry.surfaces.catalogue",
    "surfaces.cone": "geometry.surfaces.cone",
    "surfaces.revolution": "geometry.surfaces.revolution",
    "surfaces.given": "geometry.surfaces.user_surfaces",
    "kane.refusals": "kane.singular_states",
    "kane.ready": "kane.examples",
    "scene_files.formulas": "files.scene_files.formulas",
    "scene_files.table_types": "files.scene_files.table_types",
    "scene_files.moving_tables": "files.scene_files.moving_tables",
    "scene_files.load_tables": "files.scene_files.load_tables",
    "scene_files.tables": "files.scene_files.tables",
    "scene_files.checking": "files.scene_files.checking",
    "scene_files.loading": "files.scene_files.loading",
    "scene_files.positions": "files.scene_files.positions",
    "scene_files.problems": "files.scene_files.problems",
    "scene_files.attempting": "files.scene_files.construction",
    "scene_files.moving": "files.scene_files.motion_building",
    "scene_files.acting": "files.scene_files.load_building",
    "scene_files.building": "files.scene_files.scene_building",
}


def module(name: str) -> ModuleType:
    """A module by its former name, without the package's."""
    return importlib.import_module(f"rollkane.{NEW[name]}")


class _Finder(MetaPathFinder):
    """Finds a module by its former name."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        del path, target
        package, _, name = fullname.partition(".")
        if package != "rollkane" or name not in NEW:
            return None
        return ModuleSpec(fullname, _Loader(name))


class _Loader(Loader):
    """Gives the module as it is, with the specification that it has."""

    def __init__(self, name: str):
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        del spec
        found = module(self._name)
        self._spec = found.__spec__
        return found

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec


def install() -> None:
    """Let Python's imports find former names, once.

    Before it looks into folders: in that of a package under its former name it would
    find its modules a second time.
    """
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
