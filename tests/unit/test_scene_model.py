"""Starts of scene files at other times: where the base has moved since."""

import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.geometry.rotations import rotation_matrix
from rollkane.kinematics.contact import body_to_base
from rollkane.uncertainty.scene_model import started_at

TURNING = """
[body]
mass = 1.0
inertia = [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.02]]
surface = { kind = "cylinder", radius = 0.2 }
[base]
surface = { kind = "sphere", radius = 1.0 }
[base.motion]
kind = "functions"
position = ["0", "0", "0"]
rotations = [["y", "0.1 * t"]]
[start]
rotations = [["x", 90.0]]
angular_velocity = [0.0, 0.5, 0.0]
contact_on_base = [0.0, 0.0, 1.0]
near_on_body = [0.0, -0.2, 0.05]
[run]
duration = 0.5
outputs = 3
"""


def test_a_body_touches_where_its_base_is_then(tmp_path):
    """It was turned by as much as the base, 0.2 rad, when a record began at 2 s."""
    (tmp_path / "a.toml").write_text(TURNING)
    file = load_scene(tmp_path / "a.toml")
    assert started_at(file, 0.0) is file.start
    found = started_at(file, 2.0)
    q = file.start.orientation
    known = rk.place(
        *(file.scene, q, (0.0, 0.5, 0.0), (0.0, 0.0, 1.0)),
        near_on_body=(0.0, -0.2, 0.05),
        time=2.0,
    )
    # roundings of lengths of about 1 m
    np.testing.assert_allclose(found.contact_on_base, known.contact_on_base, atol=1e-14)
    np.testing.assert_allclose(found.orientation, q, atol=1e-14)
    np.testing.assert_allclose(found.contact_on_body[0], known.contact_on_body[0])
    moved = file.scene.base.motion.at(jnp.asarray(2.0))
    to_base = body_to_base(rotation_matrix(found.orientation), moved)
    own = file.scene.body.surface.geometry(found.contact_on_body).normal
    out = file.scene.base.surface.geometry(found.contact_on_base).normal
    np.testing.assert_allclose(to_base @ own, -out, atol=1e-14)


def test_a_body_that_its_normal_places_stays_as_it_is(tmp_path):
    text = TURNING.replace('"cylinder", radius = 0.2', '"sphere", radius = 0.2')
    (tmp_path / "a.toml").write_text(text.replace("near_on_body", "# near_on_body"))
    file = load_scene(tmp_path / "a.toml")
    assert started_at(file, 2.0) is file.start
