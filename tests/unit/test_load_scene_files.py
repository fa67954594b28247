"""Contact laws, loads and modes in scene files."""

import inspect

import jax
import numpy as np
import pytest
from click.testing import CliRunner

import rollkane as rk
from rollkane.cli import main
from rollkane.files.scene_files import SceneFileError, load_scene, scene_schema
from rollkane.files.scene_files.load_tables import CONTACTS, LOADS, ModesTable

BALL = """\
title = "a bowling ball"
[body]
mass = 6.0
inertia = [[0.02904, 0, 0], [0, 0.02904, 0], [0, 0, 0.02904]]
surface = { kind = "sphere", radius = 0.11 }
[start]
orientation = [1.0, 0.0, 0.0, 0.0]
angular_velocity = [0, 0, 0]
slip = [8.0, 0.0, 0.0]
[run]
duration = 2.0
outputs = 3
rtol = 1e-10
"""
MODES = "[modes]\nfriction = 0.2\nrestitution = 0.5\n"


def write(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


LAWS = {
    "rubber": ("", rk.RubberRolling()),
    "viscous": ("coefficient = 2.0", rk.Slipping(rk.ViscousFriction(2.0))),
    "coulomb": ("coefficient = 0.3", rk.Slipping(rk.CoulombFriction(0.3))),
    "stribeck": (
        "static = 0.3\nkinetic = 0.2\nspeed = 0.1",
        rk.Slipping(rk.StribeckFriction(0.3, 0.2, 0.1)),
    ),
}


@pytest.mark.parametrize("kind", LAWS)
def test_contact_laws(kind, tmp_path):
    numbers, expected = LAWS[kind]
    text = BALL.replace("slip = [8.0, 0.0, 0.0]\n", "") if kind == "rubber" else BALL
    text += f'[contact]\nkind = "{kind}"\n{numbers}\n'
    file = load_scene(write(tmp_path, text))
    found = file.scene.contact
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)
    assert file.modes is None
    if kind != "rubber":
        np.testing.assert_array_equal(file.start.slip, [8.0, 0.0, 0.0])


def test_loads(tmp_path):
    text = (
        BALL
        + MODES
        + """
[[loads]]
kind = "gravity"
[[loads]]
kind = "drag"
linear = 0.1
angular = 0.2
point = [0, 0, 0.05]
[[loads]]
kind = "rolling-resistance"
dry = 0.001
[[loads]]
kind = "spinning-resistance"
viscous = 0.02
"""
    )
    found = load_scene(write(tmp_path, text)).scene.loads
    expected = (
        rk.Gravity(),
        rk.Drag(0.1, angular=0.2, point=(0, 0, 0.05)),
        rk.RollingResistance(dry=0.001),
        rk.SpinningResistance(viscous=0.02),
    )
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_the_command_line_changes_modes(tmp_path):
    """It grips at 2 v / (7 mu g), as from Python."""
    path = write(tmp_path, BALL + MODES)
    file = load_scene(path)
    assert float(file.modes.friction) == 0.2
    done = CliRunner().invoke(main, ["simulate", str(path)])
    assert done.exit_code == 0, done.output
    assert "slips -> rolls at t = 1.16499 s" in done.output


BAD = {
    "unknown kind": (
        '[contact]\nkind = "columb"\ncoefficient = 0.2',
        ("contact.kind", "is not a known kind", "coulomb"),
    ),
    "negative friction": (
        '[contact]\nkind = "coulomb"\ncoefficient = -0.2',
        ("contact.coefficient", "must not be negative", ""),
    ),
    "missing speed": (
        '[contact]\nkind = "stribeck"\nstatic = 1\nkinetic = 1',
        ("contact.speed", "is missing", "positive"),
    ),
    "unknown name": (
        "[modes]\nfrictoin = 0.2",
        ("modes.frictoin", "is an unknown name", "friction"),
    ),
    "negative restitution": (
        "[modes]\nrestitution = -1",
        ("modes.restitution", "must not be negative", ""),
    ),
    "bad load": (
        '[modes]\n[[loads]]\nkind = "drag"\nlinear = -1',
        ("loads[0].linear", "must not be negative", ""),
    ),
    "a law of slipping beside modes": (
        '[contact]\nkind = "viscous"\ncoefficient = 5.0\n[modes]\nfriction = 0.2',
        ("contact", "where [modes] are theirs alone acts", "leave out"),
    ),
    "a slip of a body that rolls": (
        "",
        ("start.slip", "follows from the angular velocity", ""),
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_refused(case, tmp_path):
    text, (field, problem, remedy) = BAD[case]
    with pytest.raises(SceneFileError) as caught:
        load_scene(write(tmp_path, BALL + text + "\n"))
    (found,) = (p for p in caught.value.problems if p.field == field)
    assert problem in found.problem
    assert remedy in found.remedy
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize("tables", [LOADS, CONTACTS])
def test_defaults_are_those_of_the_constructors(tables):
    pairs = [(table, table.made_by()) for table in tables.values()]
    for table, make in [*pairs, (ModesTable, rk.Modes)]:
        given = {n: f for n, f in table.model_fields.items() if n != "kind"}
        known = inspect.signature(make).parameters
        assert given.keys() == known.keys()
        for name, field in given.items():
            assert field.is_required() == (known[name].default is inspect._empty)
            if not field.is_required():
                assert np.array_equal(field.default, known[name].default) or (
                    field.default is None and known[name].default is None
                )


def test_schema_knows_them():
    schema = scene_schema()
    assert {"contact", "modes"} <= set(schema["properties"])
    assert "slip" in schema["$defs"]["StartTable"]["properties"]
