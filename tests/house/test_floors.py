"""Imports run down the floors only, and rooms keep to a room's size."""

import ast
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src" / "rollkane"

# A room may import only rooms that stand before it. Folders are rooms of several files,
# whose own order follows.
LADDER = [
    # 0 geometry
    "checks",
    "codes",
    "one_call",
    "small_linear",
    "rearrangements",
    "numberwise",
    "rotations",
    "user_function",
    "geometry",
    "surfaces",
    # 1 contact
    "base_motion",
    "recorded_motion",
    "contact",
    "coordinates",
    "voronets",
    "quasi_velocities",
    # 2 mechanics
    "bodies",
    "carried_functions",
    "supported",
    "loads",
    "friction",
    "directed_friction",
    "resistance",
    "scene",
    "mass_matrix",
    "contact_laws",
    "rolling",
    "observables",
    "state_conversion",
    "quasi_energy",
    "euler_lagrange",
    # 3 motion
    "consistency",
    "clearance",
    "refused_placements",
    "placement",
    "separation",
    "modes",
    "tableau",
    "impact_process",
    "impacts",
    "native",
    "hidden_events",
    "mode_changes",
    "root_search",
    "keeping",
    "steps",
    "differentiate",
    "replay",
    "mode_replay",
    "mode_adjoint",
    "diagnosis",
    "trajectory",
    "rolling_run",
    "solving",
    "integration",
    "methods",
    "members",
    "lane_blocks",
    "flight_watch",
    "mode_loop",
    "hybrid",
    "simulation",
    "kane",
    # 4 studies
    "ensembles",
    "timed_runs",
    "precision",
    # 5 outside
    "accelerogram_lines",
    "accelerogram_units",
    "accelerogram_headers",
    "accelerogram_v2a",
    "accelerograms",
    "whole_file",
    "history",
    "mesh",
    "plot_style",
    "plot_path",
    "plot_precision",
    "plotting",
    "viewer",
    "export",
    "scene_files",
    "summary",
    "cli",
]
INSIDE = {
    "surfaces": [
        "directions",
        "kinds",
        "edges",
        "catalogue",
        "cone",
        "given",
        "revolution",
    ],
    "native": [
        "cache",
        "compiler",
        "listing",
        "right_hand_side",
        "step_source",
        "xla_call",
        "derivatives",
        "lanes",
        "runs",
        "scalars",
        "writer",
        "memory",
        "array_operations",
        "indexed_operations",
        "structured",
        "whole",
    ],
    "kane": [
        "system",
        "equations",
        "affinity",
        "configuration",
        "refusals",
        "linearization",
        "motion",
        "ready",
        "bicycle",
        "rolling_scene",
    ],
    "scene_files": [
        "positions",
        "problems",
        "formulas",
        "table_types",
        "moving_tables",
        "load_tables",
        "tables",
        "checking",
        "attempting",
        "moving",
        "acting",
        "building",
        "loading",
    ],
}
FORBIDDEN = {"utils", "helpers", "common", "base", "core"}
# A trajectory's methods hand it to the floor above, when and only when they are called.
UPWARDS = {
    ("precision", "plot_precision"),
    ("trajectory", "export"),
    ("trajectory", "plotting"),
    ("trajectory", "viewer"),
}


def rooms():
    return [p for p in SOURCE.rglob("*.py") if p.name != "__init__.py"]


def place(path: Path) -> tuple[str, str | None]:
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return (parts[0], None) if len(parts) == 1 else (parts[0], parts[1])


def imports(path: Path):
    """Rooms that a file imports, as (room, inner room or None, inside a function)."""
    tree = ast.parse(path.read_text())
    top = set(tree.body)
    room, inner = place(path)
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or not node.level:
            continue
        names = (node.module or "").split(".") if node.module else []
        local = node not in top
        if inner is not None and node.level == 1:
            targets = [names[0]] if names else [a.name for a in node.names]
            yield from ((room, target, local) for target in targets)
        elif names:
            yield names[0], names[1] if len(names) > 1 else None, local
        else:
            yield from ((a.name, None, local) for a in node.names)


def test_every_room_stands_on_a_floor():
    found = {place(p)[0] for p in rooms()}
    assert found == set(LADDER)
    for folder, order in INSIDE.items():
        assert {place(p)[1] for p in rooms() if place(p)[0] == folder} == set(order)


def test_no_arrow_runs_up_or_round():
    wrong = []
    for path in rooms():
        room, inner = place(path)
        for target, target_inner, _ in imports(path):
            if target == room and inner is not None:
                order = INSIDE[room]
                if target_inner in order and order.index(target_inner) >= order.index(
                    inner
                ):
                    wrong.append((f"{room}.{inner}", f"{target}.{target_inner}"))
            elif target in LADDER and LADDER.index(target) >= LADDER.index(room):
                wrong += {(room, target)} - UPWARDS
    assert not wrong


def test_upward_arrows_are_inside_functions():
    for path in rooms():
        room, _ = place(path)
        for target, _, local in imports(path):
            if (room, target) in UPWARDS:
                assert local, f"{room} imports {target} at its top"


def test_names_and_sizes():
    for path in rooms():
        assert path.stem not in FORBIDDEN
        lines = path.read_text().splitlines()
        assert len(lines) <= 450, (
            f"{path.name} has {len(lines)} lines: split by meaning"
        )


def test_functions_are_short():
    long = []
    for path in rooms():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                body = node.body
                if ast.get_docstring(node):
                    body = body[1:]
                size = body[-1].end_lineno - body[0].lineno + 1 if body else 0
                if size > 60:
                    long.append((path.name, node.name, size))
    assert not long


def test_checks_are_used():
    """An error_if whose result is dropped is removed under jit."""
    for path in rooms():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                assert not ast.unparse(node.value.func).endswith("error_if"), path.name


def test_hot_path_is_unrolled():
    """No library linear algebra where every step passes (design, section 4)."""
    hot = LADDER[LADDER.index("small_linear") : LADDER.index("placement")]
    for path in rooms():
        if place(path)[0] in hot and path.stem not in ("bodies", "user_function"):
            text = path.read_text()
            for call in ("jnp.linalg", "jnp.cross", "jnp.einsum"):
                assert call not in text, f"{call} in {path.name}"
