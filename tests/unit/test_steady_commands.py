"""The commands that find steady motions and families."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import rollkane as rk
from rollkane.cli import main
from rollkane.files.scene_files import load_scene


def run(*arguments):
    return CliRunner().invoke(main, [*arguments])


def test_a_steady_motion_is_told_and_written(tmp_path):
    file = tmp_path / "motion.json"
    ask = "steady", "rolling-disc", "--hold", "speed=1.5", "--hold", "tilt"
    ran = run(*ask, "--energy-sign", "--json", str(file))
    assert ran.exit_code == 0, ran.output
    assert "steady motion, stable" in ran.output
    known = json.loads(file.read_text())
    assert known["stable"] is True
    assert known["held"]["speed"] == pytest.approx(1.5, rel=1e-12)  # to rounding
    assert known["held"]["tilt"] == pytest.approx(np.deg2rad(70.0), rel=1e-12)
    assert len(known["eigenvalues"]) + len(known["zeros"]) == 8
    start = known["start"]
    assert set(start) == {"orientation", "angular_velocity", "contact_on_base"}
    placed = rk.place(load_scene("rolling-disc").scene, **start)
    for name, value in known["state"].items():
        # of the size of what is turned there and back, 10 rad/s, in a few roundings
        np.testing.assert_allclose(getattr(placed, name), value, rtol=0, atol=1e-13)
    sign = known["energy_sign"]
    assert sign["definite"] is False
    assert "does not vanish" in sign["reason"]
    assert f"sign of energy: none, {sign['reason']}" in ran.output


def test_a_family_is_told_drawn_and_written(tmp_path):
    picture, file = tmp_path / "disc.png", tmp_path / "disc.json"
    ask = "family", "rolling-disc", "--vary", "start.spin=1:20", "--points", "20"
    ran = run(*ask, "--show", "speed", "--plot", str(picture), "--json", str(file))
    assert ran.exit_code == 0, ran.output
    assert "held tilt = 1.22173" in ran.output  # as in the start: 70 degrees
    assert picture.read_bytes().startswith(b"\x89PNG")
    known = json.loads(file.read_text())
    values = [point["value"] for point in known["points"]]
    assert values == sorted(values)
    assert values[0] == 1.0
    assert values[-1] == 20.0
    kinds = {c["kind"] for c in known["critical"]}
    assert kinds <= {"fold", "zero crossing", "Hopf", "collision"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("steady", "rolling-disc", "--hold", "sped=1"), "did you mean 'speed'"),
        (("steady", "rolling-disc", "--hold", "speed=fast"), "is not a finite number"),
        pytest.param(
            ("steady", "shaken-plate"), "depends on time", marks=pytest.mark.slow
        ),
        (("family", "rolling-disc", "--vary", "spin"), "is not NAME=LOW:HIGH"),
        (("family", "rolling-disc", "--vary", "body.mas=1:2"), "can be varied"),
        (
            ("family", "rolling-disc", "--vary", "start.spin=1:20", "--hold=spin=30"),
            "holds spin at 30, which --vary takes from 1 to 20",
        ),
    ],
)
def test_bad_input_is_refused(arguments, said):
    ran = run(*arguments)
    assert ran.exit_code == 2
    assert said in ran.output.replace("\n", " ")
