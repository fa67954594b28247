"""Scene files: every bad field is refused with its file, line, value and remedy."""

import inspect
import re
import tomllib
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.dynamics.loads import Gravity
from rollkane.files.scene_files import (
    SceneFileError,
    builtin_scenes,
    load_scene,
    scene_schema,
)
from rollkane.files.scene_files.formulas import Formula, FormulaError, parse
from rollkane.files.scene_files.load_tables import LOADS
from rollkane.files.scene_files.positions import line_and_column, positions
from rollkane.files.scene_files.tables import SURFACES

GOOD = """\
title = "a ball"

[body]
mass = 1.0
center_of_mass = [0.0, 0.0, 0.0]
inertia = [
    [0.004, 0.0, 0.0],
    [0.0, 0.004, 0.0],
    [0.0, 0.0, 0.004],
]
[body.surface]
kind = "sphere"
radius = 0.1
[base]
surface = { kind = "plane" }
[[loads]]
kind = "gravity"
acceleration = [0, 0, -9.81]
[start]
orientation = [1.0, 0.0, 0.0, 0.0]
angular_velocity = [0, 5, 2]
contact_on_base = [0.0, 0.0, 0.0]
[run]
duration = 1.0
outputs = 11
rtol = 1e-8
"""
SPHERE = 'kind = "sphere"\nradius = 0.1'
PLANE = '{ kind = "plane" }'
INERTIA = re.search(r"inertia = \[\n.*?\n\]", GOOD, re.S)[0]


def write(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def refused(tmp_path, text):
    with pytest.raises(SceneFileError) as caught:
        load_scene(write(tmp_path, text))
    for problem in caught.value.problems:
        assert str(problem) in str(caught.value)
        assert problem.file == str(tmp_path / "scene.toml")
        assert problem.remedy
    return caught.value.problems


def changed(old, new):
    assert GOOD.count(old) == 1, old
    return GOOD.replace(old, new)


def surface(text):
    return SPHERE, text


def base(text):
    return PLANE, text


# what is replaced, by what; field, text of its line, problem, value, remedy
OVERLAP = """
[body]
mass = 1.0
inertia = [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]]
surface = { kind = "ellipsoid", semi_axes = [0.3, 0.05, 0.05] }
[base]
surface = { kind = "torus", major_radius = 1.0, minor_radius = 0.2, inside = true }
[start]
rotations = [["y", -90]]
angular_velocity = [0, 0, 1]
contact_on_base = [1.0, 0.0, -0.2]
[run]
duration = 0.1
"""
BAD_FIELDS = {
    "text for a number": (
        ("mass = 1.0", 'mass = "1.0"'),
        ("body.mass", 'mass = "1.0"', "must be a number", '"1.0"', "the mass [kg]"),
    ),
    "truth for a number": (
        ("mass = 1.0", "mass = true"),
        ("body.mass", "mass = true", "must be a number", "true", "the mass [kg]"),
    ),
    "negative mass": (
        ("mass = 1.0", "mass = -1.0"),
        ("body.mass", "mass = -1.0", "must be positive", "-1.0", "the mass in kg"),
    ),
    "mass zero": (
        ("mass = 1.0", "mass = 0"),
        ("body.mass", "mass = 0", "must be positive", "0", "the mass in kg"),
    ),
    "mass nan": (
        ("mass = 1.0", "mass = nan"),
        ("body.mass", "mass = nan", "must be finite", "nan", "the mass [kg]"),
    ),
    "mass infinite": (
        ("mass = 1.0", "mass = inf"),
        ("body.mass", "mass = inf", "must be finite", "inf", "the mass [kg]"),
    ),
    "mass of 400 digits": (
        ("mass = 1.0", "mass = " + "1" * 400),
        ("body.mass", "mass = 11", "must be a number", "11", "the mass [kg]"),
    ),
    "mass missing": (
        ("mass = 1.0\n", ""),
        ("body.mass", "[body]", "is missing", None, "add mass = ...: the mass [kg]"),
    ),
    "center_of_mass of two": (
        ("center_of_mass = [0.0, 0.0, 0.0]", "center_of_mass = [0.0, 0.0]"),
        ("body.center_of_mass", "center_of_mass", "3 entries, not 2", "[0.0, 0.0]", ""),
    ),
    "center_of_mass with text": (
        ("center_of_mass = [0.0, 0.0, 0.0]", 'center_of_mass = [0.0, "a", 0.0]'),
        ("body.center_of_mass[1]", "center_of_mass", "must be a number", '"a"', "[m]"),
    ),
    "inertia not symmetric": (
        ("    [0.004, 0.0, 0.0]", "    [0.004, 0.001, 0.0]"),
        ("body.inertia", "inertia = [", "symmetric", "0.001", "entry (i, j) equal"),
    ),
    "inertia not positive": (
        ("    [0.004, 0.0, 0.0]", "    [-0.004, 0.0, 0.0]"),
        ("body.inertia", "inertia = [", "positive definite", "-0.004", "signs"),
    ),
    "inertia against the triangle": (
        ("    [0.004, 0.0, 0.0]", "    [0.009, 0.0, 0.0]"),
        ("body.inertia", "inertia = [", "triangle inequality", "0.009", "units"),
    ),
    "inertia of two rows": (
        ("    [0.0, 0.0, 0.004],\n", ""),
        ("body.inertia", "inertia = [", "3 entries, not 2", "[[0.004", "[kg m^2]"),
    ),
    "inertia with a short row": (
        ("    [0.0, 0.004, 0.0]", "    [0.0, 0.004]"),
        ("body.inertia[1]", "[0.0, 0.004]", "3 entries, not 2", "[0.0, 0.004]", "3 x"),
    ),
    "inertia a number": (
        (INERTIA, "inertia = 0.004"),
        ("body.inertia", "inertia = 0.004", "must be a list", "0.004", "3 x 3"),
    ),
    "unknown name": (
        ("center_of_mass =", "centre_of_mass ="),
        ("body.centre_of_mass", "centre_of", "unknown name", None, "center_of_mass?"),
    ),
    "unknown table": (
        ("[run]", "[runs]"),
        ("runs", "[runs]", "unknown name", None, "did you mean run?"),
    ),
    "unknown kind": (
        surface('kind = "spere"\nradius = 0.1'),
        ("body.surface.kind", 'kind = "spere"', "known kind", '"spere"', "sphere?"),
    ),
    "kind a number": (
        surface("kind = 3\nradius = 0.1"),
        ("body.surface.kind", "kind = 3", "known kind", "3", "use one of: plane"),
    ),
    "kind missing": (
        surface("radius = 0.1"),
        ("body.surface.kind", "[body.surface]", "is missing", None, "one of: plane"),
    ),
    "surface as text": (
        base('"plane"'),
        ("base.surface", 'surface = "plane"', "a table", '"plane"', "kind ="),
    ),
    "radius": (
        surface('kind = "sphere"\nradius = -0.1'),
        ("body.surface.radius", "radius = -0.1", "positive", "-0.1", "in metres"),
    ),
    "center": (
        surface(SPHERE + "\ncenter = 0.0"),
        ("body.surface.center", "center = 0.0", "must be a list", "0.0", "lengths"),
    ),
    "inside": (
        surface(SPHERE + '\ninside = "no"'),
        ("body.surface.inside", "inside =", "true or false", '"no"', "give true where"),
    ),
    "semi_axes": (
        surface('kind = "ellipsoid"\nsemi_axes = [0.1, 0.0, 0.1]'),
        ("body.surface.semi_axes", "semi_axes", "positive", "[0.1, 0.0", "in metres"),
    ),
    "major_radius": (
        surface('kind = "torus"\nmajor_radius = 0\nminor_radius = 0.1'),
        ("body.surface.major_radius", "major_radius = 0", "positive", "0", "in metres"),
    ),
    "minor_radius": (
        surface('kind = "torus"\nmajor_radius = 0.1\nminor_radius = 0.2'),
        ("body.surface.minor_radius", "minor", "smaller than the", "0.2", "thinner"),
    ),
    "cylinder": (
        surface('kind = "cylinder"\nradius = 0'),
        ("body.surface.radius", "radius = 0", "positive", "0", "in metres"),
    ),
    "disc-edge": (
        surface('kind = "disc-edge"\nradius = -1'),
        ("body.surface.radius", "radius = -1", "positive", "-1", "in metres"),
    ),
    "slope": (
        base('{ kind = "cone", slope = 0 }'),
        ("base.surface.slope", "slope = 0", "must not be zero", "0", "Plane()"),
    ),
    "formula": (
        base('{ kind = "graph", f = "x**2 + z" }'),
        ("base.surface.f", "x**2 + z", "unknown name z", "x**2", "use one of: x, y"),
    ),
    "formula a number": (
        base('{ kind = "graph", f = 1.0 }'),
        ("base.surface.f", "f = 1.0", "must be text", "1.0", "a formula in x and y"),
    ),
    "formula that divides by zero": (
        base('{ kind = "graph", f = "x + 1/(1 - 1)" }'),
        (
            "base.surface.f",
            "x + 1/(1",
            "holds 1 / (1 - 1), which is not a finite real number",
            "1/(1 - 1)",
            "leave it out",
        ),
    ),
    "parameter": (
        base('{ kind = "graph", f = "a*x", parameters = { a = "1" } }'),
        ("base.surface.parameters.a", "a = ", "must be a number", '"1"', "numbers"),
    ),
    "parameter with a coordinate's name": (
        base('{ kind = "graph", f = "x", parameters = { x = 1 } }'),
        ("base.surface.parameters.x", "x = 1", "is taken", None, "another name"),
    ),
    "domain": (
        base('{ kind = "graph", f = "x", domain = [[0, 1], [1, 0]] }'),
        ("base.surface.domain", "domain", "low < high", "[[0, 1], [1, 0]]", "order"),
    ),
    "height": (
        surface('kind = "revolution"\nradius = "sin(s)"\nheight = "-coss(s)"'),
        ("body.surface.height", "height", "calls coss", "coss", "did you mean cos?"),
    ),
    "parametric": (
        surface('kind = "parametric"\nx = "q1"\ny = "q2"\nz = "q3"'),
        ("body.surface.z", 'z = "q3"', "unknown name q3", '"q3"', "use one of: q1"),
    ),
    "size": (
        surface('kind = "implicit"\nf = "x**2 + y**2 + z**2 - 1"\nsize = 0'),
        ("body.surface.size", "size = 0", "must be positive", "0", "in metres"),
    ),
    "kind of load": (
        ('kind = "gravity"', 'kind = "gravitation"'),
        ("loads[0].kind", "gravitation", "known kind", '"gravitation"', "gravity?"),
    ),
    "acceleration": (
        ("[0, 0, -9.81]", "[0, 0, nan]"),
        ("loads[0].acceleration[2]", "nan", "must be finite", "nan", "[m/s^2]"),
    ),
    "acceleration a number": (
        ("[0, 0, -9.81]", "-9.81"),
        ("loads[0].acceleration", "-9.81", "must be a list", "-9.81", "three comp"),
    ),
    "orientation not of unit length": (
        ("[1.0, 0.0, 0.0, 0.0]", "[1.0, 1.0, 0.0, 0.0]"),
        ("start.orientation", "orientation", "unit length", "[1.0, 1.0", "divide it"),
    ),
    "orientation zero": (
        ("[1.0, 0.0, 0.0, 0.0]", "[0, 0, 0, 0]"),
        ("start.orientation", "orientation", "unit length", "[0, 0, 0, 0]", "divide"),
    ),
    "orientation a matrix": (
        ("[1.0, 0.0, 0.0, 0.0]", "[[1.0], 0.0, 0.0, 0.0]"),
        ("start.orientation[0]", "[[1.0]", "must be a number", "[1.0]", "quaternion"),
    ),
    "orientation twice": (
        ("orientation = [1.0", 'rotations = [["x", 1]]\norientation = [1.0'),
        ("start.rotations", "rotations", "same as orientation", None, "leave out"),
    ),
    "orientation missing": (
        ("orientation = [1.0, 0.0, 0.0, 0.0]\n", ""),
        ("start.orientation", "[start]", "is missing", None, "or rotations = ..."),
    ),
    "unknown axis": (
        ("orientation = [1.0, 0.0, 0.0, 0.0]", 'rotations = [["w", 1]]'),
        ("start.rotations[0][0]", '"w"', "is not a known name", '"w"', "x, y, z"),
    ),
    "turn without angle": (
        ("orientation = [1.0, 0.0, 0.0, 0.0]", 'rotations = [["x"]]'),
        ("start.rotations[0]", '["x"]', "must have 2 entries", '["x"]', "degrees"),
    ),
    "angular_velocity": (
        ("[0, 5, 2]", "[0, 5]"),
        ("start.angular_velocity", "[0, 5]", "3 entries, not 2", "[0, 5]", "rad/s"),
    ),
    "angular_velocity missing": (
        ("angular_velocity = [0, 5, 2]\n", ""),
        ("start.angular_velocity", "[start]", "is missing", None, "_body = ..."),
    ),
    "angular_velocity twice": (
        ("[0, 5, 2]", "[0, 5, 2]\nangular_velocity_body = [0, 5, 2]"),
        ("start.angular_velocity_body", "_body", "same as angular", None, "leave out"),
    ),
    "contact off the base": (
        ("contact_on_base = [0.0, 0.0, 0.0]", "contact_on_base = [0.0, 0.0, 0.5]"),
        ("start.contact_on_base", "contact", "is off the base", "0.5]", "a point of"),
    ),
    "contact as text": (
        ("contact_on_base = [0.0, 0.0, 0.0]", 'contact_on_base = "here"'),
        ("start.contact_on_base", "here", "must be a list", '"here"', "base axes [m]"),
    ),
    "base_normal": (
        ("contact_on_base =", "base_normal = 1\ncontact_on_base ="),
        ("start.base_normal", "base_normal", "must be a list", "1", "outward normal"),
    ),
    "body that cannot touch": (
        surface('kind = "cone"\nslope = 1.0'),
        ("start.orientation", "orientation", "cannot touch", "[1.0, 0.0", "turn the"),
    ),
    "surfaces that fit": (
        base('{ kind = "sphere", radius = 0.1, inside = true, center = [0, 0, 0.1] }'),
        ("start.contact_on_base", "contact", "fit each other", "0.0", "turn the body"),
    ),
    "body that cuts into the base": (
        base('{ kind = "sphere", radius = 0.05, inside = true, center = [0,0,0.05] }'),
        ("start.contact_on_base", "contact", "would cut into", "0.0", "smaller body"),
    ),
    "duration": (
        ("duration = 1.0", "duration = 0"),
        ("run.duration", "duration = 0", "must be positive", "0", "the time it lasts"),
    ),
    "outputs not whole": (
        ("outputs = 11", "outputs = 11.0"),
        ("run.outputs", "outputs = 11.0", "whole number", "11.0", "two or more"),
    ),
    "outputs too few": (
        ("outputs = 11", "outputs = 1"),
        ("run.outputs", "outputs = 1", "must be 2 or more", "1", "two or more"),
    ),
    "rtol negative": (
        ("rtol = 1e-8", "rtol = -1e-8"),
        ("run.rtol", "rtol = -1e-8", "must be positive", "-1e-08", "such as 1e-9"),
    ),
    "rtol of nothing": (
        ("rtol = 1e-8", "rtol = 10.0"),
        ("run.rtol", "rtol = 10.0", "is above 0.1: it leaves no digit", "10.0", "1e-9"),
    ),
    "base in two brackets": (  # was: an AttributeError
        ("[base]", "[[base]]"),
        ("base", "[[base]]", "must be a table", "surface", "a table [base]"),
    ),
    "second contact": (
        ("rtol = 1e-8", 'rtol = 1e-8\nsecond_contact = "yes"'),
        (
            "run.second_contact",
            'second_contact = "yes"',
            "must be true or false",
            "yes",
            "give true",
        ),
    ),
    "rtol below rounding": (
        ("rtol = 1e-8", "rtol = 1e-20"),
        ("run.rtol", "rtol = 1e-20", "below what float64", "1e-20", "or more"),
    ),
    "atol": (
        ("rtol = 1e-8", "atol = inf"),
        ("run.atol", "atol = inf", "must be finite", "inf", "such as 1e-11"),
    ),
    "title": (
        ('title = "a ball"', "title = 3"),
        ("title", "title = 3", "must be text", "3", "a line of text"),
    ),
}


@pytest.mark.parametrize("case", BAD_FIELDS)
def test_bad_field(case, tmp_path):
    (old, new), (field, line, problem, value, remedy) = BAD_FIELDS[case]
    text = changed(old, new)
    found = [p for p in refused(tmp_path, text) if p.field == field]
    assert len(found) == 1
    (found,) = found
    assert line in text.split("\n")[found.line - 1] == found.source_line
    assert problem in found.problem
    assert (value is None) == (found.value is None)
    assert value is None or value in found.value
    assert remedy in found.remedy
    head, source, caret = str(found).split("\n")
    where = f"scene.toml:{found.line}:{found.column}: error: {field}: "
    assert where in head
    assert source.strip() == found.source_line.strip()
    assert caret == " " * (4 + found.column - 1) + "^"


def test_a_good_file(tmp_path):
    file = load_scene(write(tmp_path, GOOD))
    assert (file.title, file.name, file.rtol, file.atol) == (
        "a ball",
        "scene",
        1e-8,
        None,
    )
    np.testing.assert_array_equal(file.times, np.linspace(0, 1, 11))
    assert file.scene.body.mass == 1.0
    np.testing.assert_array_equal(file.scene.loads[0].acceleration, [0, 0, -9.81])
    np.testing.assert_array_equal(file.start.angular_velocity, [0, 5, 2])


def test_all_errors_at_once(tmp_path):
    text = """\
spead = 3
[body]
mass = -1.0
center_of_mass = [0.0, 0.0]
inertia = [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 9.0]]
[body.surface]
kind = "elipsoid"
semi_axis = [1, 2, "3"]
semi_axes = [1, -2, 3]
inside = 0
[base.surface]
kind = "graph"
f = "0.3*x^2"
parameters = { b = "2" }
[[loads]]
kind = "gravity"
acceleration = [0, nan, 0]
[[loads]]
kind = "gravitation"
[start]
orientation = [1, 1, 0, 0]
contact_on_base = "here"
[run]
duration = 0
rtol = 1e-30
"""
    found = [(p.line, p.field) for p in refused(tmp_path, text)]
    assert found == [
        (1, "spead"),
        (3, "body.mass"),
        (4, "body.center_of_mass"),
        (5, "body.inertia"),
        (7, "body.surface.kind"),
        (8, "body.surface.semi_axis"),
        (9, "body.surface.semi_axes"),
        (10, "body.surface.inside"),
        (13, "base.surface.f"),
        (14, "base.surface.parameters.b"),
        (17, "loads[0].acceleration[1]"),
        (19, "loads[1].kind"),
        (20, "start.angular_velocity"),
        (21, "start.orientation"),
        (22, "start.contact_on_base"),
        (24, "run.duration"),
        (25, "run.rtol"),
    ]


def test_both_bad_numbers_of_one_surface(tmp_path):
    text = changed(*surface('kind = "torus"\nmajor_radius = -1\nminor_radius = 0'))
    fields = [p.field for p in refused(tmp_path, text)]
    assert fields == ["body.surface.major_radius", "body.surface.minor_radius"]


def test_missing_tables(tmp_path):
    found = refused(tmp_path, 'title = "empty"\n')
    assert [p.field for p in found] == ["body", "start", "run"]
    assert [p.remedy.split(":")[0] for p in found] == [
        "add [body]",
        "add [start]",
        "add [run]",
    ]


@pytest.mark.parametrize(
    ("text", "line", "column", "problem"),
    [
        ("[body\nmass = 1\n", 1, 6, "Expected ']'"),
        ("[body]\nmass = \n", 2, 8, "Invalid value"),
        ("[body]\nmass = 1\nmass = 2\n", 3, 9, "Cannot overwrite"),
        ("a = [1, 2\n", 1, 10, "Unclosed array"),
        ("a = " + "[" * 5000, 1, 1, "nested too deeply"),
    ],
)
def test_not_toml(tmp_path, text, line, column, problem):
    (found,) = refused(tmp_path, text)
    assert problem in found.problem
    assert (found.line, found.column) == (line, column)


def test_not_utf8(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_bytes(b'title = "a"\n# caf\xe9\n')
    with pytest.raises(
        SceneFileError, match=r":2:6: error: .* not UTF-8, got byte 0xe9"
    ):
        load_scene(path)


def test_no_such_file(tmp_path):
    with pytest.raises(SceneFileError, match="did you mean rattleback") as caught:
        load_scene("ratleback")
    assert "error: cannot read the scene" in str(caught.value)
    with pytest.raises(SceneFileError, match="cannot read the scene"):
        load_scene(tmp_path)


def test_windows_line_ends_and_byte_order_mark(tmp_path):
    path = tmp_path / "scene.toml"
    text = changed("mass = 1.0", "mass = -1.0")
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    with pytest.raises(SceneFileError, match=r"scene.toml:4:8: error: body.mass"):
        load_scene(path)


def test_positions_of_every_form():
    text = """\
a.b = 1  # dotted
"quoted key" = 'x # no comment'
[t."u.v"]
w = [1, [2,
    3], { k = "}" }]
m = \"\"\"
 "]" \\\" \"\"\"
[[list]]
x = 1
[list.deep]
y = 1979-05-27 07:32:00
[[list]]
x = true
[[list.more]]
z = { p.q = 0xff }
"""
    tomllib.loads(text)
    places = {
        path: text[place.value : place.end] for path, place in positions(text).items()
    }
    assert places[("a", "b")] == "1"
    assert places[("quoted key",)] == "'x # no comment'"
    assert places[("t", "u.v", "w", 1, 1)] == "3"
    assert places[("t", "u.v", "w", 2, "k")] == '"}"'
    assert places[("t", "u.v", "m")].endswith('"""')
    assert places[("list", 0, "x")] == "1"
    assert places[("list", 0, "deep", "y")] == "1979-05-27 07:32:00"
    assert places[("list", 1, "x")] == "true"
    assert places[("list", 1, "more", 0, "z", "p", "q")] == "0xff"
    place = positions(text)[("t", "u.v", "w", 1, 1)]
    assert line_and_column(text, place.key) == (5, 5)


def test_formula_is_arithmetic():
    f = Formula(("a*x**2 - y/2 + sin(pi*x) + -x**-2 + 3",), ("x", "y"), ("a",))
    x, y = jnp.float64(-0.7), jnp.float64(0.3)
    wanted = 1.5 * x**2 - y / 2 + np.sin(np.pi * x) - x**-2 + 3
    np.testing.assert_allclose(f(x, y, {"a": 1.5}), wanted, rtol=1e-15)
    # a whole power of a negative number has derivatives
    slope = jax.grad(lambda x: Formula(("x**3",), ("x",))(x))(jnp.float64(-2.0))
    assert slope == 12.0
    constant = Formula(("1", "x"), ("x",))(jnp.float64(2.0))
    np.testing.assert_array_equal(constant, [1.0, 2.0])
    assert constant.dtype == jnp.float64
    same = Formula(("x**3",), ("x",))
    assert same == Formula(("x**3",), ("x",))
    assert hash(same) == hash(Formula(("x**3",), ("x",)))


@pytest.mark.parametrize(
    ("text", "shift", "remedy"),
    [
        ("x^2", 0, "write a power with **"),
        ("2x", 0, "write arithmetic"),
        ("x +", 2, "write arithmetic"),
        ("", 0, "write arithmetic"),
        ("1 + w", 4, "use one of: x, y, pi"),
        ("1 + sine(x)", 4, "did you mean sin?"),
        ("x(y + 1)", 0, "write a product with *"),
        ("x*sin", 2, "sin(...)"),
        ("sin(x, y)", 0, "write sin(...)"),
        ("sin(*x)", 0, "write sin(...)"),
        ("jnp.sin(x)", 0, "without a dot"),
        ("x.real", 0, "without a dot"),
        ("x if y else 1", 0, "no conditions"),
        ("x > 1", 0, "no conditions"),
        ("x // 2", 0, "write a quotient with /"),
        ("1e999*x", 0, "write a smaller one"),
        ("2j*x", 0, "write a real number"),
        ("'a'*x", 0, "write a real number"),
        ("[x]", 0, "use numbers, names"),
        ("(lambda: x)()", 0, "write products with *"),
        ("__import__('os')", 0, "use one of: sin"),
        ("(-1)**0.5*x", 0, "check its signs"),
        ("x + (0 - 2)**0.25", 4, "check its signs"),
        ("x*sqrt(-1)", 2, "check its signs"),
        ("y + log(-pi)", 4, "check its signs"),
        ("x + 1/(2 - 2)", 4, "check its signs"),
        ("x/(1 - 1)**-1", 2, "check its signs"),
        ("x*10.0**400", 2, "check its signs"),
        ("x*exp(1000)", 2, "check its signs"),
        ("x + " * 400 + "x", 0, "shorten it"),
        ("(" * 500 + "x" + ")" * 500, None, ""),
        ("x" * 3000, None, "shorten it"),
    ],
)
def test_formula_that_is_not(text, shift, remedy):
    with pytest.raises(FormulaError) as caught:
        parse(text, ("x", "y"))
    assert shift is None or caught.value.shift == shift
    assert remedy in caught.value.remedy


def test_formula_of_constants_is_what_it_says():
    """Negative bases with whole powers, and roots of what is not negative."""
    text = "(-2)**3*x + 4**0.5 + abs(-1) - (-1)**2 + sqrt(0) + 2**-1"
    found = Formula((text,), ("x",))(jnp.float64(1.0))
    assert found == -8.0 + 2.0 + 1.0 - 1.0 + 0.5


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("x  # along\n + 2*y", 2.0 + 2 * 3.0),
        ("# of both\n x # the one: π (not)\n\n * # and\n y # the other", 2.0 * 3.0),
        ("sin(  # of what\n  0*x)\n- y", -3.0),
        ("x  # alone", 2.0),
    ],
)
def test_comments_in_a_formula_end_at_their_lines(text, value):
    """As Python reads it in brackets; all values here are exact."""
    assert Formula((text,), ("x", "y"))(jnp.float64(2.0), jnp.float64(3.0)) == value


@pytest.mark.parametrize(
    "text", ["x # π, then y\n + {z}", "# z\n\tx*{z}", "x + # 'z\n sin(  {z}) # z"]
)
def test_what_is_wrong_behind_a_comment_is_pointed_at(text):
    with pytest.raises(FormulaError) as caught:
        parse(text.replace("{z}", "z"), ("x", "y"))
    assert caught.value.shift == text.index("{z}")


@pytest.mark.parametrize(
    "text", ["# nothing", "x + # y", "x # one\n y", "x) # \n + (y"]
)
def test_comments_do_not_make_a_formula(text):
    with pytest.raises(FormulaError, match="cannot be read"):
        parse(text, ("x", "y"))


def test_formula_points_into_its_string(tmp_path):
    for quote, opened in (('"', '"'), ("'", "'"), ('"""', '"""\n')):
        formula = f"{opened}0.1*x + 2*z{quote}"
        text = changed(*base(f'{{ kind = "graph", f = {formula} }}'))
        (found,) = refused(tmp_path, text)
        assert found.source_line[found.column - 1] == "z"


def test_defaults_are_those_of_the_constructors():
    def plain(value):
        return np.asarray(value, dtype=float).tolist()

    tables = [(table, table.made_by()) for table in SURFACES.values()]
    for table, make in [*tables, (LOADS["gravity"], Gravity)]:
        signature = inspect.signature(make).parameters
        for name, field in table.model_fields.items():
            if name in signature and name not in ("f", "parameters"):
                default = signature[name].default
                assert field.is_required() == (default is inspect.Parameter.empty)
                if not field.is_required():
                    assert plain(field.default) == plain(default), (table, name)


@pytest.mark.parametrize(
    "text",
    [
        'kind = "torus"\nmajor_radius = 0.1\nminor_radius = 0.02',
        'kind = "revolution"\nradius = "r*sin(s)"\nheight = "-r*cos(s)"\n'
        "parameters = { r = 0.1 }",
        'kind = "implicit"\nf = "x**2 + y**2 + 2*z**2 - r**2"\n'
        "parameters = { r = 0.1 }",
        'kind = "parametric"\nx = "r*cos(q1)*cos(q2)"\ny = "r*sin(q1)*cos(q2)"\n'
        'z = "r*sin(q2)"\nparameters = { r = 0.1 }',
    ],
)
def test_kinds_of_surface(tmp_path, text):
    text = changed(*surface(text)).replace(
        "orientation = [1.0, 0.0, 0.0, 0.0]", 'rotations = [["x", 40], ["y", 10]]'
    )
    file = load_scene(write(tmp_path, text))
    assert type(file.scene.body.surface).__name__.lower() in text


def test_no_loads_and_whole_numbers(tmp_path):
    text = "loads = []\n" + GOOD.replace(
        '[[loads]]\nkind = "gravity"\nacceleration = [0, 0, -9.81]\n', ""
    ).replace("mass = 1.0", "mass = 1")
    file = load_scene(write(tmp_path, text))
    assert file.scene.loads == ()
    assert file.scene.body.mass.dtype == jnp.float64


def test_rotations_multiply_from_left_to_right(tmp_path):
    turned = changed(
        "orientation = [1.0, 0.0, 0.0, 0.0]", 'rotations = [["x", 90], ["z", 90]]'
    ).replace("angular_velocity =", "angular_velocity_body =")
    file = load_scene(write(tmp_path, turned))
    # Rx(90) Rz(90): body x -> z -> ... by hand: e_x -> Rx e_y = e_z
    half = np.sqrt(0.5)
    x, z = np.array([half, half, 0, 0]), np.array([half, 0, 0, half])
    wanted = [x[0] * z[0], x[1] * z[0], -x[1] * z[3], x[0] * z[3]]
    np.testing.assert_allclose(file.start.orientation, wanted, atol=1e-15)
    np.testing.assert_allclose(file.start.angular_velocity, [0, 5, 2], atol=1e-14)


@pytest.mark.parametrize("name", builtin_scenes())
def test_builtin_scene(name):
    file = load_scene(name)
    assert file.name == name
    assert file.title != name
    assert 2 <= len(file.description.strip().split("\n")) <= 4
    text = (resources.files("rollkane") / "scenes" / f"{name}.toml").read_text()
    assert check_schema(tomllib.loads(text), scene_schema()) == []


def test_builtin_scenes_are_the_promised_ones():
    assert set(builtin_scenes()) == {
        "rattleback",
        "ball-on-plane",
        "rolling-disc",
        "chaplygin-ball",
        "routh-sphere",
        "ellipsoid-in-bowl",
        "euler-disc",
        "ball-on-turntable",
        "ball-on-tilted-turntable",
        "shaken-plate",
        "isolator",
        "shell-with-pendulum",
        "ellipsoid-on-six-axis-table",
        "ball-in-rolling-shell",
        "ball-on-ball-on-turntable",
        "disc-in-hoop",
        "egg-in-rocking-cavity",
        "ellipsoid-in-rocking-bowl",
        "shells-in-shells",
    }
    # Kane and Levinson: 5 rad/s about the body's third axis, which points down
    stone = load_scene("rattleback").start
    np.testing.assert_allclose(stone.angular_velocity, [0, 0, -5], atol=1e-14)


def test_schema_refuses_what_the_file_reader_refuses():
    schema = scene_schema()
    assert check_schema(tomllib.loads(GOOD), schema) == []
    for old, new in (
        ("mass = 1.0", 'mass = "1.0"'),
        ("mass = 1.0\n", ""),
        ("center_of_mass =", "centre_of_mass ="),
        ('kind = "sphere"', 'kind = "spere"'),
        ("[0, 5, 2]", "[0, 5]"),
        ("outputs = 11", "outputs = 1"),
        ("duration = 1.0", "duration = 0"),
        ("orientation = [1.0, 0.0, 0.0, 0.0]\n", ""),
        ("orientation = [1.0", 'rotations = [["x", 1]]\norientation = [1.0'),
    ):
        assert check_schema(tomllib.loads(changed(old, new)), schema), new


_KINDS = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "integer": int,
    "number": (int, float),
}
_LIMITS = {
    "const": lambda value, limit: value == limit,
    "enum": lambda value, limit: value in limit,
    "minItems": lambda value, limit: len(value) >= limit,
    "maxItems": lambda value, limit: len(value) <= limit,
    "minimum": lambda value, limit: value >= limit,
    "exclusiveMinimum": lambda value, limit: value > limit,
}


def check_schema(value, schema):
    """Problems of a value by the part of JSON schema that our own schema uses."""
    return list(_problems(value, schema, schema["$defs"]))


def _problems(value, schema, tables):
    if "$ref" in schema:
        schema = schema | tables[schema["$ref"].rsplit("/", 1)[1]]
    kind = schema.get("type")
    is_flag = isinstance(value, bool) and kind != "boolean"
    if kind and (is_flag or not isinstance(value, _KINDS[kind])):
        yield f"{value} is no {kind}"
        return
    for name, holds in _LIMITS.items():
        if name in schema and not holds(value, schema[name]):
            yield f"{value} breaks {name} {schema[name]}"
    for part in schema.get("allOf", []):
        yield from _problems(value, part, tables)
    choices = [not [*_problems(value, s, tables)] for s in schema.get("oneOf", [])]
    if choices and sum(choices) != 1:
        yield f"{value} fits {sum(choices)} choices"
    for inner, part in _members(value, schema):
        yield from _problems(inner, part, tables)


def _members(value, schema):
    """What is inside a value, each with its own schema; one that nothing fits."""
    never = {"enum": []}
    if isinstance(value, dict):
        missing = set(schema.get("required", [])) - set(value)
        yield from ((name, never) for name in missing)
        rest = schema.get("additionalProperties", {})
        rest = never if rest is False else rest
        known = schema.get("properties", {})
        yield from ((inner, known.get(name, rest)) for name, inner in value.items())
    if isinstance(value, list):
        firsts = schema.get("prefixItems", [])
        rest = [schema.get("items", {})] * len(value)
        yield from zip(value, (firsts + rest)[: len(value)], strict=True)


def test_overlap_and_second_contact(tmp_path):
    """An egg on end inside a torus: refused with its field, allowed where asked."""
    text = OVERLAP
    (found,) = refused(tmp_path, text)
    assert found.field == "start.contact_on_base"
    assert "puts the body into the base elsewhere, 0.2 m deep" in found.problem
    text = text.replace("[run]", "allow_overlap = true\n[run]\nsecond_contact = true")
    file = load_scene(write(tmp_path, text))
    assert file.second_contact
    assert np.isfinite(file.start.orientation).all()
