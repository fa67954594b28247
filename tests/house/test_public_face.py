"""Public names are there, documented with shapes, units and source."""

import ast
import enum
import inspect
import operator
import re
from pathlib import Path

import pytest

import rollkane as rk

SOURCE = Path(__file__).parents[2] / "src" / "rollkane"

NAMES = {
    *("orientation_from_euler", "orientation_from_matrix", "orientation_from_scipy"),
    *("orientation_from_xyzw", "solid_body", "body_from_cad"),
    "VonMisesFisher",
    "LogNormal",
    "Normal",
    "Uniform",
    "UniformOrientation",
    "Empirical",
    "FitCovariance",
    "InertiaPerturbation",
    "Correlated",
    "MultivariateNormal",
    "Truncated",
    "ActiveDirections",
    "FunctionModel",
    "RareEvent",
    "SobolIndices",
    "active_directions",
    "sobol_indices",
    "subset_simulation",
    "NormalModes",
    "PeriodicFamily",
    "PeriodicMotion",
    "normal_mode_motion",
    "normal_modes",
    "periodic_family",
    "periodic_motion",
    "LyapunovSpectrum",
    "lyapunov_exponents",
    "Branch",
    "LinearModel",
    "SteadyMotion",
    "linearize",
    "Symmetries",
    "steady_family",
    "steady_motion",
    "switch_branch",
    "symmetries",
    "ExperimentDesign",
    "design_experiment",
    "negative_log_likelihood",
    "posterior",
    "Sensitivity",
    "sensitivity",
    "Accelerometer",
    "ContactPath",
    "Gyro",
    "Marker",
    "NormalForce",
    "Observed",
    "Orientation",
    "Position",
    "Fit",
    "fit",
    "Identifiability",
    "identifiability",
    "Free",
    "Tied",
    "Record",
    "Accelerogram",
    "BaseMotion",
    "PaperQuantities",
    "PointMasses",
    "Prescribed",
    "RecordedMotion",
    "Spin",
    "Equations",
    "RollingBody",
    "equations_of_motion",
    "with_feedback",
    "SupportedBody",
    "VoronetsState",
    "builtin_record",
    "contact_of",
    "CoulombFriction",
    "StribeckFriction",
    "ViscousFriction",
    "Crossings",
    "Drag",
    "Event",
    "Force",
    "Potential",
    "Torque",
    "RollingResistance",
    "SpinningResistance",
    "RubberRolling",
    "Slipping",
    "SlidingState",
    "FlyingState",
    "Keeping",
    "keeping_energy",
    "Mode",
    "Modes",
    "Switches",
    "release",
    "Ensemble",
    "Measured",
    "Setting",
    "WorkPrecision",
    "recommend",
    "work_precision",
    "ensemble",
    "ensemble_blocks",
    "euler_lagrange_derivative",
    "kane",
    "paper_quantities",
    "read_at2",
    "read_record",
    "read_single_column",
    "read_two_column",
    "read_v2a",
    "to_pole_free",
    "to_voronets",
    "Base",
    "Body",
    "Code",
    "Cone",
    "Cylinder",
    "DiscEdge",
    "Ellipsoid",
    "FieldError",
    "Graph",
    "Gravity",
    "Implicit",
    "LocalGeometry",
    "Parametric",
    "Plane",
    "Revolution",
    "Ring",
    "Rolling",
    "Scene",
    "Sphere",
    "State",
    "Torus",
    "Trajectory",
    "Evaluated",
    "MonteCarlo",
    "Precision",
    "Statistics",
    "StoreError",
    "Study",
    "load_study",
    "monte_carlo",
    "read_study",
    "place",
    "rolling_along",
    "rolling_derivative",
    "rolling_kinematics",
    "rolling_path",
    "RollingKinematics",
    "simulate",
}
FIELDS = {
    "time": "[s]",
    "position": "[m]",
    "velocity": "[m/s]",
    "orientation": "[1]",
    "angular_velocity": "[rad/s]",
    "contact_on_body": "[m]",
    "contact_on_base": "[m]",
    "contact_force": "[N]",
    "normal_force": "[N]",
    "energy": "[J]",
    "alpha": "",
    "alpha_dot": "",
}


def test_the_list_of_names_is_frozen():
    assert set(rk.__all__) == NAMES
    for name in NAMES:
        assert getattr(rk, name) is not None
        assert name in dir(rk)


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute"):
        _ = rk.Sphare


def test_importing_changes_no_setting():
    text = (SOURCE / "__init__.py").read_text()
    assert "config" not in text
    for path in SOURCE.rglob("*.py"):
        if path.parent.name != "cli" and "jax.config.update" in path.read_text():
            # only as advice in a message
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Call):
                    assert ast.unparse(node.func) != "jax.config.update", path.name


WITHOUT_UNITS = ("Plane", "Rolling", "RubberRolling", "Slipping", "Scene", "Base")
WITHOUT_UNITS += ("Code", "FieldError", "StoreError", "Keeping", "Mode")
KANE = {
    name
    for name, thing in vars(rk.kane).items()
    if not name.startswith("_") and callable(thing)
}


PUBLIC = [*sorted(NAMES - {"kane"}), *(f"kane.{name}" for name in sorted(KANE))]


@pytest.mark.parametrize("name", PUBLIC)
def test_docstrings_carry_units_and_arguments(name):
    thing = operator.attrgetter(name)(rk)
    text = inspect.getdoc(thing) or ""
    if inspect.isclass(thing) and "__init__" in vars(thing):
        text += "\n" + (inspect.getdoc(thing.__init__) or "")
    assert text
    # how a number makes a member of an enumeration is Python's own
    is_enum = isinstance(thing, enum.EnumMeta)
    arguments = () if is_enum else inspect.signature(thing).parameters
    for argument in arguments:
        if argument not in ("self", "args", "kwargs"):
            assert re.search(rf"\b{argument}\b", text), f"{name}: {argument}"
    if name not in WITHOUT_UNITS:
        assert re.search(r"\[[^\]]*\]", text), f"{name} says no unit"


@pytest.mark.parametrize("field", FIELDS)
def test_trajectory_fields(field):
    documented = inspect.getdoc(getattr(rk.Trajectory, field, None)) or ""
    text = documented + "\n" + inspect.getdoc(rk.Trajectory)
    assert FIELDS[field] in text
    assert "shape (T" in text


def test_public_functions_have_docstrings():
    missing = []
    for path in SOURCE.rglob("*.py"):
        tree = ast.parse(path.read_text())
        assert ast.get_docstring(tree), path.name
        public = [n for n in tree.body if _is_public(n)]
        for node in list(public):
            if isinstance(node, ast.ClassDef):
                public += [n for n in node.body if _is_public(n)]
        missing += [(path.name, n.name) for n in public if not ast.get_docstring(n)]
    assert not missing


def _is_public(node):
    kinds = (ast.FunctionDef, ast.ClassDef)
    return isinstance(node, kinds) and not node.name.startswith("_")


def test_mechanics_names_its_equations():
    modules = {
        "geometry": ("local_geometry",),
        "kinematics": ("contact", "voronets"),
        "dynamics": ("bodies", "mass_matrix", "placement", "rolling", "supported"),
        "paper": ("quasi_velocities", "quasi_energy", "euler_lagrange"),
    }
    for folder, names in modules.items():
        for name in names:
            text = (SOURCE / folder / f"{name}.py").read_text()
            assert re.search(r"Source: (docs/theory|\[A\])", text), name
