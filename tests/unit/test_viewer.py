"""The HTML view: whole, self-contained, harmless, and true to the trajectory."""

import base64
import html.parser
import json
import os
import re
import shutil
import subprocess
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.pictures.viewer import MOST_FRAMES, view_data, view_page, write_view
from rollkane.validation.checks import FieldError
from tests.pictures import (
    ROWS,
    circle,
    motion,
    on_sphere,
    rolling_on_plane,
    rolling_on_sphere,
)

ASSETS = resources.files("rollkane.pictures") / "viewer_assets"
OWN_SCRIPTS = (
    *("motion.js", "marks.js", "stage.js", "timeline.js", "capture.js", "viewer.js"),
)


class Page(html.parser.HTMLParser):
    """What a browser would read: texts by element, attributes, scripts."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes, self.texts = [], [], {}
        self.open = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in ("meta", "input"):
            self.open.append(tag)
            self.texts.setdefault(tag, []).append("")
        self.attributes += [(tag, *pair) for pair in attrs]

    def handle_data(self, data):
        if self.open:
            self.texts[self.open[-1]][-1] += data

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    @property
    def data(self):
        return json.loads(self.texts["script"][0])


def unpacked(packed):
    flat = np.frombuffer(base64.b64decode(packed["data"]), packed["type"])
    return flat.reshape(packed["shape"]) * packed.get("unit", 1)


def mesh_points(mesh):
    low, high = np.array(mesh["low"]), np.array(mesh["high"])
    return low + unpacked(mesh["points"]) * (high - low)


@pytest.fixture(scope="module")
def run():
    return rolling_on_sphere()


@pytest.fixture(scope="module")
def page(run):
    return Page(view_page(run, "a ball"))


def test_frames_are_the_trajectory(run, page):
    frames = {name: unpacked(packed) for name, packed in page.data["frames"].items()}
    np.testing.assert_array_equal(frames["time"], np.asarray(run.time))
    for name in (
        "position",
        "orientation",
        "angular_velocity",
        "contact_on_base",
        "contact_on_body",
        "contact_force",
    ):
        expected = np.asarray(getattr(run, name))
        np.testing.assert_allclose(frames[name], expected, rtol=1e-6, atol=1e-6)
    outward = np.asarray(run.contact_on_base) / 0.5
    np.testing.assert_allclose(frames["outward"], outward, atol=2e-5)
    energy = np.asarray(run.energy)
    np.testing.assert_allclose(
        frames["energy"], np.abs(energy / energy[0] - 1.0), rtol=1e-5, atol=1e-12
    )


def test_meshes_are_the_surfaces(page):
    for mesh, radius in ((page.data["body"], 0.1), (page.data["base"], 0.5)):
        points = mesh_points(mesh)
        distance = np.linalg.norm(points, axis=1)
        np.testing.assert_allclose(distance, radius, atol=1e-4 * radius)
        normals = unpacked(mesh["normals"])
        assert (np.sum(points * normals, axis=1) > 0.98 * radius).all()
        assert unpacked(mesh["triangles"]).max() == len(points) - 1
        assert mesh["hollow"] is False


@pytest.mark.slow
def test_a_plane_and_a_plate_are_drawn_by_the_page():
    assert view_data(rolling_on_plane())["base"] == {"plane": True}
    plate = rk.Body(1.0, np.diag([1.0, 1.0, 1.9]), rk.Plane(), (0.0, 0.0, -0.1))
    scene = rk.Scene(plate, rk.Base(rk.Sphere(0.3)))
    run = motion(scene, on_sphere(ROWS), on_body=circle(ROWS))
    points = mesh_points(view_data(run)["body"])
    assert points[:, 2].max() == pytest.approx(0.0, abs=1e-12)
    assert points[:, 2].min() < -0.01


def test_page_loads_nothing_from_anywhere(page):
    loading = {"src", "href", "action", "data", "poster", "srcset", "background"}
    assert [entry for entry in page.attributes if entry[1] in loading] == []
    assert not {"link", "img", "iframe", "object", "embed", "base"} & set(page.tags)
    (policy,) = [
        value
        for tag, name, value in page.attributes
        if tag == "meta" and name == "content" and "default-src" in value
    ]
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy
    style = page.texts["style"][0]
    assert "url(" not in style
    assert "@import" not in style
    for name in OWN_SCRIPTS:
        script = (ASSETS / name).read_text()
        assert not re.search(r"\b(fetch|import|XMLHttpRequest|eval)\b", script)
        assert "http" not in script


def test_scripts_arrive_unharmed(page):
    scripts = page.texts["script"]
    assert len(scripts) == 2 + len(OWN_SCRIPTS)
    names = ("three.bundle.js", *OWN_SCRIPTS)
    for script, name in zip(scripts[1:], names, strict=True):
        source = (ASSETS / name).read_text()
        assert script.strip() == source.strip()
        assert "</script" not in source
        assert source.isascii()  # right in a page of any encoding


def test_the_library_s_licence_is_kept():
    page = view_page(rolling_on_plane(2))
    assert "Permission is hereby granted, free of charge" in page
    assert "SPDX-License-Identifier: MIT" in page
    licence = (ASSETS / "LICENSE.three").read_text(encoding="utf-8")
    assert licence.strip() in page


def test_titles_cannot_break_the_page():
    title = '</title><script>alert(1)</script> <!-- {{data}} & "quoted" \'\u2028'
    page = Page(view_page(rolling_on_plane(2), title))
    assert page.texts["title"] == [title]
    assert page.texts["h1"] == [title]
    assert page.tags.count("script") == 2 + len(OWN_SCRIPTS)
    assert page.data["title"] == title


def test_long_runs_are_thinned_and_stay_small(tmp_path):
    run = rolling_on_sphere(5000)
    write_view(run, tmp_path / "long.html")
    assert (tmp_path / "long.html").stat().st_size < 1_250_000
    page = Page((tmp_path / "long.html").read_text(encoding="utf-8"))
    time = unpacked(page.data["frames"]["time"])
    assert len(time) == MOST_FRAMES
    assert (time[0], time[-1]) == (0.0, 2.0)
    assert np.isin(time, np.asarray(run.time)).all()


def test_the_ending_says_what_is_written(tmp_path):
    for name in ("a.txt", "a", "a.html.gz"):
        with pytest.raises(FieldError, match=r"path: .*end the name in .html or .htm"):
            rolling_on_plane(2).view(tmp_path / name)
    rolling_on_plane(2).view(tmp_path / "A.HTM")
    assert os.listdir(tmp_path) == ["A.HTM"]


def test_ghosts_are_thinned_and_counted():
    run, ghost = rolling_on_plane(), rolling_on_plane(900)
    data = view_data(run, ghosts=[ghost, rolling_on_plane(reached=10)])
    first, second = ({k: unpacked(v) for k, v in g.items()} for g in data["ghosts"])
    assert (len(first["time"]), len(second["time"])) == (400, 10)
    assert np.isfinite(second["position"]).all()
    assert first["time"][-1] == float(ghost.time[-1])
    with pytest.raises(FieldError, match="32 at most"):
        view_data(run, ghosts=[ghost] * 33)


def test_a_member_of_an_ensemble_is_its_run(tmp_path):
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)))
    level, origin = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    starts = [rk.place(scene, level, (0.0, w, 1.0), origin) for w in (1.0, 2.0, 3.0)]
    times = np.linspace(0.0, 1.0, 5)
    found = rk.ensemble(scene, starts, times)
    alone = rk.simulate(scene, starts[1], times)
    # by loops in lanes and alone, whose roundings differ: measured 2e-16
    np.testing.assert_allclose(
        found.member(1).position, alone.position, rtol=0, atol=1e-13
    )
    assert found.member(1).reason == "completed"
    with pytest.raises(FieldError, match="give 0 to 2"):
        found.member(3)
    found.view(tmp_path / "a.html", member=2)
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    assert len(page.data["ghosts"]) == 2
    assert page.data["gravity"] == [0.0, 0.0, -9.81]


def test_only_what_was_reached_is_shown():
    data = view_data(rolling_on_plane(reached=10))
    assert data["frames"]["time"]["shape"] == [10]
    assert np.isfinite(unpacked(data["frames"]["position"])).all()
    assert data["note"].startswith("stopped at 0.782609 s: the step became too small")
    assert view_data(rolling_on_plane())["note"] == ""
    with pytest.raises(FieldError, match="no state"):
        view_data(rolling_on_plane(reached=0))


def test_single_precision():
    run = rolling_on_plane(dtype=jnp.float32)
    data = view_data(run)
    np.testing.assert_array_equal(
        unpacked(data["frames"]["position"]), np.asarray(run.position)
    )


def test_a_batch_is_refused():
    run = rolling_on_plane()
    with pytest.raises(FieldError, match="one lane"):
        view_data(jax.tree.map(lambda x: jnp.stack([x, x]), run))


def test_a_failure_leaves_no_file(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError("disc full")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="disc full"):
        write_view(rolling_on_plane(2), tmp_path / "a.html")
    assert os.listdir(tmp_path) == []
    with pytest.raises(FileNotFoundError):
        write_view(rolling_on_plane(2), tmp_path / "none" / "a.html")


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_states_between_frames():
    """Even spin of several turns per frame, on a circle: both are met in between."""
    axis, rate, radius = np.array([0.6, 0.0, 0.8]), 25.0, 0.5
    time = np.array([0.0, 0.4, 0.8])

    def exact(t):
        angle = rate * t
        turn = np.append(np.cos(angle / 2), np.sin(angle / 2) * axis)
        place = radius * np.array([np.cos(0.5 * t), np.sin(0.5 * t), 0.0])
        return place, turn, 0.5 * radius * np.array([-np.sin(t / 2), np.cos(t / 2), 0])

    rows = [exact(t) for t in time]
    columns = {
        "time": time,
        "position": np.array([row[0] for row in rows]),
        "orientation": np.array([row[1] for row in rows]),
        "velocity": np.array([row[2] for row in rows]),
        "angular_velocity": np.tile(rate * axis, (3, 1)),
        "outward": np.tile([0.0, 0.0, 1.0], (3, 1)),
        "energy": np.zeros(3),
    }
    for name in ("contact_on_base", "contact_on_body", "body_outward", "contact_force"):
        columns[name] = np.zeros((3, 3))
    frames = {
        name: {
            "type": "float64",
            "unit": 1,
            "shape": list(column.shape),
            "data": base64.b64encode(column.tobytes()).decode(),
        }
        for name, column in columns.items()
    }
    program = (ASSETS / "motion.js").read_text() + (
        f"const motion = new rollkane.Motion({json.dumps(frames)});"
        "console.log(JSON.stringify([0, 0.13, 0.4, 0.61, 0.8].map("
        "(t) => motion.state(t))));"
    )
    answer = subprocess.run(
        ["node", "-"], input=program, capture_output=True, text=True, check=True
    )
    states = json.loads(answer.stdout)
    for t, state in zip((0, 0.13, 0.4, 0.61, 0.8), states, strict=True):
        place, turn, _ = exact(t)
        np.testing.assert_allclose(state["position"], place, atol=1e-5)
        assert abs(np.dot(state["orientation"], turn)) == pytest.approx(1.0, abs=1e-12)
        assert state["spin"] == pytest.approx(0.8 * rate)
