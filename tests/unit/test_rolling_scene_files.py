"""Bodies that roll on or in the body, in scene files."""

import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import SceneFileError, load_scene
from rollkane.pictures.summary import summary

SHELLS = """
[body]
mass = 1.0
inertia = [[0.05, 0, 0], [0, 0.045, 0], [0, 0, 0.055]]
surface = { kind = "sphere", radius = 0.4 }

[[rolling]]
on = { kind = "sphere", radius = 0.38, inside = true }
position = [0.01, 0.0, 0.0]
[rolling.body]
mass = 0.6
inertia = [[0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.02]]
surface = { kind = "sphere", radius = 0.25 }
[rolling.start]
contact_on_carrier = [0.0, 0.0, -0.38]
angular_velocity = [1.0, 0.0, 0.5]

[[rolling]]
carrier = 0
without_spin = true
on = { kind = "sphere", radius = 0.24, inside = true }
[rolling.body]
mass = 0.3
inertia = [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1e-3]]
center_of_mass = [0.0, 0.01, 0.0]
surface = { kind = "sphere", radius = 0.08 }
[rolling.start]
rotations = [["x", 20]]
contact_on_carrier = [0.0, 0.24, 0.0]

[start]
rotations = []
angular_velocity = [0.5, 1.0, 2.0]

[run]
duration = 0.5
outputs = 6
"""


def loaded(text, tmp_path):
    path = tmp_path / "shells.toml"
    path.write_text(text)
    return load_scene(path)


def test_a_ball_in_a_shell_in_a_shell(tmp_path):
    file = loaded(SHELLS, tmp_path)
    small = rk.RollingBody(
        rk.Body(0.3, 1e-3 * np.eye(3), rk.Sphere(0.08), (0.0, 0.01, 0.0)),
        rk.Sphere(0.24, inside=True),
        contact=rk.RubberRolling(),
    )
    shell = rk.RollingBody(
        rk.Body(0.6, 0.02 * np.eye(3), rk.Sphere(0.25)),
        rk.Sphere(0.38, inside=True),
        small,
        position=(0.01, 0.0, 0.0),
    )
    outer = rk.Body(1.0, np.diag([0.05, 0.045, 0.055]), rk.Sphere(0.4))
    scene = rk.Scene(outer, supported=shell)
    level, still = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    turned = (np.cos(np.pi / 18), np.sin(np.pi / 18), 0.0, 0.0)
    inside = small.place(turned, still, (0.0, 0.24, 0.0))
    own = shell.place(level, (1.0, 0.0, 0.5), (0.0, 0.0, -0.38), supported=inside)
    start = rk.place(scene, level, (0.5, 1.0, 2.0), still, supported=own)
    by_hand = rk.simulate(scene, start, file.times, rtol=1e-10)
    by_file = rk.simulate(file.scene, file.start, file.times, rtol=1e-10)
    for path in ((0,), (0, 0)):
        # the same numbers but for roundings of the turns
        np.testing.assert_allclose(
            by_file.rolling_body(*path).position,
            by_hand.rolling_body(*path).position,
            atol=1e-12,
        )


@pytest.mark.slow
def test_a_summary_tells_of_each_body(tmp_path):
    first, shell, *_ = SHELLS.split("[[rolling]]")
    alone = f"{first}[[rolling]]{shell}[start]{SHELLS.partition('[start]')[2]}"
    file = loaded(alone, tmp_path)
    run = rk.simulate(file.scene, file.start, file.times)
    lines = summary(run)
    (first,) = (k for k, x in enumerate(lines) if x.strip().startswith("rolling 0 "))
    told = lines[first:]
    assert "ends at (" in told[0]
    least = float(np.min(run.rolling_body(0).normal_force))
    assert any(f"{least:.4g} N at least" in line for line in told)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("carrier = 0", "carrier = 1", "rolling[1].carrier: must be the number of a"),
        (
            "[[rolling]]",
            "[[rolling]]\ncarrier = 0",
            "rolling[0].carrier: must be the number of a table before this one, got 0 "
            "— leave it out",
        ),
        ("carrier = 0", "carrier = -1", "rolling[1].carrier: must be 0 or more"),
        ("radius = 0.25 }", "radius = 0.39 }", "would cut into the base"),
        ("without_spin", "rubber", "rolling[1].rubber: is an unknown name"),
        ("-0.38]", "-0.3]", "rolling[0].start.contact_on_carrier"),
        ("radius = 0.08", "radius = -0.08", "rolling[1].body.surface.radius"),
        ("mass = 0.3", "mass = -0.3", "rolling[1].body.mass"),
        (
            'on = { kind = "sphere", radius = 0.24',
            'on = { kind = "spere", radius = 0.24',
            "did you mean sphere?",
        ),
        (
            'rotations = [["x", 20]]',
            'rotations = [["x", 20]]\norientation = [1.0, 0.0, 0.0, 0.0]',
            "rolling[1].start.rotations: says the same as orientation",
        ),
        ("[rolling.start]\ncontact_on_carrier = [0.0, 0.0, -0.38]", "", "is missing"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, old, new, said):
    assert old in SHELLS
    with pytest.raises(SceneFileError) as refused:
        loaded(SHELLS.replace(old, new, 1), tmp_path)
    assert said in str(refused.value)
