"""Scene files with moving bases and carried masses, and what is refused in them."""

import logging
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import SceneFileError, load_scene

from ..record_files import v2a

HEAD = """\
[body]
mass = 1.0
inertia = [[0.004, 0, 0], [0, 0.004, 0], [0, 0, 0.004]]
surface = { kind = "sphere", radius = 0.1 }
"""
TAIL = """\
[start]
orientation = [1.0, 0.0, 0.0, 0.0]
angular_velocity = [0, 5, 2]
[run]
duration = 0.2
outputs = 3
"""
BASE = '[base]\nsurface = { kind = "plane" }\n[base.motion]\n'
SPIN = BASE + 'kind = "spin"\nrate = 2.0\n'
FUNCTIONS = (
    BASE
    + 'kind = "functions"\nposition = ["a*sin(t)", "0", "t**2"]\n'
    + 'rotations = [["x", "0.1*t"], ["z", "a*t"]]\nparameters = { a = 0.5 }\n'
)
RECORD = (
    BASE
    + 'kind = "record"\nrecord = "kaikoura-2016-wtmc"\naxes = ["x", "z"]\n'
    + "window = [40.0, 41.0]\nscale = 0.5\n"
)
MASSES = """\
[[supported]]
kind = "point-masses"
mass = [0.1, 0.2]
coordinates = ["psi", "u"]
position = [["arm*sin(psi)", "u", "0"], ["0", "0.1*psi", "u"]]
force = ["-psi - 0.1*psi_dot", "sin(t)"]
potential = "psi**2 + u**2"
parameters = { arm = 0.05 }
"""
BODY = """\
[[supported]]
kind = "body"
mass = 0.1
inertia = [[0.001, 0, 0], [0, 0.001, 0], [0, 0, 0.001]]
coordinates = ["beta"]
position = ["0", "0.01*beta", "0"]
rotations = [["y", "beta"], ["x", "0.5"]]
"""


def write(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def loaded(tmp_path, middle, tail=TAIL):
    return load_scene(write(tmp_path, HEAD + middle + tail))


def runs(file):
    result = rk.simulate(file.scene, file.start, file.times)
    assert bool(result.succeeded), result.reason
    return result


def test_spin(tmp_path):
    text = SPIN + 'rotations = [["x", 90]]\nposition = [1, 2, 3]\n'
    file = loaded(tmp_path, text)
    now = file.scene.base.motion.at(jnp.asarray(0.0))
    np.testing.assert_allclose(np.asarray(now.rotation)[:, 1], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(now.angular_velocity, [0, 0, 2.0])
    np.testing.assert_allclose(now.position, [1, 2, 3])


def test_functions(tmp_path):
    file = loaded(tmp_path, FUNCTIONS)
    t = 0.3
    now = file.scene.base.motion.at(jnp.asarray(t))
    np.testing.assert_allclose(now.position, [0.5 * np.sin(t), 0, t * t], rtol=1e-14)
    np.testing.assert_allclose(now.velocity, [0.5 * np.cos(t), 0, 2 * t], rtol=1e-14)
    c, s = np.cos(0.1 * t), np.sin(0.1 * t)
    about_x = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    c, s = np.cos(0.5 * t), np.sin(0.5 * t)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(now.rotation, about_x @ about_z, atol=1e-15)
    # on base axes: about z itself, and the turn about x seen from there
    expected = about_z.T @ [0.1, 0, 0] + [0, 0, 0.5]
    np.testing.assert_allclose(now.angular_velocity, expected, atol=1e-15)
    runs(file)


def test_record(tmp_path):
    file = loaded(tmp_path, RECORD)
    motion = file.scene.base.motion
    whole = rk.builtin_record("kaikoura-2016-wtmc").acceleration[2000:2051]
    np.testing.assert_allclose(motion.acceleration[:, 0], 0.5 * whole[:, 0])
    np.testing.assert_allclose(motion.acceleration[:, 2], 0.5 * whole[:, 1])
    assert not np.any(np.asarray(motion.acceleration[:, 1]))
    np.testing.assert_allclose(motion.time, 0.02 * np.arange(51), atol=1e-12)
    runs(file)


def test_record_from_a_file_beside_the_scene(tmp_path):
    rows = "".join(f"{0.01 * i:.2f} {i}\n" for i in range(101))
    (tmp_path / "quake.txt").write_text("title\n" + rows)
    text = RECORD.replace('record = "kaikoura-2016-wtmc"', 'file = "quake.txt"')
    text = text.replace('axes = ["x", "z"]', 'format = "two-column"\nunit = "cm/s2"')
    file = loaded(tmp_path, text.replace("[40.0, 41.0]", "[0.5, 1.0]"))
    acceleration = np.asarray(file.scene.base.motion.acceleration)[:, 0]
    np.testing.assert_allclose(acceleration, 0.5e-2 * np.arange(50, 101))


# a header without a unit, one with g and one with cm/s2; samples of 100
FORMATS = {
    "at2": "{header}\nNPTS= 3, DT= .1 SEC\n100 100 100\n",
    "single-column": "{header}\n3 0.1\n100\n100\n100\n",
    "two-column": "{header}\n0.0 100\n0.1 100\n0.2 100\n",
}


def of_file(tmp_path, form, header, more):
    """A scene file with the record of a file beside it."""
    text = v2a(first=-100.0, text={13: header}) if form == "v2a" else FORMATS[form]
    (tmp_path / "quake.txt").write_text(text.format(header=header))
    lines = (f'kind = "record"\nfile = "quake.txt"\nformat = "{form}"', *more)
    return loaded(tmp_path, BASE + "\n".join(lines) + "\n")


@pytest.mark.parametrize("form", [*FORMATS, "v2a"])
def test_the_unit_reaches_every_reader(tmp_path, form):
    usual = 0.1 if form == "v2a" else 980.665
    cases = (
        ("some quake", (), usual),
        ("some quake", ('unit = "cm/s2"',), 1.0),
        ("some quake", ('unit = "mm/s2"',), 0.1),
        ("acceleration in cm/s/s", (), 1.0),
        ("acceleration in cm/s/s", ('unit = "cm/s2"',), 1.0),
    )
    for header, more, wanted in cases:
        file = of_file(tmp_path, form, header, more)
        found = float(file.scene.base.motion.acceleration[0, 0])
        assert found == pytest.approx(wanted, rel=1e-14), (header, more)
    with pytest.raises(SceneFileError) as caught:
        of_file(tmp_path, form, "acceleration in cm/s/s", ('unit = "g"',))
    (problem,) = caught.value.problems
    assert problem.field == "base.motion.unit"
    assert problem.value == '"g"'
    line = 14 if form == "v2a" else 1
    assert re.search(rf"quake.txt, line {line} names, which is cm/s2", problem.problem)


def test_the_default_format_takes_the_unit(tmp_path):
    """AT2, where the unit was once not passed on."""
    (tmp_path / "quake.at2").write_text("quake\nNPTS= 2, DT= .5 SEC\n100 100\n")
    text = 'kind = "record"\nfile = "quake.at2"\nunit = "cm/s2"\n'
    motion = loaded(tmp_path, BASE + text).scene.base.motion
    np.testing.assert_allclose(motion.acceleration[:, 0], 1.0, rtol=1e-15)


def test_supported(tmp_path):
    start = TAIL.replace("[run]", "alpha = [0.1, 0.0, 0.3]\n[run]")
    file = loaded(tmp_path, MASSES + BODY, start)
    masses, body = file.scene.supported
    assert (masses.count, body.count) == (2, 1)
    np.testing.assert_allclose(file.start.alpha, [0.1, 0.0, 0.3])
    np.testing.assert_allclose(file.start.alpha_dot, np.zeros(3))
    alpha, alpha_dot = jnp.array([0.1, 0.2]), jnp.array([0.3, 0.4])
    part = masses.carried(jnp.asarray(0.0), alpha, alpha_dot)
    np.testing.assert_allclose(part.place[:, 0], [0.05 * np.sin(0.1), 0.2, 0.0])
    Q = masses.generalized_force(jnp.asarray(0.5), alpha, alpha_dot)
    np.testing.assert_allclose(Q, [-0.1 - 0.03, np.sin(0.5)])
    assert abs(float(masses.potential_energy(alpha)) - 0.05) < 1e-15
    runs(file)


def test_prescribed(tmp_path):
    file = loaded(tmp_path, BODY + 'motion = ["0.2*sin(3*t)"]\n')
    (part,) = file.scene.supported
    assert isinstance(part, rk.Prescribed)
    assert file.start.alpha.shape == (0,)
    runs(file)


def test_the_same_file_twice_compiles_once(tmp_path, caplog):
    text = FUNCTIONS + MASSES
    path = write(tmp_path, HEAD + text + TAIL)
    first = load_scene(path)
    runs(first)
    again = load_scene(path)
    with jax.log_compiles(True), caplog.at_level(logging.WARNING):
        runs(again)
    assert not [m for m in caplog.messages if "Compiling" in m and "simulate" in m]


# middle of the file; field, text of its line, problem, remedy
BAD = {
    "unknown motion": (
        SPIN.replace('"spin"', '"spinn"'),
        ("base.motion.kind", "not a known kind", "did you mean spin?"),
    ),
    "no rate": (
        SPIN.replace("rate = 2.0\n", ""),
        ("base.motion.rate", "is missing", r"angular velocity \[rad/s\]"),
    ),
    "both orientations": (
        SPIN + 'rotations = [["x", 1]]\norientation = [1, 0, 0, 0]\n',
        ("base.motion.orientation", "says the same", "leave out"),
    ),
    "orientation not of unit length": (
        SPIN + "orientation = [1, 1, 0, 0]\n",
        ("base.motion.orientation", "unit length", "divide"),
    ),
    **{
        f"{name} = {value}": (
            BASE + f'kind = "functions"\n{name} = {value}\n',
            (f"base.motion.{name}", "must be a list", ""),
        )
        for name in ("position", "rotations")
        for value in ("0.5", "true", "1979-05-27", '"t"')
    },
    **{
        f"a parameter {word}": (
            FUNCTIONS.replace("a = 0.5", f"a = 0.5, {word} = 1.0"),
            (f"base.motion.parameters.{word}", "not a name for a formula", "another"),
        )
        for word in ("lambda", "in", "None")
    },
    "a coordinate lambda": (
        MASSES.replace('["psi", "u"]', '["psi", "lambda"]'),
        (r"supported\[0\].coordinates\[1\]", "not a name for a formula", "another"),
    ),
    "neither position nor rotations": (
        BASE + 'kind = "functions"\n',
        ("base.motion", "both missing", "function of time"),
    ),
    "formula of the wrong name": (
        FUNCTIONS.replace("t**2", "T**2"),
        (r"base.motion.position\[2\]", "unknown name T", "did you mean t?"),
    ),
    "turn about no axis": (
        FUNCTIONS.replace('["z"', '["w"'),
        (r"base.motion.rotations\[1\]\[0\]", "not a known name", "use one of: x, y, z"),
    ),
    "angle in degrees": (
        FUNCTIONS.replace('["z", "a*t"]', '["z", 3.0]'),
        (r"base.motion.rotations\[1\]\[1\]", "must be text", "formulas"),
    ),
    "unknown record": (
        RECORD.replace("kaikoura-2016-wtmc", "kobe"),
        ("base.motion.record", "is not known", "kaikoura"),
    ),
    "no record": (
        RECORD.replace('record = "kaikoura-2016-wtmc"\n', ""),
        ("base.motion.record", "is missing", "either record"),
    ),
    "no such file": (
        RECORD.replace('record = "kaikoura-2016-wtmc"', 'file = "nowhere.at2"'),
        ("base.motion.file", "cannot be read", "path"),
    ),
    "window outside": (
        RECORD.replace("41.0", "410.0"),
        ("base.motion.window", "not within the record", "give a start and an end"),
    ),
    "window before the record": (
        RECORD.replace("[40.0, 41.0]", "[-5.0, 10.0]"),
        ("base.motion.window", "not within the record, 0 to", "give a start"),
    ),
    "unit of a built-in record": (
        RECORD + 'unit = "cm/s2"\n',
        ("base.motion.unit", "a built-in record has its own", "leave out unit"),
    ),
    "format of a built-in record": (
        RECORD + 'format = "v2a"\n',
        ("base.motion.format", "a built-in record has its own", "leave out format"),
    ),
    "unknown unit": (
        RECORD + 'unit = "in/s2"\n',
        ("base.motion.unit", "not a known name", "m/s2"),
    ),
    "unit in a list": (
        RECORD + 'unit = ["g"]\n',
        ("base.motion.unit", "not a known name", "use one of: g, m/s2"),
    ),
    "axis twice": (
        RECORD.replace('"z"', '"x"'),
        ("base.motion.axes", "each axis once", "x, y and z"),
    ),
    "unknown supported": (
        MASSES.replace("point-masses", "pointmasses"),
        (r"supported\[0\].kind", "not a known kind", "did you mean point-masses?"),
    ),
    "negative mass inside": (
        MASSES.replace("0.1, 0.2", "0.1, -0.2"),
        (r"supported\[0\].mass\[1\]", "must be positive", "masses"),
    ),
    "rows of masses": (
        MASSES.replace("[0.1, 0.2]", "[0.1]"),
        (r"supported\[0\].position", "must have 1 entries, not 2", "each mass"),
    ),
    "rate of no coordinate": (
        MASSES.replace("psi_dot", "phi_dot"),
        (r"supported\[0\].force\[0\]", "unknown name phi_dot", "did you mean psi_dot?"),
    ),
    "forces for coordinates": (
        MASSES.replace(', "sin(t)"', ""),
        (r"supported\[0\].force", "must have 2 entries, not 1", "each coordinate"),
    ),
    "motion for coordinates": (
        BODY + 'motion = ["t", "t"]\n',
        (r"supported\[0\].motion", "must have 1 entries, not 2", "each coordinate"),
    ),
    "coordinate that is taken": (
        MASSES.replace('"u"]', '"t"]', 1),
        (r"supported\[0\].coordinates\[1\]", "is taken already", "another name"),
    ),
    "inertia inside": (
        BODY.replace("[[0.001, 0, 0]", "[[0.009, 0, 0]"),
        (r"supported\[0\].inertia", "triangle inequality", "check the units"),
    ),
    "massless coordinate": (
        MASSES.replace("arm*sin(psi)", "0").replace('"0.1*psi"', '"0"'),
        ("supported", "singular at this alpha", "every coordinate move a mass"),
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_field(case, tmp_path):
    middle, (field, problem, remedy) = BAD[case]
    with pytest.raises(SceneFileError) as caught:
        loaded(tmp_path, middle)
    found = [p for p in caught.value.problems if re.fullmatch(field, p.field)]
    assert len(found) == 1, str(caught.value)
    assert problem in found[0].problem
    assert re.search(remedy, found[0].remedy), found[0].remedy
    assert f"scene.toml:{found[0].line}:" in str(caught.value)


def test_alpha_of_the_wrong_length(tmp_path):
    for tail in ("alpha = [0.1]\n[run]", "alpha_dot = [0.1, 0.2, 0.3]\n[run]"):
        with pytest.raises(SceneFileError, match=r"start.alpha.*shape \(2\)"):
            loaded(tmp_path, MASSES, TAIL.replace("[run]", tail))
