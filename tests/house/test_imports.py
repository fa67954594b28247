"""Folders import one way, modules of a folder without a cycle, and all keep small."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src" / "rollkane"
# A folder imports those before it only.
FOLDERS = [
    "validation",
    "codegen",
    "geometry",
    "kinematics",
    "dynamics",
    "paper",
    "integration",
    "hybrid",
    "simulation",
    "kane",
    "identification",
    "stability",
    "studies",
    "files",
    "uncertainty",
    "pictures",
    "cli",
]
# Methods of a result that call a function of a folder behind it, imported when called.
METHODS = {
    ("identification.sensitivity", "files.sensitivity_dataset"),
    ("identification.sensitivity", "pictures.plot_sensitivity"),
    ("simulation.ensemble_result", "files.export_ensemble"),
    ("kane.motion", "pictures.plot_kane"),
    ("stability.linear_model", "pictures.plot_spectra"),
    ("stability.lyapunov", "pictures.plot_spectra"),
    ("stability.normal_modes", "pictures.plot_spectra"),
    ("stability.periodic", "pictures.plot_spectra"),
    ("stability.periodic_family", "pictures.plot_spectra"),
    ("stability.steady", "pictures.plot_spectra"),
    ("identification.experiment_design", "pictures.plot_indices"),
    ("identification.identifiability", "pictures.plot_indices"),
    ("uncertainty.active_directions", "pictures.plot_indices"),
    ("uncertainty.rare_event", "pictures.plot_indices"),
    ("uncertainty.sobol_result", "pictures.plot_indices"),
    ("simulation.ensemble_result", "pictures.plot_ensemble"),
    ("simulation.trajectory", "files.export"),
    ("simulation.trajectory", "pictures.plotting"),
    ("simulation.trajectory", "pictures.viewer"),
    ("studies.work_precision", "pictures.plot_precision"),
    ("identification.fit_result", "pictures.plot_fit"),
    ("identification.fit_result", "pictures.fit_page"),
    ("stability.branch", "pictures.plot_family"),
    ("uncertainty.result", "pictures.plot_study"),
}
# of the package itself: they know all folders
PUBLIC = {"__init__", "__main__", "moved_modules"}
FORBIDDEN = {"utils", "helpers", "common", "base", "core"}


def modules():
    found = {}
    for path in SOURCE.rglob("*.py"):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        if parts[0] not in PUBLIC:
            found[".".join(parts).removesuffix(".__init__")] = path
    return found


MODULES = modules()


def imports(name, path):
    """Modules that one imports, and whether inside of a function."""
    tree = ast.parse(path.read_text())
    package = name.split(".") if path.stem == "__init__" else name.split(".")[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            above = package[: len(package) - node.level + 1]
            source = ".".join([*above, *filter(None, [node.module])])
            for alias in node.names:
                full = f"{source}.{alias.name}" if source else alias.name
                target = full if full in MODULES else source
                if target in MODULES:
                    yield target, node not in tree.body


def folder(name):
    return name.split(".")[0]


def test_every_module_is_in_a_folder():
    assert {folder(name) for name in MODULES} == set(FOLDERS)


def test_folders_import_one_way():
    for name, path in MODULES.items():
        for target, inside in imports(name, path):
            if (name, target) in METHODS:
                assert inside, f"{name} imports {target} at its top"
            else:
                order = FOLDERS.index(folder(target)) - FOLDERS.index(folder(name))
                assert order <= 0, f"{name} imports {target}"


def test_no_cycles():
    graph = {
        name: {
            target
            for target, _ in imports(name, path)
            if (name, target) not in METHODS and target != name
        }
        for name, path in MODULES.items()
    }
    TopologicalSorter(graph).prepare()


def test_names_and_sizes():
    for name, path in MODULES.items():
        assert name.split(".")[-1] not in FORBIDDEN
        lines = path.read_text().splitlines()
        assert len(lines) <= 400, f"{name} has {len(lines)} lines: split by meaning"


def test_functions_are_short():
    long = []
    for name, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                size = body[-1].end_lineno - body[0].lineno + 1 if body else 0
                if size > 60:
                    long.append((name, node.name, size))
    assert not long


def test_checks_are_used():
    """An error_if whose result is dropped is removed under jit."""
    for name, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                assert not ast.unparse(node.value.func).endswith("error_if"), name


def test_hot_path_is_unrolled():
    """No library linear algebra where every step passes."""
    # of a body that is made, of a run that could not begin, of a start
    once = {f"dynamics.{name}" for name in ("bodies", "diagnosis", "placement")}
    hot = "geometry", "kinematics", "dynamics", "paper"
    for name, path in MODULES.items():
        if folder(name) in hot and name not in once:
            for call in ("jnp.linalg", "jnp.cross", "jnp.einsum"):
                assert call not in path.read_text(), f"{call} in {name}"
